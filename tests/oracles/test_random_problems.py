"""Random problems of every kind: no estimate costs more than what anything else finds, and each has one or a sentence.

`python -m tests.studies.random_problems` is the same for a thousand.
"""

from dataclasses import replace

import numpy as np
import pytest

from lampest.solvers.multistart import best_solution, evaluated, solved_from
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Status
from tests.random_problem import RandomProblem
from tests.studies.random_problems import examine

SMALL = 40  # cells: problems that are solved in every way within a second
FEW = [number for number in range(110) if np.prod(RandomProblem.drawn(11, number).cells.shape[1:]) <= SMALL][:40]
# Ended without an estimate once, as (seed, number): gradients that a heavy penalty multiplies are rounding.
ROUNDED = [(1, 17), (1, 21), (2, 19), (2, 28), (2, 35), (2, 45)]


@pytest.mark.parametrize("number", [0, 3, 17, 36, 60])
def test_the_cost_is_that_of_the_second_statement(number: int) -> None:
    """At a point that is no optimum, and its derivatives by differences."""
    problem = RandomProblem.drawn(11, number)
    oracle = problem.oracle
    place = np.log(problem.data.uniform_start).ravel() + 0.1 * np.random.default_rng(number).standard_normal(
        problem.data.measured.size
    )
    value, slope = oracle.as_squares(place, 0.0)
    assert np.sum(value**2) == pytest.approx(oracle.value(place), rel=1e-12)
    step = 1e-6 * np.random.default_rng(1).standard_normal(len(place))
    sides = [oracle.as_squares(place + sign * step, 0.0)[0] for sign in (1, -1)]
    by_differences = (sides[0] - sides[1]) / 2
    np.testing.assert_allclose(slope @ step, by_differences, atol=1e-5 * np.abs(by_differences).max())


# Ended without an estimate once: kinks of readings and of penalties at once; cells tied loosely by a heavy penalty that
# met their bounds one by one; a plateau across which nothing but rounding is left of the gradient.
UNSOLVED = [(31, 28), (31, 36), (31, 183), (31, 576), (31, 714), (31, 173), (31, 218), (53, 61)]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "number"), [*((11, number) for number in FEW if number != 6), *ROUNDED, *UNSOLVED])
def test_no_other_solver_finds_less(seed: int, number: int) -> None:
    found = examine(seed, number)
    if not found.asked:
        return
    assert found.verdict in ("equal", "better") or found.status == Status.ROUNDED.name, found


@pytest.mark.slow
def test_a_large_joint_pair_of_noisy_readings_ends() -> None:
    """Two frames of 19 × 18 cells, readings off by 5 % of unknown noise: once it took all iterations."""
    problem = replace(RandomProblem.drawn(97, 130), joint=True)
    cost = problem.estimator.cost(problem.scene, 2, partial=problem.data.partial)
    found = solved_from(
        ProjectedNewton(cost, problem.estimator.solver), evaluated(cost, problem.data, problem.data.uniform_start)
    )
    assert found.optimum and found.iterations < 150


@pytest.mark.slow
@pytest.mark.parametrize("number", [190, 247])
def test_as_many_starts_as_are_asked_for(number: int) -> None:
    """A comparison with the frame before, read in volts; plain squares of readings that cells cannot meet."""
    problem = RandomProblem.drawn(97, number)
    assert problem.asked is not None
    cost, oracle = problem.estimator.cost(problem.scene, 1, partial=problem.data.partial), problem.oracle
    solver = ProjectedNewton(cost, replace(problem.estimator.solver, starts=9))
    solution = best_solution(solver, problem.data, None)
    assert solution.starts == 9
    for place in (np.log(problem.cells[problem.pushed]), np.log(problem.data.uniform_start)):
        start = evaluated(cost, problem.data, np.exp(place).reshape(1, *place.shape[-2:]))
        least = oracle.value(np.log(solved_from(solver, start).cell_resistance).ravel())
        assert oracle.value(np.log(solution.cell_resistance).ravel()) <= least * (1 + 1e-6)
