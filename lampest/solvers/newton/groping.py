"""The next point: a damped Newton step, and, where that would grope, a step of least squares if it leads lower.

Where the cost bends down, or its bends are rounding, damping goes along a valley for hundreds of steps. The squares of
the residuals never bend down.
"""

import numpy as np

from lampest.cost.problem import Data
from lampest.solvers.certificate import free_cells
from lampest.solvers.newton.squares import Squares
from lampest.solvers.newton.steps import Iterate, advance, trial
from lampest.solvers.newton.ways import LONGEST_STEP

DAMPINGS, SHARES = (0.0, 1e-3, 0.1), (1.0, 0.3, 0.1)


def advanced(point: Iterate, data: Data, residual: float) -> Iterate | None:
    """The lower of both; None where neither lowers the cost. On large panels by Newton's method alone."""
    moved = advance(point, data, residual)
    if not point.curvature.factored or (moved is not None and moved.factor is not None):
        return moved
    other = by_squares(point, data, residual)
    if moved is None or other is None:
        return moved or other
    return other if other.objective < moved.objective else moved


def by_squares(point: Iterate, data: Data, residual: float) -> Iterate | None:
    """The point after the least damped step that lowers the cost; None where none does."""
    slope = point.curvature.gradient
    free = np.flatnonzero(free_cells(point.at, slope))
    if not len(free):
        return None
    low, high = (bound.ravel() for bound in data.log_bounds)
    position, step = point.at.position.ravel(), np.zeros(len(slope))
    squares = Squares.of(point.curvature, free)
    for damping in DAMPINGS:
        step[free] = np.clip(squares.step(damping), -LONGEST_STEP, LONGEST_STEP)
        for share in SHARES:
            target = np.clip(position + share * step, low, high)
            found = trial(point, data, target, 0.0, residual, -float(slope @ (target - position)))
            if found is not None:
                return found
    return None
