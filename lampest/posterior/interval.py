"""Intervals of 95 % of normal distributions, and tail probabilities.

The intervals are two-sided or truncated at a bound.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import (
    bdtrc,
    chdtrc,
    chdtri,
    fdtrc,
    log_ndtr,
    ndtr,
    ndtri,
    ndtri_exp,
    stdtrit,
)

from lampest.panel.panel import Array

LEVEL = 0.95
# Standard deviations beyond which the tail of a normal distribution counts as exponential.
MAX_DEVIATIONS = 50.0


def one_sided(slope: ArrayLike, variance: ArrayLike) -> tuple[Array, Array]:
    """Return standard deviation and 95 % quantile of a truncated normal variable t ≥ 0.

    The density of t is ∝ exp(−slope·t − t²/(2·variance)), slope ≥ 0: that of a normal distribution
    with mean −slope·variance, truncated at 0.

    Returns
    -------
    deviation, quantile : array, shape of the arguments
    """
    slope = np.asarray(slope, dtype=float)
    variance = np.asarray(variance, dtype=float)
    size = np.sqrt(variance)
    deviations = slope * size
    near = np.minimum(deviations, MAX_DEVIATIONS)
    # With α = slope·√variance: Φ(−α) is the probability beyond 0, and h = φ(α)/Φ(−α) is the inverse
    # of Mills' ratio there.
    log_tail = log_ndtr(-near)
    rate = np.exp(-0.5 * near**2 - 0.5 * np.log(2 * np.pi) - log_tail)
    # sd = √(variance·(1 − h(h − α))); quantile t with Φ(−α − t/√variance) = 0.05·Φ(−α)
    deviation = size * np.sqrt(np.maximum(1 - rate * (rate - near), 0))
    quantile = size * (-near - ndtri_exp(np.log(1 - LEVEL) + log_tail))
    # Far in the tail the density is exponential: sd = 1/slope, quantile −log(0.05)/slope.
    far = deviations > MAX_DEVIATIONS
    scale = 1 / np.where(far, slope, 1.0)
    return np.where(far, scale, deviation), np.where(far, -np.log(1 - LEVEL) * scale, quantile)


def chi_square_tail(chi_square: ArrayLike, degrees: ArrayLike) -> Array:
    """Return P(χ² ≥ chi_square) for positive, possibly fractional degrees of freedom.

    The arguments may have any shape.
    """
    return np.asarray(chdtrc(degrees, chi_square))


def variance_ratio_tail(ratio: float, upper: float, lower: float) -> float:
    """Return P(F ≥ ratio) for mean squares with `upper` and `lower` degrees of freedom."""
    return float(fdtrc(upper, lower, ratio))


def chi_square_median(degrees: float) -> float:
    """Return the median of χ² with positive, possibly fractional degrees of freedom."""
    return float(chdtri(degrees, 0.5))


def binomial_tail(count: int, trials: int, chance: float) -> float:
    """Return P(at least `count` of `trials` succeed, each with probability `chance`).

    1 if count is not positive.
    """
    return float(bdtrc(count - 1, trials, chance)) if count > 0 else 1.0


def student_two_sided(degrees: float) -> float:
    """Return half the two-sided 95 % interval of Student's t, in units of its scale."""
    return float(stdtrit(degrees, (1 + LEVEL) / 2))


def largest_of(excess: ArrayLike, count: int) -> Array:
    """Return Bonferroni's bound of P(max of `count` standard normal numbers ≥ excess).

    The bound is an upper one, of the shape of `excess`.
    """
    return np.asarray(np.minimum(count * ndtr(-np.asarray(excess, dtype=float)), 1.0))


def largest_normal(count: int, chance: float) -> float:
    """Return the size that max |x| of `count` numbers exceeds with probability ≤ `chance`.

    The numbers are standard normal. The size is Bonferroni's bound.
    """
    return float(-ndtri(chance / (2 * count)))


def normal_quantile(chance: ArrayLike) -> Array:
    """Return the quantiles of a standard normal distribution."""
    return np.asarray(ndtri(chance))
