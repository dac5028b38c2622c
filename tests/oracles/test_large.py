"""Solves of larger panels, by conjugate gradients and the interior point method."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import (
    Array,
    Estimator,
    Panel,
    Readings,
    Scene,
    Settings,
    Status,
    two_point_resistance,
)
from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.cost.terms import (
    Gradient,
    Misfit,
)
from lampest.panel.readouts import TwoPointReadout, floating
from lampest.solvers import hessian, interior_point, projected_newton
from lampest.solvers.interior_point import Barrier, central_path
from lampest.solvers.multistart import solved_from

SAME_COST = 1e-6  # relative, or absolute where the cost is all but zero: optima agree to it
STEP = 1e-6  # of differences, relative
MAX_ITERATIONS = 40  # for 360 cells, of which 64 have negative curvature
FAR_BELOW = 0.1  # of the cost of equal cells


@pytest.fixture
def by_products(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small panels are solved as large ones are, by products."""
    for module, name in (
        (hessian, "DENSE_CELLS"),
        (hessian, "MATRIX_CELLS"),
        (floating, "DENSE_CELLS"),
    ):
        monkeypatch.setattr(module, name, 0)


def crowded(noise: float, seed: int, shape: tuple[int, int] = (6, 7)) -> Evaluation:
    """Return the readings' own start with relative noise that holds many cells at a bound."""
    generator = np.random.default_rng(seed)
    scene = Scene(Panel(*shape), TwoPointReadout())
    exact = two_point_resistance(3000 * np.exp(0.2 * generator.standard_normal(shape)))
    value = np.maximum(exact * (1 + noise * generator.standard_normal(shape)), 10)[None]
    estimator = Estimator((Misfit(),), formulation="reduced")
    data = estimator.data(Readings.of(scene, value, noise * exact[None]), Background(scene))
    return Evaluation.at(estimator.cost(scene, 1, partial=data.partial), data, data.start())


@pytest.mark.slow
@pytest.mark.usefixtures("by_products")
@pytest.mark.parametrize(
    ("seed", "noise", "shape", "iterations", "crowd"),
    [
        (1, 0.3, (6, 7), (12, 13), 19),
        (0, 1.0, (6, 7), (21, 22), 39),
        (8, 0.3, (18, 20), (17, 17), 290),
    ],
)
def test_the_interior_point_method_and_the_projected_method_agree(
    seed: int,
    noise: float,
    shape: tuple[int, int],
    iterations: tuple[int, int],
    crowd: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It puts the cells at their bounds that belong there, which leaves no search for them."""
    start = crowded(noise, seed, shape)
    point, steps = central_path(start)
    solver = projected_newton.ProjectedNewton(start.cost, Settings())
    inside = solved_from(solver, start)
    assert (steps, inside.iterations, inside.open_cell.sum()) == (*iterations, crowd)
    assert np.array_equal(point.cell_resistance >= point.data.upper, inside.open_cell)
    monkeypatch.setattr(projected_newton, "crowds_bounds", lambda start: False)
    stopped = solved_from(solver, start)
    assert inside.solved and inside.status is stopped.status
    assert inside.objective == pytest.approx(stopped.objective, rel=1e-2 * SAME_COST)


@pytest.fixture
def barrier(by_products: None, monkeypatch: pytest.MonkeyPatch) -> Barrier:
    """An interior point whose next step is exact, however little room bounds leave it."""
    monkeypatch.setattr(interior_point, "MIN_STEP", 0.0)
    monkeypatch.setattr(interior_point, "ACCURACY", 1e-12)
    return Barrier.of(crowded(0.3, 3))


def by_differences(barrier: Barrier, function: Callable[[Barrier], Any]) -> Array:
    """Central differences of a function of the point over each conductance, one row for each."""
    rows = []
    for cell, conductance in np.ndenumerate(barrier.conductance):
        sides = []
        for sign in (1, -1):
            moved = barrier.conductance.copy()
            moved[cell] += sign * STEP * conductance
            sides.append(np.ravel(function(replace(barrier, at=barrier.at.elsewhere(1 / moved)))))
        rows.append((sides[0] - sides[1]) / (2 * STEP * conductance))
    return np.stack(rows)


def test_a_step_of_the_barrier_solves_its_newton_equations(barrier: Barrier) -> None:
    """With JᵀWJ at the start, and with second derivatives, indefinite there, after one step."""
    push = np.random.default_rng(1).standard_normal(barrier.conductance.shape) / barrier.conductance
    later = barrier.advanced()
    assert later is not None
    size = np.outer(barrier.conductance, barrier.conductance)
    matrices = [
        barrier.hessian.gauss_newton_matrix / size,
        by_differences(later, lambda at: at.gradient),
    ]
    for point, matrix in zip((barrier, later), matrices, strict=True):
        expected = np.linalg.solve(matrix + np.diag(point.stiffness.ravel()), push.ravel())
        assert_allclose(point.newton_step(push).ravel() / expected, 1, atol=10 * STEP)


def test_negative_curvature_under_a_large_mouth_is_overcome() -> None:
    """In log r the cost of LSR-∇CR is concave under a patch of a hundredth of its resistance."""
    truth = 3000 * np.exp(0.2 * np.random.default_rng(4).standard_normal((18, 20)))
    truth[4:12, 5:13] *= 0.01
    scene = Scene(Panel(18, 20), TwoPointReadout())
    readings = two_point_resistance(truth)[None]
    estimator = Estimator((Misfit(), Gradient(weight=1e-3)), formulation="reduced")
    data = estimator.data(Readings.of(scene, readings), Background(scene))
    start = Evaluation.at(estimator.cost(scene, 1, partial=False), data, data.uniform_start)
    solution = projected_newton.ProjectedNewton(start.cost, Settings()).solve(start.data, start)
    assert solution.status is Status.OPTIMUM and solution.iterations < MAX_ITERATIONS
    assert start.elsewhere(solution.cell_resistance).objective < FAR_BELOW * start.objective
