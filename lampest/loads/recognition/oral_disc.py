"""How far cells depart from what a load makes of them, as the readings say: bent films, edges, a baseline that is off.

Given a load, ln r = ln r0 + x + d. Readings R = f(r) + E δ + noise hold d (cells) and the offsets δ, Gaussian before
the measurement with the covariance that `Observation` weighs them by. Straight about the load, their mean is

    (d, δ) = P Aᵀ C⁻¹ (R − f(r0·e^x) − E δ0),   A = (∂f/∂ln r, E),   C = A P Aᵀ + σ².

The direct way: an oral disc fitted straight to two-point resistances; from it and them the cells follow.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Direct, Observation, with_errors
from lampest.loads.shapes import OralDisc
from lampest.loads.shapes.disc import Disc
from lampest.panel.panel import Array


def departure(frame: Observation, fit: Fit) -> Array:
    """d (rows, columns), 1: the mean of ln r − ln r0 − x after the readings, those that stand alone left out."""
    frame, whitening = with_errors(frame, fit.explained, fit.scatter, fit.residual, fit.chi2)
    cells = fit.change.size
    both = np.hstack([frame.slope(fit.change), frame.offsets])
    before = frame.baseline.covariance[:cells] @ both.T
    before += frame.spread(fit.explained, fit.scatter) @ both[:, :cells].T
    return np.asarray((before @ cho_solve((whitening.root, True), fit.residual)).reshape(fit.change.shape))


@dataclass(frozen=True, eq=False)
class OralDiscFit:
    """An oral disc, what follows from it, and how far the cells depart from that.

    disc, disc_errors : its numbers and their standard deviations. disc_covariance : (8, 8) in the order of the numbers.
    cell_resistance : (rows, columns) ohm. goodness : χ² per reading.
    objective : ½χ² of readings and priors. fit : where the next frame's fit may start.
    """

    disc: Disc
    disc_errors: Disc
    disc_covariance: Array
    cell_resistance: Array
    goodness: float
    objective: float
    fit: Fit


def fit_oral_disc(detector: Detector, frame: Direct, start: Fit | None = None) -> OralDiscFit:
    """argmin ‖R − f(r0·f(p(θ)))‖² over centre, diameters, suction, rim pressure and tilt, with their priors.

    Weighed by what films and panels depart by; the cells are those of the disc with the departures that this leaves.

    detector : prepared for the panel and its baseline. start : the frame before, or None: all of the panel is searched.
    """
    fit = detector.fitted(OralDisc.candidate, frame, start)
    disc, slopes = OralDisc.candidate.disc_with_slopes(fit.parameters)
    covariance = slopes @ fit.covariance @ slopes.T
    logarithm = frame.baseline.logarithm + fit.change + departure(frame, fit)
    return OralDiscFit(
        disc,
        Disc(*np.sqrt(np.diag(covariance))),
        covariance,
        np.exp(logarithm),
        fit.chi2 / frame.measured.size,
        fit.cost,
        fit,
    )
