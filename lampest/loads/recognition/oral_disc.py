"""An oral disc fitted to two-point resistances without an estimate between; the cells follow from both.

ln r = ln r0 + x + d: cells depart by d from what the load makes of them. With A = (∂f/∂ln r, E), C = A P Aᵀ + σ² the
mean of d and of the offsets δ is (d, δ) = P Aᵀ C⁻¹ (R − f(r0·e^x) − E δ0), P that of `Observation`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.observation import Observation
from lampest.loads.shapes import OralDisc
from lampest.loads.shapes.disc import Disc
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class OralDiscFit:
    """An oral disc and what follows from it.

    disc, disc_errors : its numbers and their standard deviations. disc_covariance : (8, 8) in the order of the numbers.
    cell_resistance : (rows, columns) ohm. fit : where the next frame's fit may start.
    """

    disc: Disc
    disc_errors: Disc
    disc_covariance: Array
    cell_resistance: Array
    fit: Fit


def fit_oral_disc(detector: Detector, frame: Observation, start: Fit | None = None) -> OralDiscFit:
    """argmin ‖R − f(r0·f(p(θ)))‖² over centre, diameters, suction, rim pressure and tilt, with their priors.

    Weighed by what films and panels depart by; the cells are those of the disc with the departures that this leaves.
    start : the frame before, or None: all of the panel is searched.
    """
    fit = detector.fitted(OralDisc.candidate, frame, start)
    disc, slopes = OralDisc.candidate.disc_with_slopes(fit.parameters)
    covariance = slopes @ fit.covariance @ slopes.T
    cells = np.exp(frame.baseline.logarithm + fit.change + _departure(frame, fit))
    return OralDiscFit(disc, Disc(*np.sqrt(np.diag(covariance))), covariance, cells, fit)


def _departure(frame: Observation, fit: Fit) -> Array:
    """d (rows, columns): the mean of ln r − ln r0 − x after the readings, outliers left out."""
    frame, whitening = fit.with_errors(frame)
    cells, baseline = fit.change.size, frame.baseline
    shared = fit.explained.shared(baseline.model_errors)
    film = fit.scatter**2 * fit.explained.uneven(baseline) + shared.T @ shared
    spread = baseline.model_errors.resting_covariance(frame.seconds, cells) + film
    both = np.hstack([frame.slope(fit.change), frame.offsets])
    before = baseline.covariance[:cells] @ both.T + spread @ both[:, :cells].T
    return np.asarray((before @ cho_solve((whitening.root, True), fit.residual)).reshape(fit.change.shape))
