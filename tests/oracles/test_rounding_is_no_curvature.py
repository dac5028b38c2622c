"""Where second derivatives are rounding nothing is verified: clusters, checkerboards, blocks, stripes of any contrast.

Exact readings of panels whose parts are so far apart that large readings' rounding outweighs what small ones bend.
"""

import numpy as np
import pytest
from scipy.linalg import lapack

from lampest import Array, Bounds, Estimator, Misfit, Panel, Readings, Scene, Stream
from lampest.cost.cost import Cost
from lampest.cost.given import Background, Given
from lampest.cost.problem import Data, Evaluation
from lampest.solvers.certificate import clear_of_rounding
from lampest.solvers.solution import Outcome, Status, check


def drawn(number: int) -> Array:
    """Cells (rows, columns) ohm in one of four patterns, up to nine decades apart."""
    random = np.random.default_rng([8, number])
    shape = rows, columns = random.integers(3, 8, 2)
    down, along = np.indices(shape)
    cut = down < random.integers(1, rows), along < random.integers(1, columns)
    patterns = (cut[0] != cut[1], (down + along) % 2 == 1, cut[0] & cut[1], down % 2 == 1)
    usual = 3000 * np.exp(random.choice([0.05, 0.3]) * random.standard_normal(shape))
    return np.asarray(np.where(patterns[number % 4], 10 ** random.uniform(3, 9), 1.0) * usual)


@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
@pytest.mark.parametrize("number", range(16))
def test_verified_readings_are_met(number: int, formulation: str) -> None:
    cells = drawn(number)
    scene = Scene(Panel(*cells.shape))
    measured = scene.circuit.exact_reading(cells)
    estimator = Estimator((Misfit(),), formulation=formulation, bounds=Bounds(upper="none"))
    baseline = Stream.begin(estimator, scene, 1.0, Readings.of(scene, measured)).baseline
    found = baseline.solution
    assert (
        found.status is not Status.OPTIMUM
        or np.abs(scene.circuit.exact_reading(found.cell_resistance[0]) / measured - 1).max() < 1e-6
    )


@pytest.mark.parametrize("off", [1e-1, 1e-3, 1e-4])
@pytest.mark.parametrize("number", range(16))
def test_small_cells_that_are_off_are_never_verified(number: int, off: float) -> None:
    """Cells of the smaller kind scattered by `off`, which only their own small readings show."""
    cells = drawn(number)
    scene = Scene(Panel(*cells.shape))
    measured = scene.circuit.exact_reading(cells)
    given = Given.of(Readings.of(scene, measured).alone(), Background(scene))
    data = Data(given, measured[None] * 1e-6, measured[None] * 1e6)
    scatter = off * np.random.default_rng(number).standard_normal(cells.shape)
    places = np.where(cells < 10 * cells.min(), cells * np.exp(scatter), cells)
    at = Evaluation.at(Cost(scene.panel, (Misfit(),), 1), data, places[None])
    assert check(at, Outcome(places[None], np.zeros(0), Status.OPTIMUM, 1)).status is not Status.OPTIMUM


def test_a_factor_may_succeed_on_rounding() -> None:
    """Forty cells of which only neighbours' differences are told: no pivot is small, the smallest bend is 10⁻¹³."""
    count = 40
    random = np.random.default_rng(2)
    vectors = np.linalg.qr(random.standard_normal((count, count)))[0]
    for least, clear in ((1e-13, False), (1e-6, True)):
        matrix = vectors @ np.diag(np.r_[least, np.linspace(0.5, 1.5, count - 1)]) @ vectors.T
        size = np.sqrt(np.diag(matrix))
        unit = matrix / size[:, None] / size
        triangle, failed = lapack.dpotrf(unit)
        norm = float(np.abs(unit).sum(axis=0).max())
        assert not failed and clear_of_rounding(triangle, norm) is clear
