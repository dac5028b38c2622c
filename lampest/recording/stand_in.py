"""What stands in for a reading that says nothing: what its row and its column let expect, and how far that may be off.

A panel whose lines alone differ has log y = m + a_j + b_k, with M + N − 1 numbers; loaded cells stray from it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

SWEEPS = 6  # of the median polish; panels of 3 × 3 to 64 × 64 with holes change by less than their spread after two
LEAST_SPREAD = 1e-3  # of log y: below that a frame is a simulation without noise
LEVEL, TWO_SIDED = 0.95, 1.96  # what of the readings left out lies within so many times the spread


@dataclass(frozen=True, eq=False)
class StandIn:
    """Of one frame. logarithm : (rows, columns) log y of the readings that are known, NaN of the others."""

    logarithm: Array

    @classmethod
    def of(cls, value: Array, known: NDArray[np.bool_]) -> "StandIn":
        """value : (rows, columns) of which the known readings count."""
        return cls(np.where(known, np.log(np.where(known, value, 1.0)), np.nan))

    @property
    def value(self) -> Array:
        """exp(m + a_j + b_k), (rows, columns); 1 throughout where nothing is known."""
        return np.exp(self._expected[0])

    @cached_property
    def spread(self) -> Array:
        """(rows, columns) standard deviation of the value's logarithm; 1 throughout where nothing is known.

        Of readings that are known, as if they were not: those of one diagonal after the other are left out, one a line.
        Loads make few of them stray far; so it is the rms, or more where that does not hold 95 % of them. A line
        without any known reading has the variance of the others' effects on top.
        """
        known = ~np.isnan(self.logarithm)
        if not known.any():
            return np.ones(known.shape)
        diagonal = np.add.outer(*map(np.arange, known.shape)) % max(known.shape)
        left = np.stack([np.where(diagonal == number, np.nan, self.logarithm) for number in range(max(known.shape))])
        alone = np.take_along_axis(_polished(left)[0], diagonal[None], axis=0)[0]
        stray = np.abs(alone - self.logarithm)[known]
        size = max(np.sqrt(np.mean(stray**2)), np.quantile(stray, LEVEL, method="higher") / TWO_SIDED)
        return np.asarray(np.maximum(np.sqrt(size**2 + self._expected[1]), LEAST_SPREAD))

    @cached_property
    def _expected(self) -> tuple[Array, Array]:
        return _polished(self.logarithm)


def _polished(rest: Array) -> tuple[Array, Array]:
    """(m + a_j + b_k, variance of the effects of lines of which nothing is known), any shape + (rows, columns).

    Median polish of log y, NaN where unknown: a wild reading moves no line. A line of which nothing is known has the
    mean of the others. 0 where nothing at all is known. Source: Tukey, Exploratory Data Analysis, 1977, chapter 11.
    """
    unknown = np.isnan(rest)
    level = _median(rest, (-2, -1))
    rest = rest - level
    effects = {axis: np.zeros_like(_median(rest, axis)) for axis in (-1, -2)}
    for _ in range(SWEEPS):
        for axis in effects:
            step = _median(rest, axis)
            effects[axis], rest = effects[axis] + step, rest - step
    expected, between = level, np.zeros(rest.shape)
    for axis, other in ((-1, -2), (-2, -1)):
        told = ~unknown.all(axis=axis, keepdims=True)
        count = np.maximum(told.sum(axis=other, keepdims=True), 1)
        mean = np.where(told, effects[axis], 0.0).sum(axis=other, keepdims=True) / count
        square = np.where(told, (effects[axis] - mean) ** 2, 0.0).sum(axis=other, keepdims=True) / count
        expected = expected + np.where(told, effects[axis], mean)
        between = between + np.where(told, 0.0, square)
    return expected, between


def _median(values: Array, axis: int | tuple[int, int]) -> Array:
    """Of the numbers along an axis, which is kept; 0 where there is none."""
    blank = np.all(np.isnan(values), axis=axis, keepdims=True)
    return np.asarray(np.nanmedian(np.where(blank, 0.0, values), axis=axis, keepdims=True))
