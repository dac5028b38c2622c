"""What stands in for a reading that says nothing: what its row and its column let expect, and how far that may be off.

A panel whose lines alone differ has log y = m + a_j + b_k, with M + N − 1 numbers; loaded cells stray from it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

SWEEPS = 6  # of the median polish; panels of 3 × 3 to 64 × 64 with holes change by less than their spread after two
LEAST_SPREAD = 1e-3  # of log y: below that a frame is a simulation without noise


@dataclass(frozen=True, eq=False)
class StandIn:
    """Of one frame (rows, columns). value : exp(m + a_j + b_k). spread : standard deviation of its logarithm."""

    value: Array
    spread: Array

    @classmethod
    def of(cls, value: Array, known: NDArray[np.bool_]) -> "StandIn":
        """Median polish of log y over the known readings: a wild one moves no line, but widens the spread.

        The spread is that of a reading that was not fitted, Σ stray²/(n − p)·(1 + p/n), with p = M + N − 1 numbers
        fitted to n readings; a line without any known reading has the mean of the others' and their spread on top. 1
        throughout where nothing is known. Source: Tukey, Exploratory Data Analysis, 1977, chapter 11.
        """
        if not known.any():
            return cls(np.ones(value.shape), np.ones(value.shape))
        rest = np.where(known, np.log(np.where(known, value, 1.0)), np.nan)
        level = float(np.median(rest[known]))
        rest = rest - level
        effects = [np.zeros((value.shape[0], 1)), np.zeros((1, value.shape[1]))]
        for _ in range(SWEEPS):
            for axis, across in ((0, 1), (1, 0)):
                step = _median(rest, across)
                effects[axis], rest = effects[axis] + step, rest - step
        count = int(known.sum())
        fitted = min(int(known.any(axis=1).sum() + known.any(axis=0).sum()) - 1, count)
        variance = np.full(value.shape, np.sum(rest[known] ** 2) / max(count - fitted, 1) * (1 + fitted / count))
        for axis, across in ((0, 1), (1, 0)):
            lines = known.any(axis=across, keepdims=True)
            mean = effects[axis][lines].mean()
            variance = variance + np.where(lines, 0.0, effects[axis][lines].var())
            effects[axis] = np.where(lines, effects[axis], mean)
        spread = np.maximum(np.sqrt(variance), LEAST_SPREAD)
        return cls(np.exp(level + effects[0] + effects[1]), spread)


def _median(values: Array, axis: int) -> Array:
    """Of the numbers along an axis, which is kept; 0 where there is none."""
    blank = np.all(np.isnan(values), axis=axis, keepdims=True)
    return np.asarray(np.nanmedian(np.where(blank, 0.0, values), axis=axis, keepdims=True))
