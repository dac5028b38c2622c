"""Calibrations: resistors, channels from ordinary recordings, and responses from known loads."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from contracts.extensions import Divider
from known_loads import Bench, moved_over

from lampest import (
    Array,
    Estimator,
    GroundedReadout,
    InputError,
    LoadedColumnsReadout,
    Misfit,
    Panel,
    Recording,
    Scene,
    VirtualGroundReadout,
)
from lampest.apps.calibration.channels import calibrate_channels
from lampest.apps.calibration.known_loads import KnownLoad, KnownLoads
from lampest.apps.calibration.loads import calibrate_loads
from lampest.apps.calibration.resistors import ResistorCalibration, calibrate_resistors
from lampest.apps.calibration.response_fit import (
    Loaded,
    deviations_from_others,
    fit_loads,
    response_of,
)
from lampest.apps.film.pressure import pressure_of
from lampest.estimate.sequence import reconstruct
from lampest.files import levels
from lampest.files.document import parse_document, validated
from lampest.panel.conditions import MeasuredSubject
from lampest.panel.readouts import AnyReadout, TwoPointReadout
from lampest.panel.readouts.floating import two_point_resistance
from lampest.panel.response import PUBLISHED, PowerResponse
from lampest.panel.sizes import Systematic
from tests.estimates import recording_of, rms
from tests.netlist import divider, volts

NOMINAL = {
    "two_point": 1000.0,
    "loaded_columns": 10_000.0,
    "grounded": 1000.0,
    "virtual_ground": 400.0,
}
KINDS = tuple(NOMINAL)
SIDE = 4
LOADS = 8
SPREAD = 5.0
SPECIFIED_ERRORS = Systematic(reference_tolerance=0.01, channel_spread_ohm=SPREAD)
POWER_RESPONSE = PowerResponse(exponent=0.8, scale_kpa=2.0)
# σ of a line that resistors of 0.1 % determine; measured a tenth
MAX_SHARE = 0.02
MAX_OHM = 2.0
WRITTEN = 0.001  # ohm: a scene is written with some digits; measured 0.0002
MIN_WITHIN = 0.88  # of 95 % intervals: numbers of a board share errors; measured 0.93
SCORES_ERROR = 0.3  # of the scores' standard deviation; measured 0.19
NARROWED = 0.5  # of the channels' spread; measured at most 0.05
CHI_SQUARE = 1.5  # over its degrees of freedom; measured 0.17
IMPROVED = 0.7  # of the cells' error with the scene as it was; measured 0.43
CLEARLY_WIDER = 2  # than the median of cells with loads; measured 9
MIN_COVERAGE = 0.9  # of 95 % intervals, over 10 to 40 films that share a curve each


@dataclass(frozen=True)
class Board:
    """A circuit with its true numbers: of rows a channel, of columns a channel or a resistor."""

    kind: str
    rows: Array
    columns: Array

    def volt(self, cells: Array) -> Array:
        """At the converter, (rows, columns), by nodal analysis."""
        rows, columns = (tuple(map(float, line)) for line in (self.rows, self.columns))
        if self.kind != "two_point":
            return volts(cells, readout_of(self.kind, columns, drive_ohm=rows))
        readout = readout_of("two_point", NOMINAL["two_point"])
        places = np.ndindex(cells.shape)
        return np.reshape(
            [divider(cells, readout, j, k, rows[j], columns[k]) for j, k in places], cells.shape
        )


def readout_of(kind: str, ohm: float | tuple[float, ...], **known: object) -> AnyReadout:
    """A circuit with its reference, loads or feedback of that resistance."""
    readouts: dict[str, Callable[..., AnyReadout]] = {
        "two_point": lambda: TwoPointReadout(reference_ohm=ohm, **known),
        "loaded_columns": lambda: LoadedColumnsReadout(load_ohm=ohm, **known),
        "grounded": lambda: GroundedReadout(load_ohm=ohm, **known),
        "virtual_ground": lambda: VirtualGroundReadout(feedback_ohm=ohm, sense_ohm=70.0, **known),
    }
    return readouts[kind]()


def specified_scene(kind: str, shape: tuple[int, int], **converter: object) -> Scene:
    """Return the scene that a user specifies: the circuit and the printed resistances."""
    known = {"adc_bits": 10, "readings": 20, "noise_lsb": 0.7} | converter
    return Scene(Panel(*shape), readout_of(kind, NOMINAL[kind], **known))


def recording(
    scene: Scene, board: Board, cells: Array, rng: np.random.Generator, frames: int = 10
) -> Recording:
    """Averaged codes of a noisy converter; cells (rows, columns) ohm."""
    readout = scene.circuit
    volt = board.volt(cells)
    noise = np.reshape(np.broadcast_to(np.array(readout.noise_lsb), volt.shape[:1]), (-1, 1))
    draws = volt / readout.lsb_volt + noise * rng.standard_normal(
        (readout.readings, frames, *volt.shape)
    )
    codes = np.clip(np.floor(draws + 0.5), 0, 2**readout.adc_bits - 1).astype(int)
    return recording_of(
        scene,
        readout.recorded_from_volt(readout.volt_from_code(codes.sum(axis=0) / readout.readings)),
        name="r",
    )


def random_board(kind: str, shape: tuple[int, int], rng: np.random.Generator) -> Board:
    """Channels of 50 to 110 ohm, resistors within 1 %."""
    rows, columns = (float(rng.uniform(65, 95)) + rng.uniform(-15, 15, length) for length in shape)
    return Board(
        kind,
        rows,
        columns if kind == "two_point" else NOMINAL[kind] * rng.uniform(0.99, 1.01, shape[1]),
    )


def random_resistors(shape: tuple[int, int], rng: np.random.Generator) -> tuple[Array, Array]:
    """Return printed resistances, and true ones within 1 %."""
    printed = rng.choice([220.0, 470.0, 1000.0, 2200.0, 4700.0], shape)
    return printed, printed * rng.uniform(0.99, 1.01, shape)


def pulls(calibration: ResistorCalibration, board: Board) -> list[float]:
    """(estimated − true)/σ of every mean."""
    if board.kind == "two_point":
        (number,) = calibration.numbers
        return [(number.value - board.rows.mean() - board.columns.mean()) / number.sigma]
    return [
        (number.value - true.mean()) / number.sigma
        for number, true in zip(calibration.numbers, (board.rows, board.columns), strict=True)
    ]


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_resistors_of_several_values_determine_every_number_of_every_line(kind: str) -> None:
    """The error of each line agrees with its σ, and the scene states both."""
    rng = np.random.default_rng(KINDS.index(kind))
    shape = (4, 5)
    board = random_board(kind, shape, rng)
    scene = specified_scene(kind, shape)
    printed, _ = random_resistors(shape, rng)
    true = printed * rng.uniform(0.999, 1.001, shape)
    calibration = calibrate_resistors(
        [recording(scene, board, true, rng)], [printed], tolerance=1e-3
    )
    assert max(map(abs, pulls(calibration, board))) < levels.UNUSUAL
    lines = [line for number in calibration.numbers for line in number.lines]
    for line, true_ohm in zip(lines, (board.rows, board.columns), strict=True):
        deviations = (line.off_ohm - (true_ohm - true_ohm.mean())) / line.sigma_ohm
        assert np.abs(deviations).max() < levels.UNUSUAL
        assert line.sigma_ohm.max() < MAX_SHARE * true_ohm.mean() + MAX_OHM
    read = validated(parse_document(calibration.text(), "scene.yaml"), Scene)
    assert read == calibration.scene
    mean = {"two_point": lambda: read.series_ohm.mean()}.get(
        kind, lambda: np.mean(read.readout.drive_ohm)
    )()
    assert mean == pytest.approx(calibration.numbers[0].value, abs=WRITTEN)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_sound_calibrations_are_accepted_and_within_their_deviations(kind: str) -> None:
    """No calibration is refused, and errors are as large as stated."""
    scores = []
    for seed in range(50):
        rng = np.random.default_rng([seed, KINDS.index(kind)])
        shape = (int(rng.integers(3, 6)), int(rng.integers(3, 6)))
        readings = int(rng.choice([1, 4, 20]))
        noise = float(rng.uniform(0.3, 2))
        board = random_board(kind, shape, rng)
        scene = specified_scene(kind, shape, readings=readings, noise_lsb=noise)
        printed, true = random_resistors(shape, rng)
        frames = int(rng.integers(3, 12))
        scores += pulls(
            calibrate_resistors([recording(scene, board, true, rng, frames)], [printed]), board
        )
    within = np.mean(np.abs(scores) < 1.96)
    assert within > MIN_WITHIN
    assert 1 - SCORES_ERROR < np.std(scores) < 1.25


def channel_recording(
    seed: int, channels: Array, reference: float = 0.0, loads: int = LOADS
) -> Recording:
    """Channels (8) ohm, rows first, beside the scene's 140 ohm, and a reference off by a fraction.

    Two unloaded frames, then loads of 2 × 2 cells, three frames each, or three frames without any.
    """
    rng = np.random.default_rng(seed)
    scene = Scene(Panel(SIDE, SIDE), TwoPointReadout(adc_bits=12), 140.0)
    cells = np.tile(
        3000 * np.exp(0.2 * rng.standard_normal((SIDE, SIDE))), (2 + 3 * max(loads, 1), 1, 1)
    )
    for load in range(loads):
        row, column = rng.integers(0, SIDE - 1, 2)
        cells[2 + 3 * load : 5 + 3 * load, row : row + 2, column : column + 2] *= rng.uniform(
            0.1, 0.3
        )
    true = two_point_resistance(cells) + 140.0 + channels[:SIDE, None] + channels[SIDE:]
    recorded = true / (1 + reference)
    recorded = recorded + scene.circuit.sigma(recorded) * rng.standard_normal(cells.shape)
    return recording_of(
        replace(scene, systematic=SPECIFIED_ERRORS), recorded, 2, truth_cell_resistance=cells
    )


@pytest.mark.slow
def test_calibrated_channels_lie_within_their_deviations_and_improve_the_cells() -> None:
    channels = SPREAD * np.random.default_rng(7).standard_normal(2 * SIDE)
    calibration = calibrate_channels([channel_recording(seed, channels, 0.005) for seed in (1, 2)])
    assert (
        calibration.apart < NARROWED * SPREAD == NARROWED * calibration.apart_before
        and not calibration.warnings
    )
    difference = calibration.errors - np.concatenate([[0.005], channels])
    assert difference @ np.linalg.solve(calibration.covariance, difference) < CHI_SQUARE * len(
        difference
    ), "χ²"
    centred = calibration.errors[1:] - channels
    centred -= np.repeat([centred[:SIDE].mean(), centred[SIDE:].mean()], SIDE)
    assert rms(centred) < NARROWED * np.std(channels)
    read = validated(parse_document(calibration.text(), "scene.yaml"), Scene)
    assert read == calibration.scene and read.systematic != SPECIFIED_ERRORS
    fresh = channel_recording(3, channels, 0.005)
    errors = []
    for scene in (fresh.scene, read):
        cells = reconstruct(
            replace(fresh, scene=scene), Estimator((Misfit(),), "reduced")
        ).cell_resistance
        errors.append(np.median(np.abs(np.log(cells / fresh.truth_cell_resistance[2:]))))
    assert errors[1] < IMPROVED * errors[0]


@pytest.mark.slow
def test_a_calibration_without_loads_says_that_nothing_is_known(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace]
) -> None:
    unloaded = channel_recording(1, np.zeros(2 * SIDE), loads=0)
    scene = tmp_path / "scene.yaml"
    unloaded.save(tmp_path / "one.h5")
    replace(unloaded, scene=replace(unloaded.scene, subject=MeasuredSubject(id="another"))).save(
        tmp_path / "two.h5"
    )
    completed = lampest(
        "calibrate", "--from-recording", tmp_path / "one.h5", tmp_path / "two.h5", "--out", scene
    )
    assert (
        completed.code == 0
        and completed.out.startswith("reference ")
        and "from 10 frames" in completed.out
    )
    assert (
        "these loads determine hardly any channel" in completed.err
        and "rows are off by " in scene.read_text()
    )


def test_recordings_that_do_not_determine_a_circuit_are_refused() -> None:
    unloaded = channel_recording(1, np.zeros(2 * SIDE), loads=0)
    with pytest.raises(InputError, match="names no readout"):
        calibrate_channels([replace(unloaded, scene=Scene(unloaded.scene.panel))])
    with pytest.raises(InputError, match="recordings tell nothing of this readout"):
        calibrate_channels([replace(unloaded, scene=Scene(unloaded.scene.panel, Divider()))])
    with pytest.raises(InputError, match="its scene is another"):
        calibrate_channels(
            [
                unloaded,
                replace(unloaded, scene=replace(unloaded.scene, series_resistance_ohm=100.0)),
            ]
        )
    with pytest.raises(InputError, match="no frame could be estimated"):
        calibrate_channels([replace(unloaded, recorded=np.full_like(unloaded.recorded, np.nan))])


@pytest.mark.slow
def test_error_bars_of_gains_and_curve_contain_the_truth() -> None:
    """The fit is tested alone, on data that obey its assumptions."""
    rng = np.random.default_rng(3)
    gains = []
    curves = []
    pressure = np.repeat([[1.0], [4.0], [12.0], [30.0]], 60, axis=1)
    for _ in range(40):
        own = np.exp(0.2 * rng.standard_normal(60))
        scatter = np.exp(0.05 * rng.standard_normal(pressure.shape))
        change = own * scatter * POWER_RESPONSE.logarithm(pressure)
        change += 0.01 * rng.standard_normal(pressure.shape)
        fit = fit_loads(
            Loaded(change, np.full(pressure.shape, 0.01), pressure, 0 * pressure, np.zeros(60))
        )
        gain, sd = fit.gain()
        shift = np.log(own).mean()
        gains.append(np.abs(np.log(gain / own) + shift) < 1.96 * sd)
        curve, curve_sd = fit.curve(pressure[:, 0])
        truth = np.exp(shift) * POWER_RESPONSE.logarithm(pressure[:, 0])
        curves.append(np.abs(np.log(curve / truth)) < 1.96 * curve_sd)
    assert np.mean(gains) > MIN_COVERAGE
    assert np.mean(curves) > MIN_COVERAGE


def test_one_pressure_leaves_larger_pressures_of_another_film_open() -> None:
    """Feet of 5 kPa with their edges calibrate; pressures of 1 to 16 kPa are covered, 10 films."""
    rng = np.random.default_rng(4)
    inside = []
    kpa = np.array([1.5, 3.0, 8.0, 12.0, 16.0])
    pressure = np.tile([5.0, 5.0, 4.0, 3.0, 2.0, 1.0, 5.0, 5.0], (16, 2))
    for number in range(10):
        film = PowerResponse(
            exponent=0.5 + 0.06 * number, scale_kpa=float(np.exp(rng.uniform(-1, 1)))
        )
        change = np.exp(0.03 * rng.standard_normal(pressure.shape)) * film.logarithm(pressure)
        fitted = fit_loads(
            Loaded(change, np.full(pressure.shape, 0.01), pressure, 0 * pressure, np.zeros(16))
        )
        response = replace(
            response_of(fitted, PUBLISHED, (4, 4), 0.0), gain=None, gain_sd=((fitted.scatter,) * 5,)
        )
        ratio = np.exp(film.logarithm(kpa))[None, None]
        pressed = pressure_of(
            ratio, 0.999 * ratio, 1.001 * ratio, Scene(Panel(1, 5), response=response)
        )
        inside.append((pressed.lower <= kpa) & (kpa <= pressed.upper))
    assert np.mean(inside) >= MIN_COVERAGE


def test_cells_under_the_edge_of_a_foot_do_not_make_a_load_odd() -> None:
    """One load of 24 stands aside."""
    pressure = np.tile([5.0, 5.0, 2.0, 2.0], (24, 1))
    place = np.where(pressure == 2.0, 1.0, 0.0)
    felt = pressure.copy()
    felt[7, 2:] = 1.0
    change = np.exp(
        0.02 * np.random.default_rng(5).standard_normal(felt.shape)
    ) * PUBLISHED.logarithm(felt)
    loaded = Loaded(change, np.full(felt.shape, 0.01), pressure, place, np.zeros(4))
    deviations = deviations_from_others(loaded, fit_loads(loaded))
    assert np.abs(deviations - np.median(deviations)).max() < 5 * 0.02


def test_cells_without_load_have_the_common_curve_and_the_spread() -> None:
    bench = Bench(4, panel=Panel(6, 6), repeat=0.02)
    groups, known = moved_over(bench, [5.0], 30.0, 10.0)
    on_the_left = [
        number for number, load in enumerate(known) if load.x_mm is not None and load.x_mm < 15
    ]
    left_loads = [
        replace(known[number], frames=bench.frames_of(at)) for at, number in enumerate(on_the_left)
    ]
    recording = bench.recorded([groups[number] for number in on_the_left], "left")
    calibration = calibrate_loads([recording], KnownLoads(schema=1, loads=tuple(left_loads)), 0.01)
    response = calibration.scene.response
    untouched = ~calibration.fitted.touched.reshape(6, 6)
    assert untouched[:, -1].all() and not untouched[:, 0].any()
    np.testing.assert_allclose(response.gains[untouched], response.gains[untouched][0])
    sd = np.array(response.gain_sd)
    assert (
        sd[untouched].min() > CLEARLY_WIDER * np.median(sd[:, 0])
        and sd[untouched].min() >= calibration.fitted.spread
    )


@pytest.mark.slow
def test_wrong_lists_of_loads_are_refused_or_named() -> None:
    """A list has wrong units, a wrong diameter, late frames, a doubled weight or equal loads."""
    bench = Bench(5, Panel(5, 5), repeat=0.03, frames=3)
    groups, known = moved_over(bench, [5.0], 25.0, 10.0)
    recording = bench.recorded(groups, "units")
    last = len(recording.role) - 1

    def warnings_of(loads: list[KnownLoad]) -> str:
        return "; ".join(
            calibrate_loads([recording], KnownLoads(schema=1, loads=tuple(loads)), 0.0).warnings
        )

    assert warnings_of(known) == ""
    assert "is mass_g in gram" in warnings_of(
        [replace(load, mass_g=None, force_newton=load.mass_g) for load in known]
    )
    assert "diameter_mm right?" in warnings_of([replace(load, diameter_mm=12.5) for load in known])
    late = [
        replace(load, frames=(load.frames[0] + 1, min(load.frames[1] + 1, last))) for load in known
    ]
    assert "readings change within the frames of load" in warnings_of(late)
    doubled = replace(known[7], mass_g=2 * (known[7].mass_g or 0.0))
    assert warnings_of([*known[:7], doubled, *known[8:]]).startswith(
        "load 8 answers otherwise than the others"
    )
    with pytest.raises(InputError, match="a curve that no film has"):
        warnings_of([replace(load, mass_g=(load.mass_g or 0.0) / 1000) for load in known])
    with pytest.raises(InputError, match="loads 4 and 26 lie on the same cells in the same frames"):
        warnings_of([*known, known[3]])
