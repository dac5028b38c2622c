"""Whether bounds keep cells from meeting readings: the multiplier of an active bound is what is left of the gradient.

Source: Nocedal & Wright, Numerical Optimization, 2006, section 12.3 (multipliers as sensitivities).
"""

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation, within_one
from lampest.panel.panel import Array

MILLIONTH = 1e-6  # of a reading: what a bound may take from it where no noise is known; else one σ


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
