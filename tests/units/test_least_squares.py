"""The least-squares loop against scipy's, and what its docstring promises."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array

TIMES = np.linspace(0.0, 2.0, 9)
LOOP = LevenbergMarquardt(evaluations=200, settled=1e-20)


def decay(unknowns: Array) -> Array:
    """Residuals of a decay of which the amplitude is 2, the rate 1.5 and the offset 0.3."""
    amplitude, rate, offset = unknowns
    return np.asarray(
        amplitude * np.exp(-rate * TIMES) + offset - (2 * np.exp(-1.5 * TIMES) + 0.3 + 0.01 * np.sin(TIMES))
    )


def decayed(unknowns: Array) -> SumOfSquares:
    amplitude, rate, _ = unknowns
    falling = np.exp(-rate * TIMES)
    return SumOfSquares(decay(unknowns), np.column_stack([falling, -amplitude * TIMES * falling, np.ones(len(TIMES))]))


def rosenbrock(unknowns: Array) -> SumOfSquares:
    x, y = unknowns
    return SumOfSquares(np.array([10 * (y - x**2), 1 - x]), np.array([[-20 * x, 10.0], [-1.0, 0.0]]))


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_minimum_is_that_of_scipy(damping: float) -> None:
    start = np.array([1.0, 0.5, 0.0])
    found = LevenbergMarquardt(200, 1e-20, damping=damping).minimum(decayed, start)
    theirs = least_squares(decay, start, ftol=1e-15, xtol=1e-15, gtol=1e-15)
    assert np.allclose(found.position, theirs.x, rtol=1e-7) and np.isclose(found.at.cost, theirs.cost, rtol=1e-10)


def test_curved_valley_is_followed_to_its_end() -> None:
    found = LOOP.minimum(rosenbrock, np.array([-1.2, 1.0]))
    assert np.allclose(found.position, 1, atol=1e-8) and found.evaluations < 60


def test_bounds_that_are_active_hold_and_the_others_settle() -> None:
    bounds = np.array([0.0, 0.0, 0.5]), np.array([5.0, 1.2, 5.0])
    found = LOOP.minimum(decayed, np.array([1.0, 0.5, 1.0]), bounds)
    theirs = least_squares(decay, [1.0, 0.5, 1.0], bounds=bounds, ftol=1e-15, xtol=1e-15, gtol=1e-15)
    assert np.isclose(found.at.cost, theirs.cost, rtol=1e-6)
    assert np.all(found.position >= bounds[0]) and np.all(found.position <= bounds[1])


def test_steps_evaluations_and_end_are_kept() -> None:
    seen: list[Array] = []

    def model(unknowns: Array) -> SumOfSquares:
        seen.append(unknowns)
        return rosenbrock(unknowns)

    loop = LevenbergMarquardt(7, 0.0, longest=np.array([0.1, 0.4]))
    assert loop.minimum(model, np.array([-1.2, 1.0])).evaluations == len(seen) == 7
    assert np.all(np.abs(seen[1] - seen[0]) <= [0.1 + 1e-12, 0.4 + 1e-12])
    assert LOOP.minimum(rosenbrock, np.array([-1.2, 1.0]), ended=lambda at, count: at.cost < 1).at.cost < 1


def test_unknown_that_no_residual_sees_stays() -> None:
    def model(unknowns: Array) -> SumOfSquares:
        return SumOfSquares(unknowns[:1] - 3.0, np.array([[1.0, 0.0]]), ridge=1e-9)

    for loop in (LOOP, LevenbergMarquardt(9, 1e-12, damping=0.0)):
        assert np.allclose(loop.minimum(model, np.array([1.0, 7.0])).position, [3.0, 7.0], atol=1e-6)


def test_points_without_a_number_are_not_taken() -> None:
    def model(unknowns: Array) -> SumOfSquares:
        return SumOfSquares(np.log(unknowns) if unknowns[0] > 0 else np.array([np.nan]), 1 / unknowns[None])

    assert np.isclose(LOOP.minimum(model, np.array([3.0])).position[0], 1.0)
