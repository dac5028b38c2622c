"""Idle lines that are held harder than the driven one: several panels give the same readings."""

from typing import Any

import numpy as np
import pytest

import lampest
from docs.studies.held_lines import nodal_volts, random_readout
from docs.studies.model_check import sound
from lampest import Array, DrivenReadout, Misfit, Panel, Recording, Scene
from lampest.audit.verdict import verdict
from lampest.inference.prepared import Prepared
from tests.netlist import volts

SHAPE = (5, 6)
PRESSED = (slice(3, 5), slice(2, 4))
# Cells beyond the fold of their driven lines, and before it
BEYOND: dict[str, Any] = {"drive_ohm": 320.0, "load_ohm": 17e3, "idle_load_ohm": 2200.0}
BEFORE: dict[str, Any] = {"drive_ohm": 109.0, "load_ohm": 3576.0, "idle_load_ohm": 0.0}


def panels(typical: float, factor: float) -> tuple[Array, Array]:
    resting = typical * np.exp(0.2 * np.random.default_rng(6).standard_normal(SHAPE))
    loaded = resting.copy()
    loaded[PRESSED] *= factor
    return resting, loaded


def recording_of(readout: DrivenReadout, resting: Array, loaded: Array) -> Recording:
    frames = np.stack([volts(resting, readout)] * 6 + [volts(loaded, readout)] * 3)
    step = readout.supply_volt / 2**readout.adc_bits
    draws = np.random.default_rng(7).normal(size=(readout.readings, *frames.shape))
    codes = np.rint(frames / step + 0.7 * draws).mean(axis=0)
    return Recording.from_array(codes, unit="code", scene=Scene(Panel(*SHAPE), readout), baseline=6)


def held(**keys: Any) -> DrivenReadout:
    return DrivenReadout(idle_ohm=0.0, adc_bits=12, readings=4, noise_lsb=0.7, **keys)


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


def test_panels_that_no_frame_tells_apart_are_both_named() -> None:
    """A load that changes all cells leaves none that stand still."""
    resting, _ = panels(6600.0, 1.0)
    everywhere = resting * np.random.default_rng(8).uniform(0.4, 0.8, SHAPE)
    prepared = Prepared(recording_of(held(**BEFORE), resting, everywhere))
    assert prepared.panels is not None and not prepared.panels.clear
    check = verdict(prepared.check, prepared)
    assert check.mark != "yes"
    assert "alike" in check.sentence or check.mark == "no"


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


@pytest.mark.parametrize("seed", [94013, 94112])
def test_idle_sensed_lines_fold_the_readings_too(seed: int) -> None:
    """They pull the driven line to ground; near the fold the right cells are noisy."""
    drawn = sound(seed, drifts=False)
    assert drawn is not None
    choice = Prepared(drawn[1]).panels
    assert choice is not None and drawn[1].truth_cell_resistance is not None
    off = np.log(choice.resting / drawn[1].truth_cell_resistance[0])
    assert abs(np.median(off)) < 0.1


def test_readings_of_the_study_are_those_of_netlists() -> None:
    for seed in range(4):
        readout = random_readout(np.random.default_rng(seed))
        cells, _ = panels(2000.0, 1.0)
        assert nodal_volts(cells, readout) == pytest.approx(volts(cells, readout), rel=1e-9)
