"""Figures of one case: errors, residuals, intervals, times; and where two cases differ significantly."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.report.compare import data_error, relative_error
from lampest.runs.case import CaseResult

DRAWS = 2000  # of which the 2.5th percentile is known to 0.06 standard deviations
CELL_ERROR, SPREAD = "median cell error [%] (95 % interval)", "residuals: robust standard deviation [σ]"
COVERED, FREE_COVERED = "truth within its interval [%]", "the same, cells away from bounds [%]"
SMALLEST, LARGEST = "pressure, smallest [kPa]", "pressure, largest [kPa]"
Picks = NDArray[np.intp]


@dataclass(frozen=True)
class Interval:
    """A figure and the ends of its 95 % bootstrap interval (percentiles)."""

    value: float
    lower: float
    upper: float

    @classmethod
    def of(cls, value: float, draws: Array) -> "Interval":
        """From what the figure is for each of the draws."""
        return cls(value, *map(float, np.percentile(draws, (2.5, 97.5))))


def block_length(values: Array) -> int:
    """Frames that are drawn together: n^(1/3), or as many as their memory lasts, at most n/3.

    values : (frames, estimators). Memory is the first lag at which the autocorrelation of the estimators' differences
    is below 1/e. Source of n^(1/3): Hall, Horowitz, Jing, Biometrika 82, 1995.
    """
    count = len(values)
    series = values - values.mean(axis=1, keepdims=True)
    series = series - series.mean(axis=0)
    power, longest, memory = float(np.sum(series**2)), max(1, count // 3), 0
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
    return Interval.of(float(np.mean(values)), values[drawn].mean(axis=1))


def median_interval(values: Array, drawn: Picks) -> Interval:
    """The median of all of (frames, cells) values, and its interval where frames are drawn.

    Draws are counted in bins that each hold 1/400 of the values, so that thousands of frames stay quick.
    """
    most = 400  # bins
    edges = np.quantile(values, np.linspace(0, 1, most + 1))
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, most - 1)
    counts = np.stack([np.bincount(row, minlength=most) for row in bins]).astype(float)
    often = np.stack([np.bincount(row, minlength=len(values)) for row in drawn]).astype(float)
    share = np.cumsum(often @ counts, axis=1) / values.shape[1] / drawn.shape[1]
    place, row = np.argmax(share >= 0.5, axis=1), np.arange(len(share))
    before = np.where(place > 0, share[row, place - 1], 0.0)
    within = (0.5 - before) / (share[row, place] - before)
    return Interval.of(float(np.median(values)), edges[place] + within * (edges[place + 1] - edges[place]))


@dataclass(frozen=True)
class Measures:
    """One case over its solved frames. figures : by their lines in tables, as far as known; counts are int."""

    case: CaseResult
    figures: Mapping[str, float | Interval]

    @property
    def solved(self) -> int:
        return int(np.sum(self.case.solved))

    def values(self, line: str) -> list[float]:
        """The figure without its interval; none where the results do not say."""
        known = self.figures.get(line)
        return [] if known is None else [known.value if isinstance(known, Interval) else known]

    @property
    def failures(self) -> dict[str, list[int]]:
        """Sentence → numbers of the frames that failed so."""
        failed: dict[str, list[int]] = {}
        for index in np.flatnonzero(~self.case.solved):
            failed.setdefault(self.case.status[index], []).append(int(self.case.frame[index]))
        return failed


@np.errstate(over="ignore")
def measures(case: CaseResult, generator: np.random.Generator) -> Measures:
    """Everything of one case; intervals from frames drawn in blocks."""
    lower, upper, residual = case.cell_resistance_lower, case.cell_resistance_upper, weighted_residual(case)
    widths = None if lower is None or upper is None else 100 * (upper - lower) / case.cell_resistance
    counts = {
        "95 % intervals with an open end": None if widths is None else ~np.isfinite(widths),
        "open cells": case.open_cell,
        "cells at the lower bound": case.at_lower_bound,
        "saturated cells": case.saturated,
    }
    readings = {
        "missing readings": case.missing_readings,
        "readings at a rail, zero or below the series resistance": case.bound_readings,
    }

    def over(values: Array | None, function: Callable[[Array], Any]) -> float | None:
        known = np.zeros(0) if values is None else values[case.solved]
        known = known[np.isfinite(known)]
        return float(function(known)) if known.size else None

    known: dict[str, float | Interval | None] = {
        CELL_ERROR: _cell_error(case, generator),
        "data error, mean [%]": over(data_error(case), np.mean),
        "residuals: mean of ((model − measured)/σ)²": over(residual, lambda z: np.mean(z**2)),
        SPREAD: over(residual, lambda z: 1.4826 * np.median(np.abs(z))),  # 1/Φ⁻¹(3/4): from median deviation to σ
        "95 % intervals: mean width [% of the cell]": over(widths, np.mean),
        COVERED: _coverage(case, generator, free=False),
        FREE_COVERED: _coverage(case, generator, free=True),
        "share of an estimate that data decide, median [%]": over(case.data_share, lambda s: 100 * np.median(s)),
        "time per frame, median [ms]": over(case.solve_time, lambda t: 1e3 * np.median(t)),
        **{
            line: None if flags is None else int(np.count_nonzero(flags[case.solved])) for line, flags in counts.items()
        },
        **{line: None if count is None else int(np.sum(count)) or None for line, count in readings.items()},
        SMALLEST: over(case.pressure, np.min),
        LARGEST: over(case.pressure, np.max),
    }
    return Measures(case, {line: value for line, value in known.items() if value is not None})


def _cell_error(case: CaseResult, generator: np.random.Generator) -> Interval | None:
    if case.truth is None or not np.any(case.solved):
        return None
    error = relative_error(case.cell_resistance, case.truth)[case.solved].reshape(int(np.sum(case.solved)), -1)
    return median_interval(error, picks(len(error), block_length(np.median(error, axis=1)[:, None]), generator))


def _coverage(case: CaseResult, generator: np.random.Generator, free: bool) -> Interval | None:
    """Share of the cells whose interval covers the truth, percent; free : of those away from bounds."""
    lower, upper, good = case.cell_resistance_lower, case.cell_resistance_upper, case.solved
    if lower is None or upper is None or case.truth is None or not np.any(good):
        return None
    within = ((lower <= case.truth) & (case.truth <= upper))[good]
    counted = ((case.open_cell == 0) & (case.at_lower_bound == 0))[good] | (not free)
    cells = counted.sum(axis=(1, 2))
    if not np.all(cells):
        return None
    shares = 100 * (within & counted).sum(axis=(1, 2)) / cells
    return mean_interval(shares, picks(len(shares), block_length(shares[:, None]), generator))


def log_error(case: CaseResult) -> Array:
    """100·|ln(r/r_true)|, (frames, rows, columns) percent; NaN where a frame failed. The case must know its truth."""
    assert case.truth is not None
    positive = np.maximum(case.cell_resistance, np.finfo(float).tiny)
    return np.asarray(100 * np.abs(np.log(positive / case.truth)))


def weighted_residual(case: CaseResult) -> Array | None:
    """(model − measured)/σ, (frames, rows, columns), NaN where a reading is no value; None where σ is unknown."""
    if case.sigma is None:
        return None
    return np.asarray(np.where(case.valued, (case.reading_model - case.measured) / case.sigma, np.nan))


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Two estimators of one recording; over the frames that both solved.

    difference : (frames, rows, columns) relative change of the first − second, percentage points; NaN elsewhere.
    significant : (frames, rows, columns). share : of the cells of these frames, percent.
    """

    first: str
    second: str
    difference: Array
    significant: NDArray[np.bool_]
    share: float


def disagreements(cases: Sequence[CaseResult]) -> tuple[Disagreement, ...]:
    """Every two cases with error bars that both solved something, those that disagree most first.

    a − b > √((a − a_low)² + (b_high − b)²) for a > b: Zou and Donner, Stat. Med. 27, 2008; exact if independent.
    """
    arms = {case.estimator: found for case in cases if (found := _arms(case)) is not None}
    known, pairs = [case for case in cases if case.estimator in arms], []
    for one, other in combinations(known, 2):
        both = one.solved & other.solved
        difference = one.relative_change - other.relative_change
        (below, above), (other_below, other_above) = arms[one.estimator], arms[other.estimator]
        with np.errstate(invalid="ignore"):
            reach = np.where(difference > 0, np.hypot(below, other_above), np.hypot(above, other_below))
            significant = np.abs(difference) > reach
        if np.any(both):
            share = 100 * float(np.mean(significant[both]))
            pairs.append(Disagreement(one.estimator, other.estimator, difference, significant, share))
    return tuple(sorted(pairs, key=lambda pair: -pair.share))


def _arms(case: CaseResult) -> tuple[Array, Array] | None:
    """Distances from the estimate to the lower and the upper end of its interval, percentage points, never negative."""
    lower, upper = case.relative_change_lower, case.relative_change_upper
    if lower is None or upper is None:
        return None
    return np.maximum(case.relative_change - lower, 0.0), np.maximum(upper - case.relative_change, 0.0)
