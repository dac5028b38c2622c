"""Where a point may move: free cells, steps within the bounds, and whether the cost falls along a direction."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array

LENGTHS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of log r, of the cell that moves most
STILL = 1e-12  # of the cost's scale: a smaller decrease is its rounding


def free_cells(at: Evaluation, gradient: Array) -> NDArray[np.bool_]:
    """(cells) those that have room and that the gradient does not press against a bound, flat."""
    lower, upper = (bound.ravel() for bound in at.data.log_bounds)
    position = at.position.ravel()
    free: NDArray[np.bool_] = (lower < upper) & ~(
        ((position <= lower) & (gradient > 0)) | ((position >= upper) & (gradient < 0))
    )
    return free


def within_bounds(at: Evaluation, free: NDArray[np.intp], step: Array) -> Array:
    """(cells) the step of the free cells as far as bounds let it."""
    position = at.position.ravel()
    target = position.copy()
    target[free] += step
    lower, upper = (bound.ravel() for bound in at.data.log_bounds)
    return np.asarray(np.minimum(np.maximum(target, lower), upper) - position)


def downhill(at: Evaluation, along: Array) -> Evaluation | None:
    """A point from u forth or back along a direction (cells) where the cost is lower; None where there is none."""
    least = _certain_cost(at) - STILL * at.cost_scale
    return next((one for one in _beside(at, along) if _certain_cost(one) < least), None)


def _certain_cost(at: Evaluation) -> float:
    """φ without the last bits of residuals with an absolute loss."""
    if not len(at.rough):
        return at.objective
    return at.objective - float(np.sum(at.cost.slope * np.minimum(np.abs(at.rough), at.last_bits)))


def _beside(at: Evaluation, along: Array) -> Iterator[Evaluation]:
    size = float(np.abs(along).max(initial=0.0)) or 1.0
    for share in (sign * length / size for length in LENGTHS for sign in (1.0, -1.0)):
        if (found := moved_by(at, share * along)) is not None:
            yield found


def moved_by(at: Evaluation, step: Array) -> Evaluation | None:
    """The cost after a step of u (flat), within the bounds; None where its network cannot be solved."""
    cells = np.exp(at.position + step.reshape(at.position.shape))
    try:
        return at.elsewhere(np.clip(cells, at.data.lower, at.data.upper))
    except np.linalg.LinAlgError:
        return None
