"""Figures of one case, bootstrap intervals, and where two cases differ significantly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import combinations
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.report.compare import figures_of, statistics, weighted_residual
from lampest.report.words import digits
from lampest.runs.case import CaseResult

DRAWS = 2000  # of which the 2.5th percentile is known to 0.06 standard deviations
SPREAD, COVERED = "residuals: robust standard deviation [σ]", "truth within its interval [%]"
Picks = NDArray[np.intp]


@dataclass(frozen=True)
class Interval:
    """A figure and the ends of its 95 % bootstrap interval (percentiles)."""

    value: float
    lower: float
    upper: float


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
    return Interval(float(np.mean(values)), *np.percentile(values[drawn].mean(axis=1), (2.5, 97.5)).tolist())


@np.errstate(over="ignore")
def figures(case: CaseResult) -> dict[str, Any]:
    """Line of a table → what it says of a case: the figures of `lampest compare`, and those of noise and intervals.

    Counts are int; None where the results do not say.
    """
    residual, lower, upper = weighted_residual(case), case.cell_resistance_lower, case.cell_resistance_upper
    spread = None if residual is None else 1.4826 * np.abs(residual)  # 1/Φ⁻¹(3/4): from median deviation to σ
    known: dict[str, Any] = figures_of(case, np.ones(len(case.time), bool))
    known |= statistics(None if residual is None else residual**2, "residuals: {} of ((model − measured)/σ)²", "mean")
    known[SPREAD] = statistics(spread, "{}", "median")["median"]
    if lower is not None and upper is not None:
        widths = 100 * (upper - lower) / case.cell_resistance
        known |= statistics(widths, "95 % intervals: {} width [% of the cell]", "mean")
        known["95 % intervals with an open end"] = int(np.sum(np.isinf(widths)))
        if case.truth is not None:
            within = ((lower <= case.truth) & (case.truth <= upper))[case.solved]
            known[COVERED] = 100 * float(np.mean(within)) if within.size else None
    known |= statistics(case.data_share, "share of an estimate that comes from the data, {} [1]", "median")
    known["cells at the lower bound"] = int(np.sum(case.at_lower_bound != 0))
    known["saturated cells"] = None if case.saturated is None else int(np.sum(case.saturated != 0))
    return known | statistics(case.pressure, "pressure, {} [kPa]", "smallest", "largest")


def log_error(case: CaseResult) -> Array:
    """100·|ln(r/r_true)|, (frames, rows, columns) percent; NaN where a frame failed. The case must know its truth."""
    assert case.truth is not None
    positive = np.maximum(case.cell_resistance, np.finfo(float).tiny)
    return np.asarray(100 * np.abs(np.log(positive / case.truth)))


class Disagreement(NamedTuple):
    """Two estimators of one recording.

    significant : (frames, rows, columns) relative change of the first − second in percentage points where that is
    significant, else NaN. share : of the cells of the frames that both solved where it is, percent.
    """

    title: str
    significant: Array
    share: float


def disagreements(cases: Sequence[CaseResult]) -> tuple[Disagreement, ...]:
    """Every two cases with error bars that both solved something, those that disagree most first.

    a − b > √((a − a_low)² + (b_high − b)²) for a > b: Zou and Donner, Stat. Med. 27, 2008; exact if independent.
    """
    known = [(case, arms) for case in cases if (arms := _arms(case)) is not None]
    pairs = []
    for (one, (below, above)), (other, (other_below, other_above)) in combinations(known, 2):
        both, difference = one.solved & other.solved, one.relative_change - other.relative_change
        reach = np.where(difference > 0, np.hypot(below, other_above), np.hypot(above, other_below))
        significant = np.where(np.abs(difference) > reach, difference, np.nan)
        if np.any(both):
            share = 100 * float(np.mean(np.isfinite(significant[both])))
            pairs.append(Disagreement(f"{one.estimator} − {other.estimator}", significant, share))
    return tuple(sorted(pairs, key=lambda pair: -pair.share))


def _arms(case: CaseResult) -> tuple[Array, Array] | None:
    """Distances from the estimate to the lower and the upper end of its interval, percentage points, never negative."""
    lower, upper = case.relative_change_lower, case.relative_change_upper
    if lower is None or upper is None:
        return None
    return np.maximum(case.relative_change - lower, 0.0), np.maximum(upper - case.relative_change, 0.0)


NONE = "–"
HARD = "\N{NO-BREAK SPACE}"


def filled(package: str, **values: Any) -> str:
    """`page.html` of a package as HTML; it may take `parts.html`, the look and the tables of all pages."""

    def source(name: str) -> str:
        home = "lampest.report.page" if name == "parts.html" else package
        return files(home).joinpath(name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html").render(**values)


def between(interval: Interval, unit: str = "", sign: str = "") -> str:
    """'2.13 (1.95 to 2.36) %': two digits of the interval's length, three of the figure at most, on one line.

    sign : '+' of differences, before positive numbers.
    """
    length = interval.upper - interval.lower
    like = max(length, abs(interval.value) / 10) if np.isfinite(length) else None
    ends = (interval.value, interval.lower, interval.upper)
    value, lower, upper = (sign * (end > 0) + digits(end, 2, like) for end in ends)
    return f"{value} ({lower}{HARD}to{HARD}{upper}){unit and HARD + unit}"


def weights_text(cases: Sequence[Mapping[str, Array]]) -> str:
    """'gradient λ = 0.001' of the penalties used; median and range where they differ; empty where nothing is known."""
    found: dict[str, list[Array]] = {}
    for weights in cases:
        for term, values in weights.items():
            found.setdefault(term, []).append(values[np.isfinite(values)])
    parts = []
    for term, each in found.items():
        known, text = np.concatenate(each), NONE
        if known.size:
            low, text, high = (f"{value:.3g}" for value in (known.min(), np.median(known), known.max()))
            text += f" ({low} to {high})" if low != high else ""
        parts += [f"{term.replace('_', ' ')} λ = {text}"] if term != "misfit" else []
    return ", ".join(parts) or ("no penalty" if found else "")


def frames_text(frames: Sequence[int]) -> str:
    """'3, 5 to 7'."""
    runs = np.split(np.asarray(frames), np.flatnonzero(np.diff(frames) != 1) + 1)
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)
