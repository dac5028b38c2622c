"""How far cells depart from what a load makes of them, as the readings say: bent films, edges, a baseline that is off.

Given a load, ln r = ln r0 + x + d. Readings R = f(r) + E δ + noise hold d (cells) and the offsets δ, Gaussian before
the measurement with the covariance that `Observation` weighs them by. Straight about the load, their mean is

    (d, δ) = P Aᵀ C⁻¹ (R − f(r0·e^x) − E δ0),   A = (∂f/∂ln r, E),   C = A P Aᵀ + σ².
"""

import numpy as np
from scipy.linalg import cho_solve

from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Observation, with_errors
from lampest.panel.panel import Array


def departure(frame: Observation, fit: Fit) -> Array:
    """d (rows, columns), 1: the mean of ln r − ln r0 − x after the readings, those that stand alone left out."""
    frame, whitening = with_errors(frame, fit.explained, fit.scatter, fit.residual, fit.chi2)
    cells = fit.change.size
    both = np.hstack([frame.slope(fit.change), frame.offsets])
    before = frame.baseline.covariance[:cells] @ both.T
    before += frame.spread(fit.explained, fit.scatter) @ both[:, :cells].T
    return np.asarray((before @ cho_solve((whitening.root, True), fit.residual)).reshape(fit.change.shape))
