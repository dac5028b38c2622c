"""Suction of a mouth that may be pulled, from the fit of one at rest.

Readings are linear in the conductance q = 1/f(p) of cells under suction, not in its logarithm. A
strong suction opens these cells, and readings show only that q is small: the suction has a lower
bound, and no upper one but a vacuum.
"""

from math import log

import numpy as np
from scipy.special import softmax

from lampest.panel.response import VACUUM_KPA, Response
from lampest.recording.shapes.shape import Prior

# Of ln of the suction in kPa: 95 % between 1.7 and 85 kPa. Mouths suck with 0.6 to 26 kPa at rest,
# and with 8 to 70 kPa while they are pulled off (Shi et al., PLoS ONE 16, e0247884, 2021).
PULLED = Prior(log(12), 1.0)
# Ends of the grid over ln of the suction, the last one a vacuum, and its number of points.
LEAST = log(0.3)
MOST = log(-VACUUM_KPA)
POINTS = 400
INTERVAL = (
    0.025,
    0.975,
)  # central 95 %, which ends at DEVIATIONS standard deviations of a Gaussian
DEVIATIONS = 1.96


def pulled_suction(
    response: Response,
    water_kpa: float,
    logarithm: float,
    variance: float,
    resting: Prior,
    curve_variance: float = 0.0,
) -> tuple[float, float]:
    """Return the suction in kPa and its standard deviation with the prior PULLED.

    The posterior is not symmetric. The suction is the middle of its central 95 % interval, and 1.96
    standard deviations reach to both ends of it. The fit's likelihood is its posterior over the
    prior `resting`. Below its maximum ŝ it is normal in ln s, above in q(s) with the same slope,

        P(s) ∝ e^(−½ ((q(s) − q(ŝ))/σ_q)²) P_PULLED(s),   σ_q = σ |dq/d ln s|.

    Parameters
    ----------
    response : Response
    water_kpa : float
        Pressure of the water.
    logarithm, variance : float
        Mean and variance of ln s by a fit with the prior `resting`, without alternative curves.
    resting : Prior
    curve_variance : float
        Variance of ln s by alternative curves of the film.
    """
    precision = max(1 / variance - 1 / resting.sd**2, 1e-9)
    mean = (logarithm / variance - resting.mean / resting.sd**2) / precision
    mean = float(np.clip(mean, LEAST, MOST))
    grid = np.linspace(LEAST, MOST, POINTS)
    at_rest = response.logarithm(water_kpa)

    def conductance(logarithms: np.ndarray) -> np.ndarray:
        return np.exp(at_rest - response.logarithm(water_kpa - np.exp(logarithms)))

    best, beside = conductance(np.array([mean, mean + 1e-3]))
    slope = max(float(best - beside) / 1e-3, 1e-300)
    below = grid - mean
    above = (conductance(grid) - best) / slope
    squares = precision * np.where(grid < mean, below, above) ** 2
    squares += ((grid - PULLED.mean) / PULLED.sd) ** 2
    below_or_at = np.cumsum(softmax(-squares / 2))
    low, high = np.exp(np.interp(INTERVAL, below_or_at, grid))
    middle = float(low + high) / 2
    spread = float(high - low) / (2 * DEVIATIONS)
    return -middle, (spread**2 + middle**2 * curve_variance) ** 0.5
