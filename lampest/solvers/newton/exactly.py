"""From a point where absolute losses are still rounded to the minimum where they are not, in a few Newton steps.

Which rows stand at their kink, and on which side the others lie, is read off the point and mended after every step: a
row whose residual changes its sign joins them, one whose dual leaves ±1 goes.
Source: Hintermüller, Ito & Kunisch, SIAM J. Optim. 13, 2003 (primal-dual active sets).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.solvers.certificate import Bend, at_kinks, free_cells
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.kinks import AT_ZERO, Kinks, Straight, standing
from lampest.solvers.newton.reach import within_reach
from lampest.solvers.newton.squares import ORTHOGONAL_UNKNOWNS
from lampest.solvers.newton.steps import SHARES, Iterate

MOST_ROUNDS = 12  # near the minimum two or three
MOST_MENDED, FEW = 0.05, 4  # of all rows, and rows: where more are mended in a round it leads astray
LONGEST = 1.0  # of log r: rows were told apart where the steps began
LAST = 1e-7  # of log r: such a Newton step leaves rounding
MET = 1e-6  # of a residual, what a step to its kink leaves; of those that depend on heavier ones more is left
BALANCED = 1e-8  # of the test of optimality's scale


def exactly(point: Iterate, data: Data) -> Iterate | None:
    """The minimum near a point, its duals with it and its certificate; None where the steps do not end at one."""
    if not len(point.at.rough) or point.at.cell_resistance.size > ORTHOGONAL_UNKNOWNS:
        return None
    at, dual = point.at, point.curvature.smoothing.slope(point.at.rough)
    kinked = standing(at, dual)
    for _ in range(MOST_ROUNDS):
        dual = np.where(kinked, np.clip(dual, -1, 1), np.sign(at.rough))
        move = _move(Curvature(at, Straight(0.0, dual)), kinked)
        longest = float(np.abs(move.step).max(initial=0.0))
        mended = np.count_nonzero(move.kinked != kinked)
        if not np.isfinite(longest) or mended > max(FEW, MOST_MENDED * len(dual)):
            return None
        step = move.step * min(1.0, LONGEST / max(longest, LONGEST))
        there = _there(at, data, step) if not move.falls else _lower(at, data, step)
        if there is None:
            return None
        at, dual, kinked = there, move.dual, move.kinked
        if longest <= LAST and not mended and not move.falls:
            return _ended(point, at, np.clip(dual, -1, 1))
    return None


@dataclass(frozen=True, eq=False)
class Move:
    """step : (cells) of log r. falls : whether the cost bends down there. dual, kinked : of the rows, after it."""

    step: Array
    falls: bool
    dual: Array
    kinked: NDArray[np.bool_]


def _move(curvature: Curvature, kinked: NDArray[np.bool_]) -> Move:
    at, gradient = curvature.at, curvature.gradient
    free = np.flatnonzero(free_cells(at, gradient))
    kinks = Kinks.of(curvature, kinked, free)
    found = at_kinks(curvature, gradient, free, kinks)
    step, falls = found.step, found.bend is Bend.DOWN
    if falls:
        step = np.zeros_like(gradient)
        matrix = curvature.matrix[np.ix_(free, free)]
        step[free] = kinks.back + kinks.along @ within_reach(*kinks.reduced(matrix, gradient[free]), LONGEST)
    left = gradient[free] + (curvature.matrix @ step)[free]
    dual = kinks.balanced(curvature.smoothing.dual, left, at.cost.slope)
    both = [at.cell_resistance.ravel() * step, curvature.forward(step).ravel()]
    residual = at.rough + curvature.smoothing.jacobian(at) @ np.concatenate(both)
    kept = np.abs(residual) <= np.maximum(MET * np.abs(at.rough), AT_ZERO * at.rough_reach)
    crossed = ~kinked & (residual * curvature.smoothing.dual < 0)
    dual = np.where(kinked & ~kept, np.sign(residual), dual)
    return Move(step, falls, dual, (kinked & kept & ~_released(at, kinked, dual)) | crossed)


def _released(at: Evaluation, kinked: NDArray[np.bool_], dual: Array) -> NDArray[np.bool_]:
    """(rows) which leave their kink: duals beyond ±1; of those only the farthest where readings have absolute losses.

    There nothing but kinks holds cells, and each of them can spare but one.
    """
    beyond = kinked & (np.abs(dual) > 1)
    if not beyond.any() or not any(term.reads_measurement and term.loss.enters == "dual" for term in at.cost.terms):
        return beyond
    return np.asarray(beyond & (np.abs(dual) == np.abs(dual[beyond]).max()))


def _there(at: Evaluation, data: Data, step: Array) -> Evaluation | None:
    low, high = (bound.ravel() for bound in data.log_bounds)
    cells = np.exp(np.clip(at.position.ravel() + step, low, high)).reshape(at.cell_resistance.shape)
    try:
        return at.elsewhere(np.clip(cells, data.lower, data.upper))
    except np.linalg.LinAlgError:
        return None


def _lower(at: Evaluation, data: Data, step: Array) -> Evaluation | None:
    """Where the cost is lower, as far along a step as may be."""
    found = (_there(at, data, share * step) for share in SHARES)
    return next((one for one in found if one is not None and one.objective < at.objective), None)


def _ended(point: Iterate, at: Evaluation, dual: Array) -> Iterate | None:
    """The minimum as an iterate, where it is one, and no higher than the point."""
    ended = Iterate(Curvature(at, Straight(0.0, dual)), at.objective, 0.0)
    balanced = ended.residual() <= BALANCED or ended.converged
    lower = at.objective <= point.objective + at.rounding
    found = ended.certificate
    return ended if balanced and lower and (found.settled or found.bend is Bend.FLAT) else None
