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

from lampest.files.levels import MAD_TO_SIGMA
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
    """Return the block length of a bootstrap: n^(1/3), or the correlation length if longer, at most n/3.

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
    """Draw units in circular blocks of neighbours, shape (draws, count); blocks of 1 are the ordinary bootstrap.

    Source: Politis and Romano, in LePage and Billard (eds.), Exploring the Limits of Bootstrap, 1992.
    """
    starts = generator.integers(count, size=(DRAWS, ceil(count / block)))
    return ((starts[:, :, None] + np.arange(block)) % count).reshape(DRAWS, -1)[:, :count]


def mean_interval(values: Array, drawn: Picks) -> Interval:
    """Return the mean of values, shape (units,), with its interval."""
    return Interval(float(np.mean(values)), *np.percentile(values[drawn].mean(axis=1), (2.5, 97.5)).tolist())


@np.errstate(over="ignore")
def figures(case: CaseResult) -> dict[str, Any]:
    """Map lines of a table to figures of a case: those of `lampest compare`, of noise and of intervals.

    Counts are int; None if unknown.
    """
    residual, lower, upper = weighted_residual(case), case.cell_resistance_lower, case.cell_resistance_upper
    spread = None if residual is None else MAD_TO_SIGMA * np.abs(residual)
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
    """Return 100·|ln(r/r_true)|, (frames, rows, columns) percent; NaN for failed frames. Requires the truth."""
    assert case.truth is not None
    positive = np.maximum(case.cell_resistance, np.finfo(float).tiny)
    return np.asarray(100 * np.abs(np.log(positive / case.truth)))


class Disagreement(NamedTuple):
    """Significant differences between two estimators of a recording.

    Attributes
    ----------
    significant : array, shape (frames, rows, columns)
        Difference of relative change in percentage points, NaN if not significant.
    share : float
        Percentage of cells with a significant difference, in frames that both solved.
    """

    title: str
    significant: Array
    share: float


def disagreements(cases: Sequence[CaseResult]) -> tuple[Disagreement, ...]:
    """Compare each pair of cases with error bars; the pairs that differ most come first.

    a − b > √((a − a_low)² + (b_high − b)²) for a > b: Zou and Donner, Stat. Med. 27, 2008; exact if independent.
    """
    known = [(case, arms) for case in cases if (arms := _arms(case)) is not None]
    pairs = []
    for (first, (first_below, first_above)), (second, (second_below, second_above)) in combinations(known, 2):
        both, difference = first.solved & second.solved, first.relative_change - second.relative_change
        reach = np.where(difference > 0, np.hypot(first_below, second_above), np.hypot(first_above, second_below))
        significant = np.where(np.abs(difference) > reach, difference, np.nan)
        if np.any(both):
            share = 100 * float(np.mean(np.isfinite(significant[both])))
            pairs.append(Disagreement(f"{first.estimator} − {second.estimator}", significant, share))
    return tuple(sorted(pairs, key=lambda pair: -pair.share))


def _arms(case: CaseResult) -> tuple[Array, Array] | None:
    """Return distances from the estimate to the ends of its interval, percentage points, never negative."""
    lower, upper = case.relative_change_lower, case.relative_change_upper
    if lower is None or upper is None:
        return None
    return np.maximum(case.relative_change - lower, 0.0), np.maximum(upper - case.relative_change, 0.0)


NONE = "–"
HARD = "\N{NO-BREAK SPACE}"


def filled(package: str, **values: Any) -> str:
    """Render the template `page.html` of a package, which may import `parts.html`."""

    def source(name: str) -> str:
        home = "lampest.report.page" if name == "parts.html" else package
        return files(home).joinpath(name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html").render(**values)


def between(interval: Interval, unit: str = "", sign: str = "") -> str:
    """Format an interval, such as '2.13 (1.95 to 2.36) %', with two digits of its length.

    sign : '+' for differences, printed before positive numbers.
    """
    length = interval.upper - interval.lower
    like = max(length, abs(interval.value) / 10) if np.isfinite(length) else None
    ends = (interval.value, interval.lower, interval.upper)
    value, lower, upper = (sign * (end > 0) + digits(end, 2, like) for end in ends)
    return f"{value} ({lower}{HARD}to{HARD}{upper}){unit and HARD + unit}"


def weights_text(cases: Sequence[Mapping[str, Array]]) -> str:
    """Return the weights of the penalties, such as 'gradient λ = 0.001', as median and range if they differ."""
    by_term: dict[str, list[Array]] = {}
    for weights in cases:
        for term, values in weights.items():
            by_term.setdefault(term, []).append(values[np.isfinite(values)])
    parts = []
    for term, each in by_term.items():
        known, text = np.concatenate(each), NONE
        if known.size:
            low, text, high = (f"{value:.3g}" for value in (known.min(), np.median(known), known.max()))
            text += f" ({low} to {high})" if low != high else ""
        parts += [f"{term.replace('_', ' ')} λ = {text}"] if term != "misfit" else []
    return ", ".join(parts) or ("no penalty" if by_term else "")


def frames_text(frames: Sequence[int]) -> str:
    """Return frame numbers such as '3, 5 to 7'."""
    runs = np.split(np.asarray(frames), np.flatnonzero(np.diff(frames) != 1) + 1)
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)
