"""The paper's solver and its methods: against scipy's, and against lampest's verified optima where they converge."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from docs.studies.as_published import Weights, left_by_solver, lsqnonlin
from lampest import Array, Bounds, Estimator, OptimalMethod, Panel, Recording, Scene, TwoPointReadout
from lampest.cost.terms import CellResistance, Gradient, Misfit, RelativeChange
from lampest.estimate.sequence import reconstruct

PANEL = Panel(4, 5)


def valley(point: Array) -> Array:
    """A valley that is curved twice."""
    return np.concatenate([10 * (point[1:] - point[:-1] ** 2), 1 - point[:-1]])


def valley_slopes(point: Array) -> Array:
    count = len(point) - 1
    slopes = np.zeros((2 * count, count + 1))
    for row in range(count):
        slopes[row, row], slopes[row, row + 1], slopes[count + row, row] = -20 * point[row], 10.0, -1.0
    return slopes


@pytest.mark.parametrize("lower", [-5.0, 0.2, 1.4])
def test_it_ends_where_scipy_does(lower: float) -> None:
    """Free, and with the bound beside and beyond the free minimum at one."""
    bound, start = np.full(4, lower), np.full(4, 3.0)
    ours = lsqnonlin(valley, valley_slopes, start, bound)
    reference = least_squares(valley, start, valley_slopes, (bound, np.inf), ftol=1e-14, xtol=1e-14, gtol=1e-14)
    assert np.all(ours.point >= bound)
    # MATLAB's default ends where a step gains less than 1e-6 of 1 + cost.
    assert np.sum(valley(ours.point) ** 2) <= (2 * reference.cost) * (1 + 1e-4) + 1e-4


def test_it_stops_at_a_hundred_evaluations_for_each_unknown() -> None:
    """A residual that falls for ever: nothing but the limit ends it, derivatives charged as differences."""
    ended = lsqnonlin(
        lambda point: 1e6 / point, lambda point: np.diag(-1e6 / point**2), np.full(3, 2.0), np.full(3, 1.0)
    )
    assert ended.why == "limit" and 300 <= ended.evaluations <= 304 and np.all(ended.point > 1e3)


def recording() -> Recording:
    """Three frames of a panel whose middle is pressed harder and harder, exact to a tenth of a percent."""
    rng = np.random.default_rng(4)
    resting = 2000 * np.exp(0.2 * rng.standard_normal(PANEL.shape))
    cells = np.stack([resting] * 3)
    cells[1:, 1:3, 1:4] *= np.array([0.6, 0.4])[:, None, None]
    readings = TwoPointReadout().exact_reading(cells) * np.exp(1e-3 * rng.standard_normal(cells.shape))
    scene = Scene(PANEL, TwoPointReadout())
    return Recording(scene, readings, np.arange(3.0), np.array([0, 1, 1], dtype=np.uint8))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "term"),
    [
        ("LSR-CR", CellResistance(weight=1e-2)),
        ("LSR-gCR", Gradient(weight=1e-2)),
        ("LSR-dCR", RelativeChange(weight=1.0)),
    ],
)
def test_where_it_converges_it_is_the_verified_optimum(method: str, term: CellResistance) -> None:
    told = recording()
    weights = Weights(absolute=1e-2, relative=1.0, start=1.5)
    left = left_by_solver(method, PANEL, told.recorded[0], told.recorded[1:], weights)
    formulation = OptimalMethod("reduced", joint=True)
    found = reconstruct(told, Estimator((Misfit(), term), formulation, bounds=Bounds(upper="none")))
    assert set(left.why) <= {"cost", "step", "gradient"} and left.joint == (method == "LSR-dCR")
    assert left.baseline == pytest.approx(found.baseline_resistance, rel=0.02)
    assert left.cells == pytest.approx(found.cell_resistance, rel=0.02)
    assert left.change == pytest.approx(found.relative_change, abs=2.0)
    model = TwoPointReadout().exact_reading(left.cells)
    assert left.data_error == pytest.approx(100 * np.abs(model / told.recorded[1:] - 1), abs=1e-9)
