"""Check of a circuit: a right one passes, a wrong one is noticed, and the right one is named."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise

import lampest
from docs.studies.model_check import named, wrong
from docs.studies.verdicts import read_by, told_wrong
from docs.studies.wrong_readings import drawn as drawn_panel
from docs.studies.wrong_readings import of_load
from lampest import (
    GroundedReadout,
    LoadedColumnsReadout,
    OralDisc,
    Readings,
    Recording,
    Scene,
    Simulation,
    Systematic,
    Unmodelled,
    simulate,
)
from lampest.files.levels import SIGNIFICANCE
from lampest.files.typed import members_of
from lampest.inference.cells_fit import EXACT_CHI_SQUARE, data_of_cells, fitted
from lampest.inference.prepared import Prepared
from lampest.inference.readings.free_tests import free_tests, largest_series_ohm
from lampest.panel.panel import EachModule, Modules, Panel
from lampest.panel.readouts import AnyReadout, Readout, TwoPointReadout
from lampest.panel.readouts.converter import mean_sigma
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.simulation.measure import measured
from tests.estimates import recording_of

SHAPE = (5, 7)
CELLS = 3000 * np.exp(np.random.default_rng(4).standard_normal(SHAPE))
# of a reading, relative
NOISE = 1e-4
ROUNDING = 1e-6
FAR_BEYOND = 1000  # σ; measured 10,000
MEMORY_ERROR = 0.15  # relative


# An amplifier's rails keep readings from breaking its laws unless the resistances at its lines are
# large.
CIRCUITS = (
    TwoPointReadout(),
    lampest.LoadedColumnsReadout(drive_ohm=300.0),
    lampest.DrivenReadout(drive_ohm=300.0, idle_ohm=3300.0, load_ohm=1000.0),
    lampest.GroundedReadout(drive_ohm=300.0),
    lampest.GroundedReadout(drive_ohm=300.0, driven="columns"),
    lampest.GroundedReadout(drive_ohm=300.0, sense="one"),
    lampest.VirtualGroundReadout(drive_ohm=3000.0, sense_ohm=2000.0),
    lampest.VirtualGroundReadout(drive_ohm=3000.0, sense_ohm=2000.0, driven="columns"),
)


def test_every_kind_is_among_the_circuits() -> None:
    assert {type(circuit) for circuit in CIRCUITS} == set(members_of(AnyReadout))


@pytest.mark.parametrize("circuit", CIRCUITS, ids=lambda circuit: circuit.kind)
def test_a_circuit_bounds_its_series_resistance(circuit: Readout) -> None:
    scene = Scene(
        lampest.Panel(*SHAPE, 10.0),
        circuit,
        series_resistance_ohm=200.0 if circuit.unit == "ohm" else 0.0,
    )
    recorded = circuit.to_recorded(circuit.exact_reading(CELLS), scene)[None]
    bare = scene.with_series(0.0)
    assert bare.specified_in_series == 0
    series_ohm = scene.specified_in_series
    assert series_ohm in (200.0, 300.0, 3000.0)
    assert (
        largest_series_ohm(
            bare.circuit, bare.circuit.from_recorded(recorded, bare), 1e-4 * recorded
        )
        >= series_ohm
    )


@pytest.mark.parametrize("circuit", CIRCUITS, ids=lambda circuit: circuit.kind)
def test_laws_of_a_circuit_hold_only_for_its_own_readings(circuit: Readout) -> None:
    exact = circuit.exact_reading(CELLS)[None]
    sigma = NOISE * exact
    for test in free_tests(circuit, exact, sigma):
        assert test.excess.shape == (1,)
        assert test.excess[0] <= ROUNDING / NOISE
        spoilt = exact.copy()
        spoilt[0, 2, 3] = 3 * exact.max() if circuit.unit == "ohm" else 1.01 * circuit.supply_volt
        broken = {law_test.law: law_test for law_test in free_tests(circuit, spoilt, sigma)}[
            test.law
        ]
        assert broken.excess[0] > FAR_BEYOND


def test_a_verdict_says_whether_other_circuits_were_compared() -> None:
    """Yes: this circuit can give the readings, and no other known one is likelier."""
    rng = np.random.default_rng(3)
    cells = np.repeat(3000 * np.exp(0.1 * rng.standard_normal((1, 6, 6))), 8, axis=0)
    cells[5:, 2:4, 2:4] *= 0.4
    exact = lampest.two_point_resistance(cells)
    scene = Scene(Panel(6, 6), TwoPointReadout(readings=20, noise_lsb=0.7))
    lsb = scene.readout.lsb_volt
    volt = scene.readout.volt_from_recorded(exact) + 0.16 * lsb * rng.standard_normal(exact.shape)
    recording = recording_of(scene, scene.readout.recorded_from_volt(volt), unloaded=5)
    check = Prepared(recording).check
    assert check.mark == "yes" and check.compared
    unloaded = recording_of(scene, recording.recorded[:5], unloaded=5)
    alone = Prepared(unloaded).check
    assert alone.explains and not alone.compared


# Other circuits once explained the readings "better": all cells change, noise changes cells by
# tens of percent, or keys change in every frame, so that the frames that are compared hold several.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "seed"),
    [
        ("palm", 1001),
        ("palm", 1003),
        ("palm", 1007),
        ("palm", 2005),
        ("feet", 1010),
        ("feet", 2005),
        ("keys", 1002),
        ("sweep", 2004),
    ],
)
@promise(
    "theory/model_check: A candidate is therefore named by the evidence about the most probable "
    "cells, given film and load."
)
def test_a_right_circuit_is_not_called_wrong_under_palms_feet_keys_and_bars(
    load: str, seed: int
) -> None:
    check = Prepared(drawn_panel(seed, of_load(load)).recording()).check
    assert check.explains is not False, check.sentence


# Films without scatter read alike, and so do those of circuits that hardly depend on their cells.
@pytest.mark.slow
def test_the_unloaded_panel_alone_rejects_no_circuit() -> None:
    palm = read_by(drawn_panel(8002, of_load("palm")), "one load").recording()
    assert Prepared(palm).check.mark == "doubtful"


@pytest.mark.slow
def test_loads_within_the_noise_compare_no_circuit() -> None:
    check = Prepared(told_wrong(drawn_panel(8502, of_load("keys")), 8502)).check
    assert check.mark == "yes" and not check.compared
    assert "loads change too little beside the noise; press more cells" in check.sentence


# Eight bits leave cells uncertain: changes by other circuits were taken for noise, and circuits
# with fewer changed cells, or with a resistance in series beside, were compared in place of these.
@pytest.mark.slow
@pytest.mark.parametrize(("load", "mark"), [("places", "doubtful"), ("sweep", "yes")])
def test_eight_bits_that_hardly_tell_a_wrong_circuit_do_not_exclude_the_right_one(
    load: str, mark: str
) -> None:
    check = Prepared(told_wrong(drawn_panel(8000, of_load(load)), 8000)).check
    assert check.mark == mark and "no other" not in check.sentence and not check.compared


@pytest.mark.slow
@promise(
    "theory/model_check: An outlier of one frame that some cell gives is compared with the others."
)
def test_keys_that_are_pressed_for_one_frame_are_compared() -> None:
    """Without the reading of the key, its neighbours would have to change."""
    check = Prepared(drawn_panel(2008, of_load("keys")).recording()).check
    assert check.mark == "yes" and "outlier" not in check.sentence, check.sentence


# Loads that show it: a rod that halves nine cells leaves a series resistance of 140 ohm undecided.
@promise("README: lampest checks the circuit and names a likelier one.")
@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4])
def test_a_wrong_circuit_is_rejected_and_the_right_one_named(seed: int) -> None:
    for fault, recording in wrong(seed, side=10, bits=12):
        check = Prepared(recording).check
        assert check.explains is False, fault
        assert named(fault, check), (fault, check.sentence)


def test_a_short_behind_a_large_drive_resistor_is_explained() -> None:
    circuit = lampest.LoadedColumnsReadout(
        load_ohm=10_000.0, drive_ohm=1080.0, adc_bits=12, readings=1, noise_lsb=1.0
    )
    cells = 3000 * np.exp(0.2 * np.random.default_rng(4).standard_normal((6, 8)))
    cells[2, 6] = 0.5
    exact = np.repeat(circuit.exact_reading(cells)[None], 4, axis=0)
    noisy = exact + mean_sigma(circuit) * np.random.default_rng(5).standard_normal(exact.shape)
    check = Prepared(recording_of(Scene(lampest.Panel(6, 8, 10.0), circuit), noisy, 3)).check
    assert check.explains, check.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    ("circuit", "seed"),
    [
        (TwoPointReadout(adc_bits=10, readings=4, noise_lsb=2.0, reference_ohm=300.0), 3),
        (
            lampest.LoadedColumnsReadout(
                adc_bits=10, readings=4, noise_lsb=2.0, drive_ohm=50.0, load_ohm=3000.0
            ),
            1,
        ),
    ],
    ids=["a resistance in series", "a leak"],
)
def test_soft_loads_are_not_mistaken_for_another_circuit(circuit: Readout, seed: int) -> None:
    """Half of the cells change by a few percent."""
    rng = np.random.default_rng(seed)
    scene = Scene(Panel(12, 9), circuit)
    row, column = np.indices((12, 9))
    cells = np.repeat(3000 * np.exp(0.1 * rng.standard_normal((1, 12, 9))), 4, axis=0)
    for _ in range(2):
        depth = rng.uniform(0.5, 1.5)
        down = rng.uniform(0, 11)
        across = rng.uniform(0, 8)
        cells[3:] *= np.exp(-depth * np.exp(-((row - down) ** 2 + (column - across) ** 2) / 8))
    exact = np.stack([circuit.to_recorded(circuit.exact_reading(frame), scene) for frame in cells])
    prepared = Prepared(
        recording_of(scene, exact + circuit.sigma(exact) * rng.standard_normal(exact.shape), 3)
    )
    assert prepared.check.explains and prepared.noise.corrected_effects is None, (
        prepared.check.sentence
    )


@pytest.mark.long
@pytest.mark.parametrize("deviations", [0.5, 1.0, 2.0, 3.0, 10.0])
def test_a_fit_is_within_noise_where_its_tail_is(deviations: float) -> None:
    """Few or many degrees of freedom may decide before their number is computed."""
    readout = TwoPointReadout()
    scene = Scene(lampest.Panel(*SHAPE, 10.0), readout)
    exact = readout.exact_reading(CELLS)
    sigma = 0.03 * exact
    noise = np.random.default_rng(1).standard_normal(SHAPE)
    fit = fitted(scene, Readings.of(scene, exact + deviations * sigma * noise, sigma), patient=True)
    assert fit is not None
    assert fit.within_noise == (fit.chi_square <= 1 or fit.tail >= SIGNIFICANCE)


@pytest.mark.parametrize(
    "faults",
    [
        lampest.Faults(dead_rows=(1,)),
        lampest.Faults(dead_columns=(0, 4)),
        lampest.Faults(open=((1, 2),)),
        lampest.Faults(shorted=((1, 2),)),
    ],
    ids=["dead row", "dead columns", "open cell", "shorted cell"],
)
def test_known_faults_keep_no_other_cell_at_a_bound(faults: lampest.Faults) -> None:
    """The start of a solve has the faults, and reproduces the readings of all other cells.

    From a start at which a dead row conducts, least squares end with a cell at its bound and
    readings off by more than their noise.
    """
    readout = TwoPointReadout(adc_bits=12, readings=20, measured_across="sensor")
    scene = Scene(lampest.Panel(6, 6, 10.0), readout, faults=faults)
    cells = 3000 * np.exp(np.random.default_rng(47).standard_normal((6, 6)))
    cells[2:4, 2:4] /= 60
    cells[scene.open_cells] = 1e12
    cells[scene.shorted_cells] = 1e-3
    readings = Readings.of(scene, np.minimum(readout.exact_reading(cells), 1e9))
    data = data_of_cells(scene, readings)
    start = data.network(0, data.start()[0]).reading()
    seen = readings.seen > 0
    assert_allclose(start[seen], readings.value[seen], rtol=ROUNDING)
    fit = fitted(scene, readings, patient=True)
    assert fit is not None and fit.chi_square < EXACT_CHI_SQUARE


@pytest.mark.slow
def test_errors_beside_noise_are_not_tried_where_chi_square_stays_beyond_noise() -> None:
    """Readings of negative cells: χ² falls by the factor of the variances at most."""
    random = np.random.default_rng(6)
    cells = 3000 * np.exp(0.2 * random.standard_normal((5, 5)))
    scene = Scene(Panel(5, 5), TwoPointReadout(readings=4, noise_lsb=0.7))
    ohm = lampest.two_point_resistance(cells)
    ohm[0, 0] *= 1.5
    recording = recording_of(scene, np.repeat(ohm[None], 4, axis=0), unloaded=2)
    question = Prepared(recording).question
    assert question.fault and question.hopeless_with(np.full((4, 5, 5), 0.1))
    assert not question.hopeless_with(np.full((4, 5, 5), 1000.0))


@pytest.mark.slow
def test_the_misfit_of_cells_alone_stays_within_its_degrees_of_freedom() -> None:
    """Tails must be uniform or larger, though some cells would have to be negative."""
    readout = TwoPointReadout()
    scene = Scene(lampest.Panel(*SHAPE, 10.0), readout)
    exact = readout.exact_reading(CELLS)
    sigma = 0.03 * exact
    noisy = (
        exact + sigma * np.random.default_rng(seed).standard_normal(SHAPE) for seed in range(120)
    )
    tails = [
        fitted(scene, Readings.of(scene, readings, sigma), patient=True).tail for readings in noisy
    ]
    standard_error = 0.02  # of a share of 0.05 in 120 draws
    assert np.mean(np.array(tails) < 0.05) <= 0.05 + 3 * standard_error
    assert np.min(tails) > SIGNIFICANCE


@pytest.mark.slow
def test_a_large_panel_is_compared_with_cells_alone() -> None:
    side = 21
    assert side**2 > MAX_CELLS
    readout = lampest.LoadedColumnsReadout(drive_ohm=0.0, adc_bits=12, readings=20)
    scene = Scene(lampest.Panel(side, side, 10.0), readout)
    cells = 3000 * np.exp(0.2 * np.random.default_rng(6).standard_normal((2, side, side)))
    cells[1, 4:8, 10:14] *= 0.01
    frames = readout.exact_reading(cells)
    right = recording_of(scene, frames, 1)
    assert Prepared(right).check.mark == "yes"
    swapped = replace(scene, readout=replace(readout, driven="columns"))
    assert Prepared(replace(right, scene=swapped)).check.mark == "no"


@pytest.mark.slow
def test_differing_channels_are_not_taken_for_another_series_resistance() -> None:
    """A quarter of a mouth on a module."""
    systematic = Systematic(reference_tolerance=0.01, channel_spread_ohm=3)
    panel = Panel(modules=Modules(2, 2, EachModule(10, 10)))
    scene = Scene(panel, TwoPointReadout(noise_lsb=0.7), 140.0, systematic=systematic)
    mouth = OralDisc(
        centre_mm=(97, 99), diameter_mm=35, rim_width_mm=6, pressure_kpa=-12, rim_kpa=60
    )
    errors = Unmodelled(channel_spread_ohm=3, reference_tolerance=0.01)
    simulation = Simulation(
        1, 35, scene, frames=4, baseline_frames=5, loads=(mouth,), unmodelled=errors
    )
    assert Prepared(simulate(simulation).modules[1]).check.better == ""
    rod = Recording.load(Path(__file__).parents[2] / "data" / "rod.h5")
    forgotten = replace(rod, scene=replace(rod.scene, series_resistance_ohm=0.0))
    better = Prepared(forgotten).check.better  # 133 and 135 ohm explain the readings equally well
    assert better.split(", ")[-1] in (
        "series_resistance_ohm near 130",
        "series_resistance_ohm near 140",
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [411, 413])
def test_an_omitted_series_resistance_is_named_beyond_linear_theory(seed: int) -> None:
    _, recording = next(wrong(seed, 10, 10))
    assert "series_resistance_ohm near 1" in Prepared(recording).check.better


# 50 ohm were "yes, and no other known one is likelier".
@pytest.mark.slow
@pytest.mark.parametrize(
    ("forgotten_ohm", "mark", "compared", "words"),
    [
        (0, "yes", True, "no other known one is likelier"),
        (33, "yes", False, "readings; no frame shows"),  # of cells it changes 4 %
        (
            50,
            "doubtful",
            False,
            "ohm near 48 gives them about as well, or better; then with the scene's circuit cells",
        ),
        (240, "no", False, "ohm near 240 explains the readings better"),
    ],
)
def test_a_forgotten_resistance_in_series_is_a_doubt_before_it_is_named(
    forgotten_ohm: float, mark: str, compared: bool, words: str
) -> None:
    scene = Scene(Panel(7, 8), TwoPointReadout(noise_lsb=0.7), forgotten_ohm)
    hand = lampest.Block(centre_mm=(33.0, 28.0), length_mm=30.0, width_mm=25.0, mass_g=1500.0)
    simulation = Simulation(
        1, 3, scene, lampest.Cells(spread=0.15), baseline_frames=4, frames=5, loads=(hand,)
    )
    told = replace(scene, series_resistance_ohm=0.0)
    check = Prepared(replace(simulate(simulation), scene=told)).check
    assert (check.mark, check.compared) == (mark, compared)
    assert words in check.sentence


BLOCKS = ((0, 1, 2, 3), (4, 5, 6, 7))
WIDE_PANEL = Panel(8, 8)


def misdescribed(actual: Scene, specified: Scene, seed: int, frames: int = 6) -> Recording:
    """Codes of one scene, described by another one: half of the frames have three pressed cells."""
    rng = np.random.default_rng(seed)
    cells = np.tile(3000 * np.exp(0.25 * rng.normal(size=actual.panel.shape)), (2 * frames, 1, 1))
    cells[frames:, 2, 3] /= 4
    cells[frames:, 2, 4] /= 3
    cells[frames:, 3, 3] /= 5
    codes = measured(actual, cells, Unmodelled(), seed)[0]
    recorded = specified.circuit.recorded_from_volt(actual.circuit.volt_from_recorded(codes))
    role = (np.arange(2 * frames) >= frames).astype(np.uint8)
    shape = (2 * frames, *specified.panel.shape)
    return Recording(specified, recorded.reshape(shape), np.arange(2.0 * frames), role, name="mine")


CONVERTER: dict[str, Any] = {"adc_bits": 12, "readings": 4, "noise_lsb": 1.0}
TWO_POINT_SCENE = Scene(WIDE_PANEL, TwoPointReadout(**CONVERTER), 140.0, systematic="none")
HOBBY = Scene(
    WIDE_PANEL,
    LoadedColumnsReadout(load_ohm=4700.0, drive_ohm=150.0, **CONVERTER),
    systematic="none",
)
ONE_LOAD = Scene(
    WIDE_PANEL,
    GroundedReadout(sense="one", drive_ohm=70.0, load_ohm=1000.0, **CONVERTER),
    systematic="none",
)


def grouped(scene: Scene) -> Scene:
    return replace(scene, readout=replace(scene.readout, groups=BLOCKS))


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene", [TWO_POINT_SCENE, HOBBY, ONE_LOAD], ids=["two_point", "loaded_columns", "grounded"]
)
def test_specified_and_absent_groups_raise_no_doubt(scene: Scene) -> None:
    for actual in (scene, grouped(scene)):
        assert Prepared(misdescribed(actual, actual, 1)).check.mark == "yes"


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.04, 0.08])
@pytest.mark.parametrize("scene", [TWO_POINT_SCENE, HOBBY], ids=["two_point", "loaded_columns"])
def test_a_converter_with_memory_is_named_with_its_number(scene: Scene, memory: float) -> None:
    check = Prepared(misdescribed(replace(scene, converter_memory=memory), scene, 2)).check
    assert check.better.startswith("converter_memory near ")
    assert float(check.better.split()[-1]) == pytest.approx(memory, rel=MEMORY_ERROR)


@pytest.mark.slow
def test_a_memory_of_readings_that_are_taken_column_by_column_is_named() -> None:
    built: Any = replace(HOBBY.readout, scan_order="columns")
    check = Prepared(
        misdescribed(replace(HOBBY, readout=built, converter_memory=0.08), HOBBY, 2)
    ).check
    assert check.better.startswith("readout.scan_order: columns, converter_memory near 0.08")
    assert check.addition["readout"] == {"scan_order": "columns"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [TWO_POINT_SCENE, pytest.param(HOBBY, marks=pytest.mark.slow)],
    ids=["two_point", "loaded_columns"],
)
def test_readings_listed_column_by_column_are_named(scene: Scene) -> None:
    tall, wide = (replace(scene, panel=Panel(*shape)) for shape in ((12, 8), (8, 12)))
    recording = misdescribed(tall, wide, 2)
    check = Prepared(recording).check
    other_side = "" if scene is TWO_POINT_SCENE else ", readout.driven: columns"
    assert (
        check.better == f"readings listed column by column (lampest import --transpose){other_side}"
    )
