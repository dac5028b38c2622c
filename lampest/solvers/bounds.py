"""Bounds of cells: active set, projected steps, and bounds that leave readings unexplained.

The multiplier of an active bound is the remaining gradient.
Source: Nocedal & Wright, Numerical Optimization, 2006, section 12.3 (multipliers as sensitivities).
"""

import numpy as np

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import backtracked

MILLIONTH = 1e-6  # relative error that a reading or a cell may have where the noise is not known
MAX_LENGTHS = 8  # tried lengths of a step that changes log r of the cell that moves most by 1
MIN_DECREASE_SHARE = 1e-12  # of the cost's scale: a smaller decrease is rounding


def free_cells(at: Evaluation, gradient: Array) -> Mask:
    """Return the cells that can move and that no bound holds, boolean (…, cells).

    A bound holds a cell if the cell is at the bound and the descent of the cost points beyond it.
    `gradient` is ∂φ/∂u, u = log r, (…, cells).
    """
    lower, upper = at.data.log_bounds
    slope = gradient.reshape(at.position.shape)
    held = ((at.position <= lower) & (slope > 0)) | ((at.position >= upper) & (slope < 0))
    free = (lower < upper) & ~held
    return free.reshape(gradient.shape)


def within_bounds(at: Evaluation, free: Numbers, step: Array) -> Array:
    """Return a step of the free cells in u, clipped to the bounds, as a step of all cells.

    The free cells are given as numbers; the step returned has the shape (cells,).
    """
    position = at.position.ravel()
    target = position.copy()
    target[free] += step
    return np.clip(target, *(bound.ravel() for bound in at.data.log_bounds)) - position


def lower_along(at: Evaluation, along: Array) -> Evaluation | None:
    """Return a point of lower cost forward or backward along a direction (cells,) of u.

    Returns None if neither side has such a point.
    """
    least = at.objective - MIN_DECREASE_SHARE * at.cost_scale
    size = np.abs(along).max(initial=0.0) or 1.0

    def lower(length: float) -> Evaluation | None:
        for sign in (1.0, -1.0):
            point = moved_by(at, sign * length / size * along)
            if point is not None and point.objective < least:
                return point
        return None

    return backtracked(lower, MAX_LENGTHS)


def moved_by(at: Evaluation, step: Array) -> Evaluation | None:
    """Return the evaluation after a step of u (flat), clipped to the bounds.

    Returns None if the network cannot be solved there.
    """
    cells = np.exp(at.position + step.reshape(at.position.shape))
    try:
        return at.elsewhere(np.clip(cells, at.data.lower, at.data.upper))
    except np.linalg.LinAlgError:
        return None


def bounds_matter(at: Evaluation, gradient: Array, dual: Array) -> bool:
    """Return whether active bounds are the reason why a reading deviates by more than its noise.

    With squared losses and no penalty this holds for every such reading. Otherwise three conditions
    hold for the reading's own cell: its bound is active, the reading pulls the cell beyond the
    bound, and the multiplier of the bound is at least half of the pull of all readings.

    Parameters
    ----------
    at : Evaluation
    gradient : array, shape (frames, rows, columns)
        ∂φ/∂u, u = log r.
    dual : array
        Duals of the absolute losses.
    """
    lower, upper = at.data.log_bounds
    held = (lower < upper) & ~free_cells(at, gradient)
    if not held.any():
        return False
    # Readings that deviate by more than their noise; one-sided ones deviate only where they are
    # violated.
    data = at.data
    limit = data.deviation if data.noise_known else MILLIONTH * np.abs(data.measured)
    residual = at.reading - data.measured
    if data.partial:
        side = data.given.side
        violated = np.minimum(side * residual, 0.0)
        residual = np.where(side == 0, residual, violated) * (data.given.seen > 0)
    missed = np.abs(residual) > limit
    if not missed.any():
        return False
    if all(term.reads_measurement and term.loss.squared for term in at.cost.terms):
        return True
    through = at.partials(np.clip(dual, -1, 1))[1]
    pairs = list(zip(at.networks, through, strict=True))
    # Pull of a cell's own reading, J_cc·∂φ/∂y_c, and of all readings, Jᵀ·∂φ/∂y.
    own = np.stack([network.own_response() * part for network, part in pairs])
    pull = np.stack([network.adjoint(part) for network, part in pairs])
    borne = (pull * gradient > 0) & (np.abs(gradient) >= np.abs(pull) / 2)
    return bool(np.any(held & missed & borne & (own * gradient > 0)))
