"""The direct way: an oral disc fitted straight to two-point resistances; from it and them the cells follow."""

from dataclasses import dataclass

import numpy as np

from lampest.loads.recognition.departure import departure
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Direct
from lampest.loads.shapes import OralDisc
from lampest.loads.shapes.disc import Disc
from lampest.panel.panel import Array


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
