"""The frame that pictures show."""

from pathlib import Path

import numpy as np
import pytest
from support import invented_case

from lampest import (
    MEASURED,
    UNLOADED,
    Panel,
    Readings,
    Recording,
    TwoPointReadout,
    read_simulations,
    simulate,
)
from lampest.report.strongest import likely_change, strongest_index

ROOT = Path(__file__).parents[2]
FULL_SUCTION = 0.99  # of the largest suction of the recording
HARDLY_SUCKING = 0.1  # of it; measured at most 0.013
CHANGE = 1e-6  # of log r; second-order errors are its square, times the condition


@pytest.mark.parametrize("panel", ["clean", "real"])
@pytest.mark.parametrize("name", ["air_10kpa", "air_20kpa", "water_10kpa", "water_20kpa"])
def test_the_shown_frame_contains_a_sucking_cup(name: str, panel: str) -> None:
    """Before the suction, the rim alone moves readings further."""
    if panel == "clean":
        recording = Recording.load(ROOT / "data" / f"cup_{name}.h5")
    else:
        ((_, simulation),) = read_simulations(ROOT / "configs" / f"real_cup_{name}.yaml")
        recording = simulate(simulation)
    readings = Readings.of(recording.scene, recording.recorded)
    measured = readings.value[recording.role == MEASURED]
    loaded = recording.truth_pressure[recording.role == MEASURED]
    resting = readings[recording.role == UNLOADED].mean().value
    case = invented_case(shape=measured.shape, measured=measured, measured_baseline=resting)
    shown = strongest_index([case])
    assert loaded[shown].min() < FULL_SUCTION * loaded.min() < 0
    if panel == "clean":
        by_readings = np.argmax(np.abs(np.log(measured / resting)).mean(axis=(1, 2)))
        assert loaded[by_readings].min() > HARDLY_SUCKING * loaded.min(), (
            "readings alone would show another frame"
        )


@pytest.mark.parametrize("shape", [(5, 8), (8, 5), (1, 6), (6, 1), (2, 2)])
def test_small_changes_of_a_uniform_panel_are_recovered(shape: tuple[int, int]) -> None:
    """Exact to first order, against the network's own readings."""
    panel = Panel(*shape)
    readout = TwoPointReadout()
    change = CHANGE * np.random.default_rng(sum(shape)).standard_normal((3, *shape))
    cells = 2000.0 * np.exp(np.concatenate([np.zeros((1, *shape)), change]))
    readings = readout.exact_reading(cells)
    assert panel.shape == readings.shape[1:]
    assert likely_change(readings[1:], readings[0]) == pytest.approx(change, abs=30 * CHANGE**2)
    value = np.full((1, 4, 4), 300.0)
    resting = np.full((4, 4), 600.0)
    value[0, 1] = np.nan
    value[0, 2, 2] = np.nan
    likely = likely_change(value, resting)[0]  # what says nothing leaves the rest
    assert np.isnan(likely[1]).all() and np.isnan(likely[2, 2]) and np.isfinite(likely).sum() == 11
    assert likely[np.isfinite(likely)] == pytest.approx(np.log(0.5))
