"""Bounds: free cells, steps within them, and whether they keep cells from meeting readings.

The multiplier of an active bound is what is left of the gradient. Source: Nocedal & Wright, Numerical Optimization,
2006, section 12.3 (multipliers as sensitivities).
"""

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation, within_one
from lampest.panel.panel import Array

MILLIONTH = 1e-6  # of a reading or a cell: what may be left of it where no noise is known
STEP_LENGTHS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of log r, of the cell that moves most
MIN_DECREASE_SHARE = 1e-12  # of the cost's scale: a smaller decrease is its rounding


def free_cells(at: Evaluation, gradient: Array) -> NDArray[np.bool_]:
    """(…, cells) those that have room and that the gradient (…, cells) does not press against a bound."""
    (lower, upper), slope = at.data.log_bounds, gradient.reshape(at.position.shape)
    held = ((at.position <= lower) & (slope > 0)) | ((at.position >= upper) & (slope < 0))
    free: NDArray[np.bool_] = (lower < upper) & ~held
    return free.reshape(gradient.shape)


def within_bounds(at: Evaluation, free: NDArray[np.intp], step: Array) -> Array:
    """(cells) the step of the free cells as far as bounds let it."""
    position = at.position.ravel()
    target = position.copy()
    target[free] += step
    lower, upper = (bound.ravel() for bound in at.data.log_bounds)
    return np.asarray(np.minimum(np.maximum(target, lower), upper) - position)


def lower_along(at: Evaluation, along: Array) -> Evaluation | None:
    """Return a point forth or back along a direction (cells) of u where the cost is lower; None where there is none."""
    least, size = _certain_cost(at) - MIN_DECREASE_SHARE * at.cost_scale, float(np.abs(along).max(initial=0.0)) or 1.0
    lengths = [sign * length / size for length in STEP_LENGTHS for sign in (1.0, -1.0)]
    beside = (moved_by(at, length * along) for length in lengths)
    return next((point for point in beside if point is not None and _certain_cost(point) < least), None)


def _certain_cost(at: Evaluation) -> float:
    """φ without the last bits of residuals with an absolute loss."""
    if not len(at.nonsmooth):
        return at.objective
    return at.objective - float(np.sum(at.cost.slope * np.minimum(np.abs(at.nonsmooth), at.last_bits)))


def moved_by(at: Evaluation, step: Array) -> Evaluation | None:
    """Return the cost after a step of u (flat), within the bounds; None where its network cannot be solved."""
    cells = np.exp(at.position + step.reshape(at.position.shape))
    try:
        return at.elsewhere(np.clip(cells, at.data.lower, at.data.upper))
    except np.linalg.LinAlgError:
        return None


def bounds_matter(at: Evaluation, gradient: Array, dual: Array) -> bool:
    """Whether bounds hold cells, and are why some reading is missed by more than its noise.

    With penalties, or losses that forgive a reading, they are where the missed reading pulls its own cell beyond a
    bound that bears at least half of what all readings pull there. gradient : in u = log r, (frames, rows, columns).
    """
    lower, upper = at.data.log_bounds
    held = ((at.position >= upper) & (gradient < 0)) | ((at.position <= lower) & (gradient > 0))
    held &= lower < upper
    if not held.any() or not (missed := _missed(at)).any():
        return False
    if all(term.reads_measurement and term.loss.squared for term in at.cost.terms):
        return True
    through, networks = at.partials(within_one(dual))[1], at.networks
    own = through * np.stack([network.own_response() for network in networks])
    pull = np.stack([network.adjoint(part) for network, part in zip(networks, through, strict=True)])
    borne = (pull * gradient > 0) & (np.abs(gradient) >= np.abs(pull) / 2)
    return bool(np.any(held & missed & borne & (own * gradient > 0)))


def _missed(at: Evaluation) -> NDArray[np.bool_]:
    """(frames, rows, columns) which readings are off by more than their noise; those that are bounds, if broken."""
    data = at.data
    limit = data.deviation if data.noise_known else MILLIONTH * np.abs(data.measured)
    missed = at.reading - data.measured
    if data.partial:
        side, seen = data.given.side, data.given.seen
        missed = np.where(side == 0, missed, np.minimum(side * missed, 0.0)) * (seen > 0)
    return np.asarray(np.abs(missed) > limit)
