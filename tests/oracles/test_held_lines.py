"""Idle lines that are held harder than the driven one: several panels give the same readings."""

from typing import Any

import numpy as np
import pytest

import lampest
from docs.studies.held_lines import nodal_volts, random_readout
from docs.studies.model_check import sound
from lampest import Array, DrivenReadout, Faults, Misfit, Panel, Recording, Scene
from lampest.audit.advice import Audit, verdict
from lampest.audit.health import Health
from lampest.inference.prepared import Prepared
from lampest.panel.readouts.starts import several_panels
from tests.netlist import volts

SHAPE = (5, 6)
PRESSED = (slice(3, 5), slice(2, 4))
# Cells beyond the fold of their driven lines, and before it
BEYOND: dict[str, Any] = {"drive_ohm": 320.0, "load_ohm": 17e3, "idle_load_ohm": 2200.0}
BEFORE: dict[str, Any] = {"drive_ohm": 109.0, "load_ohm": 3576.0, "idle_load_ohm": 0.0}


# Idle sensed lines alone are held hard, both sides are, or the idle driven ones
SENSED: dict[str, Any] = {"drive_ohm": 470.0, "load_ohm": 1e4, "idle_load_ohm": 0.0}
BOTH: dict[str, Any] = {
    "drive_ohm": 50.0,
    "idle_ohm": 50.0,
    "load_ohm": 1e4,
    "idle_load_ohm": 50.0,
}
DRIVEN: dict[str, Any] = {
    "drive_ohm": 470.0,
    "idle_ohm": 50.0,
    "load_ohm": 3300.0,
    "idle_load_ohm": float("inf"),
}
OPEN = (0, 1)


def panels(typical: float, factor: float) -> tuple[Array, Array]:
    resting = typical * np.exp(0.2 * np.random.default_rng(6).standard_normal(SHAPE))
    loaded = resting.copy()
    loaded[PRESSED] *= factor
    return resting, loaded


def recording_of(
    readout: DrivenReadout, resting: Array, loaded: Array, faults: Faults | None = None
) -> Recording:
    frames = np.stack([volts(resting, readout)] * 6 + [volts(loaded, readout)] * 3)
    step = readout.supply_volt / 2**readout.adc_bits
    draws = np.random.default_rng(7).normal(size=(readout.readings, *frames.shape))
    codes = np.rint(frames / step + 0.7 * draws).mean(axis=0)
    scene = Scene(Panel(*SHAPE), readout, faults=faults)
    return Recording.from_array(np.maximum(codes, 0.0), unit="code", scene=scene, baseline=6)


def held(**keys: Any) -> DrivenReadout:
    return DrivenReadout(idle_ohm=0.0, adc_bits=12, readings=4, noise_lsb=0.7, **keys)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["auto", "nodal"])
@pytest.mark.parametrize(("keys", "typical"), [(BEYOND, 2500.0), (BEFORE, 6600.0)])
def test_the_panel_is_the_one_in_which_most_cells_stand_still(
    keys: dict[str, Any], typical: float, formulation: str
) -> None:
    resting, loaded = panels(typical, 0.35)
    recording = recording_of(held(**keys), resting, loaded)
    estimate = lampest.reconstruct(recording, [Misfit(weighting="noise")], formulation=formulation)
    assert estimate.baseline_resistance == pytest.approx(resting, rel=0.15)
    for cells in estimate.cell_resistance:
        assert cells[PRESSED] == pytest.approx(loaded[PRESSED], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keys", "typical", "broken"),
    [(SENSED, 3000.0, False), (BOTH, 800.0, True), (DRIVEN, 3000.0, True)],
)
def test_a_right_circuit_is_not_doubted_where_several_panels_read_alike(
    keys: dict[str, Any], typical: float, broken: bool
) -> None:
    resting, loaded = panels(typical, 0.35)
    intact = np.ones(SHAPE, dtype=bool)
    if broken:
        resting[OPEN] = loaded[OPEN] = 1e12
        intact[OPEN] = False
    readout = DrivenReadout(adc_bits=10, readings=4, noise_lsb=0.7, **keys)
    faults = Faults(open=(OPEN,)) if broken else None
    audit = Audit(Prepared(recording_of(readout, resting, loaded, faults)))
    assert audit.verdict.mark == "yes", audit.verdict.sentence
    assert not audit.advice
    panels_chosen = audit.prepared.panels
    assert panels_chosen is not None
    assert np.median(np.abs(np.log(panels_chosen.resting / resting))[intact]) < 0.05


def test_estimates_take_the_panel_where_idle_sensed_lines_alone_are_held() -> None:
    resting, loaded = panels(3000.0, 0.35)
    readout = DrivenReadout(adc_bits=10, readings=4, noise_lsb=0.7, **SENSED)
    estimate = lampest.reconstruct(recording_of(readout, resting, loaded), [Misfit()])
    assert estimate.baseline_resistance == pytest.approx(resting, rel=0.15)
    assert estimate.cell_resistance[-1][PRESSED] == pytest.approx(loaded[PRESSED], rel=0.15)


def test_several_panels_have_readings_that_rise_and_fall() -> None:
    assert several_panels(DrivenReadout(**SENSED), *SHAPE)
    assert several_panels(DrivenReadout(**BOTH), *SHAPE)
    # Idle lines yield more than the driven one
    yielding = DrivenReadout(idle_ohm=3300.0, drive_ohm=50.0, load_ohm=1000.0)
    assert not several_panels(yielding, *SHAPE)
    # Idle driven lines are held as hard as the driven one, or some sensed ones are
    groups = ((0, 1, 2), (3, 4, 5))
    assert several_panels(DrivenReadout(**BOTH, groups=groups), *SHAPE)
    assert several_panels(DrivenReadout(**SENSED, groups=groups), *SHAPE)
    assert not several_panels(DrivenReadout(idle_ohm=0.0, drive_ohm=0.0), *SHAPE)
    assert not several_panels(lampest.LoadedColumnsReadout(drive_ohm=470.0), *SHAPE)


def test_a_cell_of_a_tenth_is_no_short_where_readings_rise_and_fall() -> None:
    cells, _ = panels(8000.0, 1.0)
    cells[2, 2] = 800.0
    readout = DrivenReadout(adc_bits=12, readings=4, noise_lsb=0.7, **SENSED)
    findings = Health.of(recording_of(readout, cells, cells)).findings
    assert not [finding.what for finding in findings if "shorted" in finding.what]


@pytest.mark.slow
def test_panels_that_no_frame_tells_apart_are_both_named() -> None:
    """A load that changes all cells leaves none that stand still."""
    resting, _ = panels(6600.0, 1.0)
    everywhere = resting * np.random.default_rng(8).uniform(0.4, 0.8, SHAPE)
    prepared = Prepared(recording_of(held(**BEFORE), resting, everywhere))
    assert prepared.panels is not None and not prepared.panels.clear
    check = verdict(prepared.check, prepared)
    assert check.mark != "yes"
    assert "alike" in check.sentence or check.mark == "no"


@pytest.mark.slow
def test_random_circuits_have_clear_and_right_panels_or_a_doubt() -> None:
    clear = 0
    for seed in range(200, 208):
        rng = np.random.default_rng(seed)
        readout = random_readout(rng)
        resting, loaded = panels(float(np.exp(rng.uniform(np.log(1e3), np.log(2e4)))), 0.4)
        choice = Prepared(recording_of(readout, resting, loaded)).panels
        if choice is None or not choice.clear:
            continue
        clear = clear + 1
        error = np.median(np.abs(choice.loaded / loaded - 1)[PRESSED])
        assert error < 0.1, (seed, readout)
    assert clear >= 6


@pytest.mark.slow
@pytest.mark.parametrize("seed", [262046, 262163, 462074])
def test_a_panel_beyond_the_fold_of_all_lines_is_found(seed: int) -> None:
    """One has cells of 0.7 times the right ones, and another circuit explained its load better.

    In the second one the driven line has the resistance of the idle ones, and a short. In the third
    one sensed lines are read in groups, whose idle lines are held.
    """
    drawn = sound(seed, drifts=False)
    assert drawn is not None
    choice = Prepared(drawn[1]).panels
    truth = drawn[1].truth_cell_resistance
    assert choice is not None and truth is not None and choice.clear
    for cells, right in ((choice.resting, truth[0]), (choice.loaded, truth[-1])):
        assert abs(np.median(np.log(cells / right))) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("seed", [562022, 562034, 562037, 862055])
def test_estimates_stay_at_the_chosen_panel_though_another_one_costs_less(seed: int) -> None:
    """Cells of the other one are 30 to 400 times as large.

    In the last one the loaded panel is found from the unloaded one alone.
    """
    drawn = sound(seed, drifts=False)
    assert drawn is not None
    truth = drawn[1].truth_cell_resistance
    estimate = lampest.reconstruct(drawn[1])
    assert truth is not None
    for cells, right in zip(estimate.cell_resistance, truth[-3:], strict=True):
        assert abs(np.nanmedian(np.log(cells / right))) < 0.15


@pytest.mark.parametrize("seed", [562139, 662003])
def test_a_panel_beside_the_fold_is_not_clear(seed: int) -> None:
    """Cells of half to three times the right ones give the readings alike, or the loaded ones."""
    drawn = sound(seed, drifts=False)
    assert drawn is not None
    choice = Prepared(drawn[1]).panels
    assert choice is not None and not choice.clear and "alike" in choice.sentence


@pytest.mark.slow
def test_creep_is_not_advised_where_another_panel_may_be_meant() -> None:
    drawn = sound(262175, drifts=False)
    assert drawn is not None
    audit = Audit(Prepared(drawn[1]))
    assert not audit.advice and "alike" in audit.verdict.sentence


def test_readings_of_the_study_are_those_of_netlists() -> None:
    for seed in range(4):
        readout = random_readout(np.random.default_rng(seed))
        cells, _ = panels(2000.0, 1.0)
        assert nodal_volts(cells, readout) == pytest.approx(volts(cells, readout), rel=1e-9)
