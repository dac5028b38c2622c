"""Posterior of one number by its costs on a grid.

A cost is −2 ln evidence of one value of the number; other numbers that it can be mistaken for are
tried beside it and summed out:

    p(value | data) ∝ prior · Σ_others exp(−cost/2).
"""

from dataclasses import dataclass
from math import erf

import numpy as np

from lampest.panel.panel import Array

MIN_ODDS = 20.0  # of an effect against none (tests/oracles/test_insignificant_effects.py)
SHOWN_GAIN = 2 * float(np.log(MIN_ODDS))  # decrease of −2 ln evidence with these odds


@dataclass(frozen=True, eq=False)
class Number:
    """Posterior of a number on a grid.

    Attributes
    ----------
    values : array, shape (n,)
        Tried values, ascending.
    odds : array, shape (n,)
        Their posterior probabilities, of sum 1.
    gain : float
        Decrease of −2 ln evidence from the first value to the best one.
    evidence : float
        Decrease of −2 ln evidence from the first value to all others together, −2 ln of their odds
        where both are equally probable before.
    """

    values: Array
    odds: Array
    gain: float
    evidence: float = 0.0

    @classmethod
    def by_costs(cls, values: Array, costs: Array, prior: Array | float = 1.0) -> "Number":
        """Return the posterior of a number.

        Parameters
        ----------
        values : array, shape (n,)
            Tried values, ascending.
        costs : array, shape (n, …)
            −2 ln evidence of each value beside those of other numbers; a value without an
            explanation costs infinity.
        prior : array, shape (n,), or float
            Prior probabilities up to a factor.
        """
        marginal = summed_out(costs.reshape(len(values), -1), axis=1)
        logarithms = -(marginal - marginal.min()) / 2
        weight = np.broadcast_to(prior, len(values))
        odds = np.exp(logarithms) * weight
        gain = float(marginal[0] - marginal.min())
        others = float(odds[1:].sum() / weight[1:].sum())
        return cls(values, odds / odds.sum(), gain, gain + 2 * float(np.log(others)))

    @property
    def mean(self) -> float:
        """The posterior mean."""
        return float(self.odds @ self.values)

    @property
    def mean_square(self) -> float:
        """E[value²]."""
        return float(self.odds @ np.square(self.values))

    @property
    def deviation(self) -> float:
        """The posterior standard deviation.

        A value between two tried ones is known to a uniform distribution at best.
        """
        variance = max(self.mean_square - self.mean**2, 0.0)
        after = int(np.clip(np.searchsorted(self.values, self.mean), 1, len(self.values) - 1))
        step = float(self.values[after] - self.values[after - 1])
        return float(np.sqrt(variance + step**2 / 12))

    @property
    def log_deviation(self) -> float:
        """The posterior standard deviation of the logarithm of a positive number."""
        logarithms = np.log(np.where(self.odds > 0, self.values, 1.0))
        return float(np.sqrt(max(self.odds @ logarithms**2 - (self.odds @ logarithms) ** 2, 0.0)))


def summed_out(costs: Array, axis: int | tuple[int, ...]) -> Array:
    """Return −2 ln Σ exp(−cost/2) along axes; the values there are equally probable."""
    return np.asarray(-2 * np.logaddexp.reduce(-costs / 2, axis=axis))


def mean_cost(costs: Array) -> float:
    """Return −2 ln of the mean density, from −2 ln of each."""
    return -2 * float(np.logaddexp.reduce(-costs / 2, axis=None) - np.log(costs.size))


def parabola(values: Array, costs: Array) -> tuple[float, float]:
    """Return the least of a parabola through the least cost and its neighbours, and its deviation.

    The deviation is √(2/curvature), infinite where the costs have no least value within.

    Parameters
    ----------
    values, costs : array, shape (n,)
        At least three, the values at equal distances.
    """
    middle = int(np.clip(np.argmin(costs), 1, len(values) - 2))
    below, least, above = costs[middle - 1 : middle + 2]
    spacing = float(values[1] - values[0])
    curvature = (above - 2 * least + below) / spacing**2
    if not curvature > 0:
        return float(values[np.argmin(costs)]), np.inf
    slope = (above - below) / (2 * spacing)
    return float(values[middle]) - slope / curvature, float(np.sqrt(2 / curvature))


def is_significant(mean: float, deviation: float, largest: float) -> bool:
    """Return whether the odds of an estimated effect against none reach MIN_ODDS.

    Elsewhere it corrects no readings, and widens error bars by its root mean square. With a uniform
    prior up to `largest` and a normal posterior from 0 on, the odds are
    √(2π) s exp(m²/2s²) Φ(m/s)/largest.

    Parameters
    ----------
    mean, deviation : float
        Those of the posterior, m and s.
    largest : float
    """
    if not deviation:
        return mean > 0
    distance = mean / deviation
    # √(2π) Φ(x) = √(π/2) (1 + erf(x/√2))
    width = np.sqrt(np.pi / 2) * (1 + erf(distance / np.sqrt(2))) * deviation / largest
    return bool(distance**2 / 2 + np.log(width) > np.log(MIN_ODDS))
