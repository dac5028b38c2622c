"""Where solves start, and which of several minima is taken."""

from dataclasses import replace

import numpy as np

from lampest.cost import Cost
from lampest.kirchhoff import uniform_factor
from lampest.panel import Array
from lampest.problem import Data, Evaluation
from lampest.solvers.convex import convex_start
from lampest.solvers.newton import Newton
from lampest.solvers.solution import VERIFIED, Settings, Solution, Solver, Status, check
from lampest.terms.misfit import Misfit

POLISHED = 0.1 * VERIFIED
LAST_STEPS = Settings(max_iterations=20)


def best_solution(solver: Solver, data: Data, previous: Array | None) -> Solution:
    """The solution from the cheapest start; where the cost has several minima and the solve is hard, of all starts.

    Starts are the previous estimate, r = R_m·MN/(M + N − 1), and the convex one where it is near the answer: without a
    previous frame, or without a penalty. A solve is hard that has no previous frame, fails or takes many iterations;
    then the reduced solver tries all starts, and `solver` goes on from the best of them.
    """
    relative = any(term.needs_previous for term in solver.cost.terms)
    plain = all(isinstance(term, Misfit) for term in solver.cost.terms)
    starts = [data.measured / uniform_factor(*data.measured.shape[1:])]
    starts += [convex(data)] if previous is None or plain else []
    starts += [] if previous is None else [previous]
    points = sorted((evaluated(solver.cost, data, start) for start in starts), key=lambda point: point.objective)
    found = None if relative and previous is None else solved(solver, points[0])
    if found is not None and found.solved and not (relative and found.iterations > solver.easy):
        return found
    points += [] if previous is None or plain else [evaluated(solver.cost, data, convex(data))]
    scouts = [solved(Newton(solver.cost, solver.settings), point) for point in points]
    best = min((scout for scout in scouts if scout.solved), key=lambda scout: scout.objective, default=None)
    if best is None:
        return found or solved(solver, points[0])
    if found is not None and found.solved and not best.objective < found.objective * (1 - 1e-9):
        return found
    return best if isinstance(solver, Newton) else solved(solver, evaluated(solver.cost, data, best.cell_resistance))


def convex(data: Data) -> Array:
    """The convex start of every frame."""
    return np.stack([convex_start(*pair) for pair in zip(data.measured, data.upper, strict=True)])


def evaluated(cost: Cost, data: Data, start: Array) -> Evaluation:
    """The cost at a start that is put within the bounds."""
    return Evaluation.at(cost, data, np.clip(start, data.lower, data.upper))


def solved(solver: Solver, start: Evaluation) -> Solution:
    """Solve from one start, and, where an interior-point method stopped short of its bounds, take the last steps."""
    outcome = solver.solve(start.data, start)
    solution = check(start, outcome)
    if solution.kkt_residual <= POLISHED or isinstance(solver, Newton) or outcome.status is not Status.OPTIMUM:
        return solution
    near = evaluated(solver.cost, start.data, outcome.cell_resistance)
    finished = Newton(solver.cost, LAST_STEPS).solve(start.data, near)
    polished = check(start, replace(finished, iterations=outcome.iterations))
    return polished if polished.solved else solution
