"""Lower bounds that a frame's other readings do not allow: a contact has failed, nothing sucks."""

import numpy as np
import pytest

import lampest
from lampest import Misfit, Panel, Readings, Recording, Scene, TwoPointReadout
from lampest.inference.readings.outliers import impossible_readings
from lampest.recording.readings import Sidedness

SCENES = {
    "resistances alone": Scene(Panel(6, 8)),
    "a divider": Scene(Panel(6, 8), TwoPointReadout(readings=20), 140.0),
}


def read(scene: Scene, seed: int, frames: int = 5) -> np.ndarray:
    """Readings of cells around 3 kohm in ohm, as recorded, without noise."""
    rng = np.random.default_rng(seed)
    cells = 3000 * np.exp(0.3 * rng.standard_normal((frames, *scene.panel.shape)))
    exact = np.array([lampest.two_point_resistance(frame) for frame in cells])
    return exact + scene.series_ohm


def outliers(scene: Scene, recorded: np.ndarray) -> np.ndarray:
    """Places of the readings that no cells allow."""
    return np.argwhere(impossible_readings(scene.circuit, Readings.of(scene, recorded)))


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 4))]
)
def test_an_infinite_reading_among_good_ones_is_an_outlier(scene: Scene, seed: int) -> None:
    """It moved its cell by 50 % and more, as "local optimum verified"."""
    recorded = read(scene, seed)
    row, column = np.random.default_rng(seed).integers((6, 8))
    wrong = recorded.copy()
    wrong[4, row, column] = np.inf
    assert outliers(scene, wrong).tolist() == [[4, row, column]]
    missing = wrong.copy()
    missing[4, row, column] = np.nan
    estimate, expected = (
        lampest.reconstruct(Recording.from_array(values, baseline=3, scene=scene), (Misfit(),))
        for values in (wrong, missing)
    )
    np.testing.assert_allclose(estimate.cell_resistance, expected.cell_resistance, rtol=1e-6)


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_bounds_that_the_other_readings_allow_stay_bounds(scene: Scene) -> None:
    """A broken line, two broken lines, an open panel, and a panel with a few closed cells."""
    recorded = read(scene, 9)
    recorded[0, 2] = np.inf
    recorded[1, :, 3] = recorded[1, 4] = np.inf
    recorded[2] = np.inf
    recorded[2, 1, 1] = 900.0
    recorded[3, 3:] = np.inf
    recorded[3, :, 5:] = np.inf
    side = Readings.of(scene, recorded).side
    assert np.array_equal(side == Sidedness.AT_LEAST, np.isinf(recorded))
    assert not len(outliers(scene, recorded))


def test_a_reading_near_the_rail_stays_a_bound() -> None:
    """Cells of 2 Mohm: code 0 or 1 of a divider with 10 kohm is a matter of noise."""
    scene = Scene(Panel(3, 4), TwoPointReadout(readings=1, reference_ohm=10_000.0))
    recorded = np.full((1, 3, 4), 4e6)
    recorded[0, 1, 2] = np.inf
    assert not len(outliers(scene, recorded))


def test_many_impossible_bounds_are_another_circuit() -> None:
    """Cells between grounded lines, which are read alone, in a scene of two-point readings."""
    recorded = np.full((1, 6, 8), 1000.0)
    recorded[0, ::2, ::2] = np.inf
    assert not len(outliers(SCENES["resistances alone"], recorded))
