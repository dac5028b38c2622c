"""Reference estimate: joint estimate of cells and of the readings' error scale.

The scale s is the ratio of the readings' errors to their noise σ, common to all readings
(`lampest.posterior.reference_fit` has the model). It contains errors of the model, of the circuit
and of the electronics. A few large steps of log r, such as the edge of a load, cost little under
heavy tails, so they are not mistaken for errors of all readings.

The fits of a grid of s have the bounds −2 log p(y | s) of the marginal likelihood. These give the
posterior of log s. The estimate of s is its median.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.posterior.interval import LEVEL
from lampest.posterior.reference_fit import Reference, ReferenceFit

# Ratio of neighbouring s of the grid: a factor of √2 in σ changes no weight by more than its
# uncertainty.
SCALE_RATIO = 2.0
MAX_SCALES = 14
# First s where the noise is unknown, of the reading: no sensor is read to more digits.
MIN_RELATIVE_NOISE = 1e-4
# Decrease of −2 log p that another s than that of the known noise must reach: odds of e³ to one
MIN_GAIN = 6.0
# Excess of −2 log p over its minimum at which the search ends: odds of one to e³, about a twentieth
MAX_EXCESS = 6.0
MAX_CELLS = 400  # of a panel: beyond, the matrices of the model take seconds


@dataclass(frozen=True, eq=False)
class ErrorScale:
    """Scale s of the readings' errors relative to their noise.

    If the noise is unknown, the scale is relative to the readings.

    Attributes
    ----------
    best : float
        Median of the posterior, on the grid.
    tail : float
        95 % quantile of the expected size of the readings' errors.
    readings : int
        Number of two-sided readings.
    scales, bounds : tuple of float
        Grid of s, ascending, and −2 log p(y | s) on it, up to a constant.
    """

    best: float
    tail: float
    readings: int
    scales: tuple[float, ...]
    bounds: tuple[float, ...]

    def gain(self, scale: float) -> float:
        """Return the difference of −2 log p between the grid point at `scale` and the best one.

        The grid point is the one nearest to `scale`.
        """
        nearest = int(np.argmin(np.abs(np.log(np.array(self.scales) / scale))))
        return self.bounds[nearest] - min(self.bounds)


def references(
    solves: Sequence[Data], cost: Cost, *, believed: bool = False
) -> tuple[ErrorScale, list[Reference]]:
    """Fit the reference model to the data of several solves, with one s for all.

    Parameters
    ----------
    solves : sequence of Data
        Data of one network each, with the same readout.
    cost : Cost
        Cost on the panel. Only its panel, its faulty cells and whether its terms compare frames are
        used.
    believed : bool
        Whether a known noise is taken as exact, s = 1.

    Returns
    -------
    scale : ErrorScale
    references : list of Reference
        One for every solve.

    Raises numpy.linalg.LinAlgError if a network cannot be solved.
    """
    fits = [
        ReferenceFit.of(data, cost, frame) for data in solves for frame in range(len(data.measured))
    ]
    noise_known = solves[0].noise_known
    first = 1.0 if noise_known else MIN_RELATIVE_NOISE
    tried = _fits_by_scale(fits, first, 1 if noise_known and believed else MAX_SCALES)
    scales = list(tried)
    bounds = np.array([sum(fit.bound for fit in fits) for fits in tried.values()])
    # Posterior of log s on the grid, p ∝ exp(−bound/2), and its median
    share = np.cumsum(np.exp((bounds.min() - bounds) / 2))
    best = scales[int(np.searchsorted(share, share[-1] / 2))]
    if noise_known and bounds[0] - bounds.min() < MIN_GAIN:
        best = 1.0  # the specified noise holds unless the readings clearly contradict it
    errors = np.concatenate([fit.errors(best) for fit in tried[best]])
    tail = float(np.quantile(errors, LEVEL)) if len(errors) else 0.0
    frames = iter([fit.reference(best) for fit in tried[best]])
    estimates = []
    for data in solves:
        cells, deviation, covariance = zip(*(next(frames) for _ in data.measured), strict=True)
        joined = Reference(np.stack(cells), np.stack(deviation), block_diag(*covariance))
        estimates.append(joined)
    return ErrorScale(best, tail, len(errors), tuple(scales), tuple(bounds.tolist())), estimates


def _fits_by_scale(
    fits: list[ReferenceFit], first: float, max_scales: int
) -> dict[float, list[ReferenceFit]]:
    """Return the settled fits of all frames for each s of the grid, ascending from the first.

    The grid ends where −2 log p has risen by MAX_EXCESS and no residuals are larger than s.
    """
    scale = first
    lowest = np.inf
    tried = dict[float, list[ReferenceFit]]()
    for _ in range(max_scales):
        # Each fit begins at the previous one.
        fits = [fit.settled(scale**2) for fit in fits]
        tried[scale] = fits
        bound = sum(fit.bound for fit in fits)
        lowest = min(lowest, bound)
        excess = np.sqrt(max(fit.residual_variance for fit in fits)) / scale
        if bound > lowest + MAX_EXCESS and excess <= 1:
            break
        # If the residuals are far larger than s, half of the grid points up to their size are
        # skipped.
        points = int(np.log(max(excess, 1.0)) / np.log(SCALE_RATIO))
        scale *= SCALE_RATIO ** (1 + points // 2)
    return tried
