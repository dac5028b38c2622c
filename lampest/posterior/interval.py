"""Intervals of 95 %: two-sided for a normal distribution, one-sided where a bound cuts it off; and tails."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtrc, gammaincc, log_ndtr, ndtr, ndtri, ndtri_exp, stdtrit

from lampest.panel.panel import Array

LEVEL = 0.95
MAX_DEVIATIONS = 50.0  # standard deviations beyond which the tail of a normal distribution is an exponential one


def one_sided(slope: ArrayLike, variance: ArrayLike) -> tuple[Array, Array]:
    """Return (standard deviation, 95 % quantile) of t ≥ 0 with density ∝ exp(−slope·t − t²/(2·variance)), slope ≥ 0.

    A normal distribution of that variance with its mean at −slope·variance, cut off at 0. Any shape.
    """
    slope, variance = np.asarray(slope, dtype=float), np.asarray(variance, dtype=float)
    size = np.sqrt(variance)
    away = slope * size
    near = np.minimum(away, MAX_DEVIATIONS)
    # What is left of the distribution beyond 0, and the rate at which it falls there (the inverse of Mills' ratio).
    left = log_ndtr(-near)
    rate = np.exp(-0.5 * near**2 - 0.5 * np.log(2 * np.pi) - left)
    deviation = size * np.sqrt(np.maximum(1 - rate * (rate - near), 0))
    quantile = size * (-near - ndtri_exp(np.log(1 - LEVEL) + left))
    far = away > MAX_DEVIATIONS
    scale = 1 / np.where(far, slope, 1.0)
    return np.where(far, scale, deviation), np.where(far, -np.log(1 - LEVEL) * scale, quantile)


def chi_square_tail(chi_square: ArrayLike, degrees: ArrayLike) -> Array:
    """P(χ² of so many degrees ≥ chi_square); degrees above 0, whole or not. Any shape."""
    return np.asarray(gammaincc(np.asarray(degrees) / 2, np.asarray(chi_square) / 2))


def binomial_tail(count: int, trials: int, chance: float) -> float:
    """P(at least `count` of so many trials succeed, each with this chance); 1 where count is not positive."""
    return float(bdtrc(count - 1, trials, chance)) if count > 0 else 1.0


def student_two_sided(degrees: float) -> float:
    """Return half the two-sided interval of Student's t of so many degrees of freedom, in units of its scale."""
    return float(stdtrit(degrees, (1 + LEVEL) / 2))


def largest_of(excess: ArrayLike, count: int) -> Array:
    """P(the largest of `count` normal numbers ≥ excess), at most, by Bonferroni's inequality. Any shape."""
    return np.asarray(np.minimum(count * ndtr(-np.asarray(excess, dtype=float)), 1.0))


def largest_normal(count: int, chance: float) -> float:
    """Return the size that the largest of so many normal numbers exceeds with at most this chance (Bonferroni)."""
    return float(-ndtri(chance / (2 * count)))
