"""Convex pieces of kinked losses: their minimum has the conditions of one, and their way ends where no other does."""

import numpy as np
import pytest
from scipy.optimize import linprog

from lampest.cost.given import Background
from lampest.cost.losses import Absolute, Huber
from lampest.cost.problem import Evaluation
from lampest.cost.terms import Gradient, Misfit, Term, TotalVariation
from lampest.estimate.estimator import Estimator
from lampest.panel.panel import Panel
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.newton import Newton, certified
from lampest.solvers.newton.pieces import by_pieces, has_pieces
from lampest.solvers.newton.quadratic import ConvexPiece
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.newton.steps import Iterate
from lampest.solvers.search import best_solution
from lampest.solvers.solution import Settings, Status, check

CELLS, ROWS = 12, 30


def piece(seed: int, heavy: float = 1.0) -> ConvexPiece:
    """Scattered rows, a third of them with corners, a third `heavy` times as heavy and some of these twice."""
    random = np.random.default_rng(seed)
    root, slopes = random.standard_normal((5, CELLS)), random.standard_normal((ROWS, CELLS))
    slopes[20:25] = slopes[25:30]
    residual, corner = random.standard_normal(ROWS), np.where(np.arange(ROWS) < 10, 0.3, 0.0)
    residual[20:25] = residual[25:30]
    slopes[20:] *= heavy
    residual[20:] *= heavy
    bound = np.full(CELLS, 0.4)
    return ConvexPiece(random.standard_normal(CELLS), root.T @ root, residual, slopes, corner, -bound, bound)


@pytest.mark.parametrize("heavy", [1.0, 1e4, 1e8])
@pytest.mark.parametrize("seed", range(4))
def test_the_least_of_a_piece(seed: int, heavy: float) -> None:
    """g + B s + Aᵀz presses against bounds alone, and z is a slope of every row's ρ."""
    own = piece(seed, heavy)
    step, dual = own.least()
    force = own.gradient + own.squares @ step + own.slopes.T @ dual
    free = (step > own.low + 1e-6) & (step < own.high - 1e-6)
    digits = max(1e-6, 1e-13 * heavy)
    assert np.abs(force[free]).max(initial=0.0) < digits
    assert np.all(force[step <= own.low + 1e-6] > -digits) and np.all(force[step >= own.high - 1e-6] < digits)
    left = own.residual + own.slopes @ step - own.corner * dual
    assert np.all(np.abs(dual) <= 1)
    assert np.abs(left * (np.sign(left) - dual)).max() < digits
    moves = 1e-3 * np.random.default_rng(9).standard_normal((50, CELLS))
    assert all(own.value(np.clip(step + move, own.low, own.high)) >= own.value(step) - 1e-9 for move in moves)


def test_without_squares_it_is_a_linear_program() -> None:
    own = piece(7)
    flat = ConvexPiece(own.gradient, 0 * own.squares, own.residual, own.slopes, 0 * own.corner, own.low, own.high)
    found = linprog(
        np.concatenate([own.gradient, np.ones(2 * ROWS)]),
        A_eq=np.hstack([own.slopes, -np.eye(ROWS), np.eye(ROWS)]),
        b_eq=-own.residual,
        bounds=[*zip(own.low, own.high, strict=True), *[(0, None)] * (2 * ROWS)],
    )
    assert flat.value(flat.least()[0]) == pytest.approx(found.fun, rel=1e-9)


WEIGHTS = [1e-9, 1e-3, 1.0, 1e3, 1e6, 1e12]


def begun(terms: tuple[Term, ...], shape: tuple[int, int] = (5, 6)) -> tuple[Estimator, Scene, Evaluation]:
    """The cost at the uniform start, readings with noise of a third of a percent."""
    random, scene = np.random.default_rng(5), Scene(Panel(*shape))
    cells = 3000 * np.exp(0.2 * random.standard_normal(shape))
    cells[2:4, 2:] *= 0.3
    exact = scene.circuit.exact_reading(cells)[None]
    measured, nothing = exact * (1 + 0.003 * random.standard_normal(exact.shape)), np.zeros(exact.shape)
    estimator = Estimator(terms, formulation="reduced")
    data = estimator.data(Readings(measured, 0.003 * exact, nothing, nothing + 1), Background(scene))
    return estimator, scene, Evaluation.at(estimator.cost(scene, 1, data.partial), data, data.uniform_start)


@pytest.mark.parametrize("weight", WEIGHTS)
@pytest.mark.parametrize("penalty", [TotalVariation, Gradient])
def test_absolute_losses_of_readings_and_of_penalties(penalty: type[Term], weight: float) -> None:
    """At any weight, kinks of both; and the way by pieces alone ends where the whole search does."""
    misfit = Misfit(weighting="noise", loss=Absolute())
    estimator, scene, start = begun((misfit, penalty(weight=weight)))  # type: ignore[call-arg]
    found = best_solution(estimator.problem(scene, 1, 1.0, start.data.partial), start.data, None)
    assert found.status is Status.OPTIMUM
    smoothing = Smoothing.start(start)
    ended, whole, _ = by_pieces(Iterate(Curvature(start, smoothing), smoothing.objective(start), 0.0), start.data)
    assert whole and check(start, certified(ended, 1)).solved
    assert ended.objective == pytest.approx(found.objective, rel=1e-6)


def test_corners_alone_are_handed_back_to_newton() -> None:
    """Without a kink nothing is certified here: it ends so near that Newton's method takes few steps."""
    _, _, start = begun((Misfit(weighting="noise", loss=Huber(corner=1.5)), Gradient(weight=1e-3)))
    assert has_pieces(start.cost, start.cell_resistance.size)
    ended, whole, count = by_pieces(Iterate(Curvature(start, Smoothing.start(start)), start.objective, 0.0), start.data)
    solver = Newton(start.cost, Settings())
    near, found = (solver.solve(start.data, at) for at in (ended.at, start))
    assert not whole and count < 60 and near.iterations <= 12
    np.testing.assert_allclose(near.cell_resistance, found.cell_resistance, rtol=1e-6)
