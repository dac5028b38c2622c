"""The region solver with readings that are wild: they neither cost blocks of cells nor pull at a load's cells."""

import numpy as np
import pytest

from lampest import two_point_resistance
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.stream import Stream
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

SIDE, NOISE = 40, 1e-5
LOAD = (slice(14, 19), slice(20, 26))


def frames(wild: int, lone: int = 0) -> tuple[Array, Array, Array, Array]:
    """(readings at rest, readings of a load of 5 × 6 cells and so many of one cell, wild places, truth)."""
    random = np.random.default_rng(7)
    resting = 3000 * np.exp(0.1 * random.standard_normal((SIDE, SIDE)))
    loaded = resting.copy()
    loaded[LOAD] *= 0.4
    for number in range(lone):
        loaded[4 * number + 2, 3] *= 0.3
    still, measured = (
        two_point_resistance(cells) * (1 + NOISE * random.standard_normal((SIDE, SIDE))) for cells in (resting, loaded)
    )
    struck = np.zeros((SIDE, SIDE), dtype=bool)
    struck.ravel()[random.choice(SIDE**2, wild, replace=False)] = True
    struck[LOAD] = False
    measured[struck] *= 1 + 0.05 * random.choice([-1, 1], int(struck.sum()))
    return still, measured, struck, loaded


def solved(still: Array, measured: Array, formulation: str) -> Array:
    scene = Scene(Panel(SIDE, SIDE))
    estimator = Estimator((Misfit(),), formulation=formulation, error_bars=False)
    resting, frame = (Readings.of(scene, values, NOISE * values) for values in (still, measured))
    stream = Stream.begin(estimator, scene, 1.0, resting)
    return np.asarray(stream.push(frame)[1].cell_resistance)


@pytest.mark.parametrize("wild", [3, 12, 30])
def test_wild_readings_are_left_out(wild: int) -> None:
    """Few as well as many, beside the load as well as far from it: one of the three is."""
    still, measured, struck, truth = frames(wild)
    error = np.abs(solved(still, measured, "region") / truth - 1)
    assert error[struck].max() < 0.05
    assert np.median(error[LOAD]) < 0.01
    # The full solve believes every reading: a cell beside a wild one is another cell.
    assert np.abs(solved(still, measured, "reduced") / truth - 1)[struck].max() > 0.5


@pytest.mark.parametrize(("wild", "lone"), [(0, 5), (3, 3), (0, 9)])
def test_loads_of_one_cell_are_loads(wild: int, lone: int) -> None:
    """Their rows and columns have moved with them, which those of wild readings have not."""
    still, measured, _, truth = frames(wild, lone)
    found = solved(still, measured, "region")
    for number in range(lone):
        place = (4 * number + 2, 3)
        assert abs(found[place] / truth[place] - 1) < 0.05
