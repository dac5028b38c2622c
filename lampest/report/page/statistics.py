"""Bootstrap intervals and paired comparison: over recordings, or over one recording's frames in blocks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.report.page.batch import Matched
from lampest.report.page.interval import Interval
from lampest.runs.results import CaseResult

DRAWS = 2000
ENDS = (2.5, 97.5)
BINS = 400
Picks = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Scores:
    """What is compared.

    Parameters
    ----------
    estimators : names. values : (units, estimators), smaller is better.
    units : their names; recordings, or the frames of one recording. block : so many neighbouring units are drawn
    together, 1 for recordings.
    """

    estimators: tuple[str, ...]
    values: Array
    units: tuple[str, ...]
    over_frames: bool
    block: int


@dataclass(frozen=True)
class Pair:
    """Paired difference, mean of first − second over the units; in how many each was smaller."""

    first: str
    second: str
    difference: Interval
    wins: int
    losses: int

    @property
    def told_apart(self) -> bool:
        return not self.difference.holds_zero


@dataclass(frozen=True)
class Standing:
    """An estimator's mean over the units, against the smallest of all; wins : units in which none is smaller."""

    estimator: str
    mean: Interval
    against_best: Pair
    wins: int


def score(match: Matched, per_cell: Callable[[CaseResult], Array], average: Callable[..., Any]) -> Scores:
    """Averages over the cells of the matched frames: one for each recording, or for each frame of a single recording.

    per_cell : (frames, ...) of a case, smaller is better. average : np.median or np.mean.
    """
    single = len(match.subjects) == 1
    columns = []
    for name in match.estimators:
        pairs_of = zip(match.cases(name), match.chosen, strict=True)
        chosen = [per_cell(case)[frames].reshape(int(np.sum(frames)), -1) for case, frames in pairs_of]
        columns.append(average(chosen[0], axis=1) if single else np.array([average(part) for part in chosen]))
    values = np.stack(columns, axis=1)
    if not single:
        return Scores(match.estimators, values, tuple(subject.name for subject in match.subjects), False, 1)
    numbers = match.subjects[0].cases[0].frame[match.chosen[0]]
    return Scores(match.estimators, values, tuple(f"frame {number}" for number in numbers), True, block_length(values))


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


def standings(scores: Scores, generator: np.random.Generator) -> tuple[Standing, ...]:
    """Every estimator against the one with the smallest mean, that one first, then by their means.

    All are drawn together, so differences are paired.
    """
    drawn = picks(len(scores.values), scores.block, generator)
    means = scores.values.mean(axis=0)
    order = np.argsort(means, kind="stable")
    least = scores.values.min(axis=1)
    return tuple(
        Standing(
            scores.estimators[index],
            mean_interval(scores.values[:, index], drawn),
            _pair(scores, int(index), int(order[0]), drawn),
            int(np.sum(scores.values[:, index] == least)),
        )
        for index in order
    )


def pairs(scores: Scores, generator: np.random.Generator) -> tuple[Pair, ...]:
    """Every two estimators, each pair once in the order of their names' appearance."""
    drawn = picks(len(scores.values), scores.block, generator)
    count = len(scores.estimators)
    return tuple(_pair(scores, one, other, drawn) for one in range(count) for other in range(one + 1, count))


def _pair(scores: Scores, one: int, other: int, drawn: Picks) -> Pair:
    difference = scores.values[:, one] - scores.values[:, other]
    names: Sequence[str] = scores.estimators
    return Pair(
        names[one],
        names[other],
        mean_interval(difference, drawn),
        int(np.sum(difference < 0)),
        int(np.sum(difference > 0)),
    )
