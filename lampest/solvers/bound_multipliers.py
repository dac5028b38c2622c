"""Whether bounds keep cells from meeting readings: what an optimum within the bounds does not say by itself.

At an optimum the pull of the readings on every cell, Jᵀ ∂φ/∂y, is balanced: by the penalties, and by the bound where
one holds the cell. The multiplier of that bound is what is left of the whole gradient.
Source: Nocedal & Wright, Numerical Optimization, 2006, section 12.3 (multipliers as sensitivities).
"""

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation, within_one
from lampest.panel.panel import Array

DEVIATIONS = 1.0  # σ: what the bound on open cells may take from a reading, by its definition
MILLIONTH = 1e-6  # of a reading: the same where no noise is known
HALF = 0.5  # of the readings' pull on a cell: with less, penalties rather than its bound hold it


def bounds_matter(at: Evaluation, gradient: Array, dual: Array) -> bool:
    """Whether bounds hold cells, and are why some reading is missed by more than its noise.

    Of squared losses of readings alone nothing else can be. With penalties, or losses that forgive a reading, they are
    where the missed reading pulls its own cell beyond a bound that bears at least half of what all readings pull there.

    gradient : of all that is minimised, in u = log r, (frames, rows, columns). dual : of absolute losses.
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
    borne = (pull * gradient > 0) & (np.abs(gradient) >= HALF * np.abs(pull))
    return bool(np.any(held & missed & borne & (own * gradient > 0)))


def _missed(at: Evaluation) -> NDArray[np.bool_]:
    """(frames, rows, columns) which readings are off by more than their noise; those that are bounds, if broken."""
    data = at.data
    limit = DEVIATIONS * data.deviation if data.noise_known else MILLIONTH * np.abs(data.measured)
    missed = at.reading - data.measured
    if data.partial:
        side, seen = data.given.side, data.given.seen
        missed = np.where(side == 0, missed, np.minimum(side * missed, 0.0)) * (seen > 0)
    return np.asarray(np.abs(missed) > limit)
