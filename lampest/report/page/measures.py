"""Figures of one case: errors, residuals, intervals, times; and where two cases differ significantly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import ceil

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.report.compare import data_error, relative_error
from lampest.runs.case import CaseResult

DRAWS = 2000  # of which the 2.5th percentile is known to 0.06 standard deviations
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
    """One case over its solved frames.

    figures : by the names that `page.tables.LINES` explains, as far as the results say. cells : of the solved frames.
    """

    case: CaseResult
    solved: int
    cells: int
    figures: Mapping[str, float | Interval]

    def values(self, name: str) -> list[float]:
        """The figure without its interval; none where the results do not say."""
        known = self.figures.get(name)
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
    good = case.solved
    flags = {"open": case.open_cell, "low": case.at_lower_bound, "saturated": case.saturated}
    readings = {"missing": case.missing_readings, "bounds": case.bound_readings}
    known: dict[str, float | Interval | None] = {
        **{name: int(np.sum(values[good] != 0)) for name, values in flags.items() if values is not None},
        **{name: int(np.sum(values)) or None for name, values in readings.items() if values is not None},
    }
    if np.any(good):
        known |= _of_errors(case, generator) | _of_intervals(case, generator)
    figures = {name: value for name, value in known.items() if value is not None}
    return Measures(case, int(np.sum(good)), int(case.measured[good].size), figures)


def _of_errors(case: CaseResult, generator: np.random.Generator) -> dict[str, float | Interval | None]:
    """Errors, residuals, times and pressures of the solved frames, of which there is one at least."""
    good = case.solved
    known: dict[str, float | Interval | None] = {
        "data_error": _mean(data_error(case)[good]),
        "time": 1e3 * float(np.median(case.solve_time[good])),
    }
    if case.truth is not None:
        error = relative_error(case.cell_resistance, case.truth)[good].reshape(int(np.sum(good)), -1)
        block = block_length(np.median(error, axis=1)[:, None])
        known["cell_error"] = median_interval(error, picks(len(error), block, generator))
    residual = weighted_residual(case)
    if residual is not None:
        known["misfit"] = _mean(residual[good] ** 2)
        known["spread"] = 1.4826 * float(np.nanmedian(np.abs(residual[good])))  # 1/Φ⁻¹(3/4): from median deviation to σ
    if case.data_share is not None:
        known["share"] = 100 * float(np.median(case.data_share[good]))
    if case.pressure is not None:
        known["suction"], known["contact"] = float(np.min(case.pressure[good])), float(np.max(case.pressure[good]))
    return known


def _of_intervals(case: CaseResult, generator: np.random.Generator) -> dict[str, float | Interval | None]:
    """Widths of the 95 % intervals of the solved frames, and how much of the truth they cover."""
    good, lower, upper = case.solved, case.cell_resistance_lower, case.cell_resistance_upper
    if lower is None or upper is None:
        return {}
    widths = (100 * (upper - lower) / case.cell_resistance)[good]
    known: dict[str, float | Interval | None] = {
        "width": _mean(widths),
        "endless": int(np.sum(~np.isfinite(widths))),
    }
    if case.truth is not None:
        within = ((lower <= case.truth) & (case.truth <= upper))[good]
        free = ((case.open_cell == 0) & (case.at_lower_bound == 0))[good]
        for name, counted in (("coverage", np.ones_like(within)), ("free_coverage", free)):
            cells = counted.sum(axis=(1, 2))
            if np.all(cells):
                shares = 100 * (within & counted).sum(axis=(1, 2)) / cells
                known[name] = mean_interval(shares, picks(len(shares), block_length(shares[:, None]), generator))
    return known


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


def _mean(values: Array) -> float | None:
    numbers = values[np.isfinite(values)]
    return float(numbers.mean()) if numbers.size else None


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
