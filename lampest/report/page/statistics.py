"""Bootstrap intervals over recordings, or over one recording's frames in blocks."""

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

DRAWS = 2000  # of which the 2.5th percentile is known to 0.06 standard deviations
ENDS = (2.5, 97.5)  # percentiles
BINS = 400  # of a median's distribution
Picks = NDArray[np.intp]


@dataclass(frozen=True)
class Interval:
    """A figure and the ends of its 95 % bootstrap interval (percentiles)."""

    value: float
    lower: float
    upper: float

    @property
    def covers_zero(self) -> bool:
        return self.lower <= 0 <= self.upper


def block_length(values: Array) -> int:
    """Frames that are drawn together: n^(1/3), or as many as their memory lasts, at most n/3.

    values : (frames, estimators). Memory is the first lag at which the autocorrelation of the estimators' differences
    is below 1/e. Source of n^(1/3): Hall, Horowitz, Jing, Biometrika 82, 1995.
    """
    count = len(values)
    series = values - values.mean(axis=1, keepdims=True)
    series = series - series.mean(axis=0)
    power = float(np.sum(series**2))
    longest = max(1, count // 3)
    memory = 0
    if np.isfinite(power) and power > 0:
        while memory < longest and np.sum(series[memory:] * series[: count - memory]) > power / np.e:
            memory += 1
    return int(min(max(ceil(count ** (1 / 3)), memory), longest))


def picks(count: int, block: int, generator: np.random.Generator) -> Picks:
    """(draws, count) numbers of units: circular blocks of neighbours; a block of 1 is the ordinary bootstrap.

    Source: Politis and Romano, in LePage and Billard (eds.), Exploring the Limits of Bootstrap, 1992.
    """
    starts = generator.integers(count, size=(DRAWS, ceil(count / block)))
    return ((starts[:, :, None] + np.arange(block)) % count).reshape(DRAWS, -1)[:, :count]


def mean_interval(values: Array, drawn: Picks) -> Interval:
    """The mean of (units) values and its interval."""
    return _interval(float(np.mean(values)), values[drawn].mean(axis=1))


def median_interval(values: Array, drawn: Picks) -> Interval:
    """The median of all of (frames, cells) values, and its interval where frames are drawn.

    Draws are counted in bins that each hold 1/400 of the values, so that thousands of frames stay quick.
    """
    edges = np.quantile(values, np.linspace(0, 1, BINS + 1))
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    counts = np.stack([np.bincount(row, minlength=BINS) for row in bins]).astype(float)
    often = np.stack([np.bincount(row, minlength=len(values)) for row in drawn]).astype(float)
    share = np.cumsum(often @ counts, axis=1) / values.shape[1] / drawn.shape[1]
    place = np.argmax(share >= 0.5, axis=1)
    row = np.arange(len(share))
    before = np.where(place > 0, share[row, place - 1], 0.0)
    within = (0.5 - before) / (share[row, place] - before)
    return _interval(float(np.median(values)), edges[place] + within * (edges[place + 1] - edges[place]))


def _interval(value: float, draws: Array) -> Interval:
    lower, upper = np.percentile(draws, ENDS)
    return Interval(value, float(lower), float(upper))
