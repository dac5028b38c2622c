"""Report page: one self-contained HTML file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import chain, combinations, compress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined

from lampest.apps.page import compared
from lampest.apps.page.all_frames import all_frames
from lampest.apps.page.compared import HARD, NONE, Batch, Comparison, between, weights_text
from lampest.files.errors import counted
from lampest.files.levels import MAD_TO_SIGMA
from lampest.files.whole import write_whole
from lampest.panel.panel import Array
from lampest.report.compare import (
    MAX_SHOWN,
    MIN_DIFFERENCE,
    Table,
    figures_of,
    statistics,
    weighted_residual,
)
from lampest.report.plots.contours import CertaintyPlot, ContourPlot, Plot, ResidualPlot
from lampest.report.plots.maps import Tile, maps_figure, signed_scale, values_of
from lampest.report.plots.style import WIDTH_INCH, data_uri, verbatim
from lampest.report.strongest import reference_words, strongest_index
from lampest.report.words import digits
from lampest.runs.case import CaseResult, Cases
from lampest.runs.executors import each_of
from lampest.runs.results import Reader, read_results

SPREAD = "residuals: robust standard deviation [σ]"
MAX_NARROW = 2  # maps of a figure of half the width
COVERED = "truth within its interval [%]"


def write_report(
    paths: Sequence[Path],
    out: Path,
    on_recording: Callable[[int, int], None] = lambda done, total: None,
    read: Reader = read_results,
) -> None:
    """Write the report of some results files; the same files give the same bytes.

    Raises InputError where a file cannot be read, there is nothing in them, or the place cannot be
    written.

    Parameters
    ----------
    paths : sequence of Path
        Results files.
    out : Path
        The page.
    on_recording : callable
        Receives the numbers of drawn and of all recordings.
    read : callable
        Returns the results of a path.
    """
    write_whole(out, report(compared.read_batch(paths, read), on_recording))


def report(
    batch: Batch, on_recording: Callable[[int, int], None] = lambda done, total: None
) -> str:
    """Return the page as HTML.

    `on_recording` is called as in `write_report`.
    """
    distinct, _ = compared.without_copies(batch.recordings)
    comparison = compared.comparison_of(batch)
    advice = compared.advise(batch, comparison)
    by_estimator = {
        name: [cases[name] for cases in distinct.values() if name in cases]
        for name in batch.estimators
    }
    if advice.estimator is not None:
        doubted = doubts(advice.estimator, list(map(figures, by_estimator[advice.estimator])))
        advice = replace(advice, warnings=(*advice.warnings, *doubted))
    first = [row.estimator for row in comparison.standings] if comparison else []
    drawn = [*dict.fromkeys((*first, *batch.estimators))][:MAX_SHOWN]
    tasks = [
        (name, cases, number, drawn)
        for number, (name, cases) in enumerate(batch.recordings.items())
    ]
    sections = each_of(_section, tasks, on_recording)
    return filled(
        "lampest.apps.page",
        batch=batch,
        advice=advice,
        comparison=comparison,
        standings=comparison and standing_table(comparison),
        units=comparison and len(comparison.units) <= 200 and unit_table(comparison),
        together=case_table(by_estimator) if len(distinct) > 1 else None,
        whole=sections[:MAX_SHOWN],
        others=sections[MAX_SHOWN:],
        most=MAX_SHOWN,
        origins={
            name: case
            for cases in [*batch.recordings.values()][::-1]
            for name, case in cases.items()
        },
        counted=counted,
        digits=digits,
    )


def _section(task: tuple[str, Mapping[str, CaseResult], int, Sequence[str]]) -> dict[str, Any]:
    """Return the content of a recording's section: contours and a table.

    The sections of the first recordings have all figures.
    """
    name, by_estimator, number, drawn = task
    in_full = number < MAX_SHOWN
    every = [*by_estimator.values()]
    cases = [case for case in every if case.estimator in drawn] or every[:1]
    place = strongest_index(cases)
    pairs = disagreements(cases) if in_full else ()
    words = f"Maps of relative change of {name}: measured, by every estimator, and true where known"
    with verbatim():
        shown = wide(ContourPlot(), cases, words)
        if in_full:
            frame = int(cases[0].frame[place])
            shown += wide(CertaintyPlot(frame), cases, "Maps of standard deviation and resolution")
            shown += wide(ResidualPlot(frame), cases, "Maps of the residuals")
            shown += differences(cases, place, pairs)
    return {
        "name": name,
        "anchor": f"recording-{number + 1}",
        "case": cases[0],
        "place": place,
        "table": case_table({estimator: [case] for estimator, case in by_estimator.items()}),
        "pictures": shown,
        "frames": all_frames(cases, place) if in_full else None,
        "reference": reference_words(cases[0]),
        "undecided": in_full and len(cases) > 1 and not pairs,
        "failed": failures(every),
    }


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


@dataclass(frozen=True)
class Illustration:
    """Image of the page.

    Attributes
    ----------
    kind : str
        Key in the captions of the page.
    uri : str
        Image as a data URI.
    alternative : str
        Alternative text.
    pairs : int
        Number of pairs that differ, of which the image shows some; 0 for another image.
    """

    kind: str
    uri: str
    alternative: str
    pairs: int = 0

    @property
    def spans(self) -> bool:
        """Whether the image spans the page."""
        return not 0 < self.pairs <= MAX_NARROW


def wide(plot: Plot, cases: Cases, words: str) -> list[Illustration]:
    """Draw a plot over the whole page; empty if no case has its columns."""
    drawable = plot.drawable(cases)
    return [Illustration(plot.kind, data_uri(plot.draw(drawable)), words)] if drawable else []


def differences(cases: Cases, place: int, pairs: Sequence[Disagreement]) -> list[Illustration]:
    """Draw maps of the pairs that differ most, of half the width where there are two at most."""
    tiles = [
        Tile(pair.title, pair.significant[place], f"{digits(pair.share, 2)} %")
        for pair in pairs[:9]
    ]
    if not tiles:
        return []
    scale = signed_scale(
        values_of(tiles), "difference of relative change [percentage points]", 1.0, 100.0
    )
    width = WIDTH_INCH / 2 if len(tiles) <= MAX_NARROW else WIDTH_INCH
    uri = data_uri(maps_figure(tiles, cases[0].scene.panel, scale, width=width))
    return [Illustration("differences", uri, "Maps of significant differences", len(pairs))]


def case_table(groups: Mapping[str, Cases]) -> Table:
    """Return a table with a column for each estimator and a line for each figure.

    Figures are medians over the cases, counts are sums. Lines without figures are omitted.
    """
    columns = [[figures(case) for case in cases] for cases in groups.values()]
    weights = (weights_text([case.weights for case in cases]) for cases in groups.values())
    rows = [
        ("frames at a verified optimum", *map(_optima, groups.values())),
        ("weights", *(text or NONE for text in weights)),
    ]
    for line in dict.fromkeys(chain.from_iterable(chain.from_iterable(columns))):
        figures_of_line = ([case.get(line) for case in column] for column in columns)
        rows.append((line, *map(_figure, figures_of_line)))
    return Table(("", *groups), tuple(row for row in rows if set(row[1:]) != {NONE}))


def _figure(known: Sequence[Any]) -> str:
    """Return the sum of whole numbers, or the median of others, in words."""
    values = [value for value in known if isinstance(value, int | float)]
    if not values:
        return NONE
    if all(isinstance(value, int) for value in values):
        return f"{sum(values):,}"
    value = float(np.median(values))
    return f"<{HARD}{MIN_DIFFERENCE:g}" if 0 < value < MIN_DIFFERENCE else digits(value)


def _optima(cases: Cases) -> str:
    """Return the number of frames at a verified optimum.

    An example is '21 of 22 (1 to 7 starts each)'.
    """
    solves = [case.local_optima for case in cases if case.local_optima is not None]
    if not solves:
        return NONE
    counts, least_starts, most_starts = zip(*solves, strict=True)
    frames = sum(len(case.time) for case in cases)
    least = min(least_starts)
    most = max(most_starts)
    starts = counted(most, "start") if least == most else f"{least} to {most} starts"
    return f"{sum(counts):,} of {frames:,} ({starts} each)"


def failures(cases: Cases) -> list[str]:
    """Return a sentence for each way in which an estimator failed."""
    sentences = []
    for case in cases:
        for status in dict.fromkeys(compress(case.status, ~case.solved)):
            frames = case.frame[[text == status for text in case.status]]
            noun = "frame" if len(frames) == 1 else "frames"
            sentences.append(f"{case.estimator}, {noun} {frames_text(frames.tolist())}: {status}")
    return sentences


def standing_table(comparison: Comparison) -> Table:
    """Compare every estimator with the best one: criterion, ratio, wins, time."""
    criterion = comparison.criterion
    first = comparison.standings[0]
    headers = (
        "",
        f"{criterion.name}, mean [{criterion.unit}] (95 % interval)",
        f"times that of {first.estimator} (95 % interval)",
        "significance",
        f"units with the smallest error, of {len(comparison.units)}",
        "time per frame [ms]",
        f"times as fast as {first.estimator}",
    )
    rows = []
    for row in comparison.standings:
        times = faster = NONE
        verdict = "smallest"
        if row is not first:
            times = between(row.ratio)
            faster = digits(first.milliseconds / row.milliseconds, 2)
            verdict = "significant" if row.is_significant else "not significant"
        speed = digits(row.milliseconds)
        texts = (between(row.mean), times, verdict, f"{row.wins}", speed, faster)
        rows.append((row.estimator, *texts))
    return Table(headers, tuple(rows))


def unit_table(comparison: Comparison) -> Table:
    """Return a table of the criterion by unit, with the smallest values highlighted."""
    values = comparison.values
    rows = (
        (unit, *map(digits, of_unit))
        for unit, of_unit in zip(comparison.units, values, strict=True)
    )
    smallest = np.argwhere(values == values.min(axis=1, keepdims=True)).tolist()
    best = frozenset((row, column + 1) for row, column in smallest)
    return Table(("", *comparison.match.estimators), tuple(rows), best=best)


@np.errstate(over="ignore")
def figures(case: CaseResult) -> dict[str, Any]:
    """Map lines of a table to figures of a case.

    The figures are those of `lampest compare`, of noise and of intervals. Counts are int; None if
    unknown.
    """
    residual = weighted_residual(case)
    lower = case.cell_resistance_lower
    upper = case.cell_resistance_upper
    by_line = figures_of(case, np.ones(len(case.time), bool))
    by_line |= statistics(residual**2, "residuals: {} of ((model − measured)/σ)²", "mean")
    by_line[SPREAD] = statistics(MAD_TO_SIGMA * np.abs(residual), "{}", "median")["median"]
    if lower is not None and upper is not None:
        widths = 100 * (upper - lower) / case.cell_resistance
        by_line |= statistics(widths, "95 % intervals: {} width [% of the cell]", "mean")
        by_line["95 % intervals with an open end"] = int(np.sum(np.isinf(widths)))
        if case.truth is not None:
            covered = (lower <= case.truth) & (case.truth <= upper)
            within = covered[case.solved][np.isfinite(case.truth[case.solved])]
            by_line[COVERED] = 100 * float(np.mean(within)) if within.size else None
    by_line |= statistics(
        case.data_share, "share of an estimate that comes from the data, {} [1]", "median"
    )
    by_line["cells at the lower bound"] = int(np.sum(case.at_lower_bound != 0))
    saturated = case.column("saturated")
    by_line["saturated cells"] = None if saturated is None else int(np.sum(saturated != 0))
    pressure = case.column("pressure")
    return by_line | statistics(pressure, "pressure, {} [kPa]", "smallest", "largest")


def doubts(estimator: str, recordings: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return warnings of residuals beyond the noise, and of wrong error bars.

    Parameters
    ----------
    estimator : str
        The recommended estimator.
    recordings : sequence of mapping
        `figures` of the estimator for each recording.
    """
    lines = SPREAD, COVERED
    spreads, coverages = (
        [by_line[line] for by_line in recordings if by_line.get(line) is not None] for line in lines
    )
    spread = float(np.median(spreads or [1.0]))
    coverage = float(np.mean(coverages or [100.0]))
    sentences = []
    if spread > 1.5:
        sentences.append(
            f"The residuals of {estimator} are {digits(spread, 2)} times the noise "
            "of the readings: the noise is larger than the scene states, "
            "an effect is missing in the model, or the penalty is too strong."
        )
    if coverage < 90:
        sentences.append(
            f"The 95 % intervals of {estimator} contain the truth "
            f"for {digits(coverage, 2)} % of the cells: "
            "an effect is missing in the scene, or the penalty does not suit these loads."
        )
    return tuple(sentences)


def disagreements(cases: Cases) -> tuple[Disagreement, ...]:
    """Return the significant differences of each pair of cases with error bars.

    The largest share comes first. For a > b the difference is significant if a − b > √((a − a_low)²
    + (b_high − b)²), which is exact for independent errors. Source: Zou and Donner, Stat. Med. 27,
    2008.
    """
    with_arms = []
    for case in cases:
        lower = case.relative_change_lower
        upper = case.relative_change_upper
        # Distances to the ends of the interval, never negative.
        if lower is not None and upper is not None:
            lengths = np.stack([case.relative_change - lower, upper - case.relative_change])
            with_arms.append((case, *np.maximum(lengths, 0.0)))
    pairs = []
    for one, other in combinations(with_arms, 2):
        first, first_below, first_above = one
        second, second_below, second_above = other
        both = first.solved & second.solved
        difference = first.relative_change - second.relative_change
        # half width of the interval of the difference towards zero
        reach = np.where(
            difference > 0, np.hypot(first_below, second_above), np.hypot(first_above, second_below)
        )
        significant = np.where(np.abs(difference) > reach, difference, np.nan)
        if np.any(both):
            share = 100 * float(np.mean(np.isfinite(significant[both])))
            title = f"{first.estimator} − {second.estimator}"
            pairs.append(Disagreement(title, significant, share))
    return tuple(sorted(pairs, key=lambda pair: -pair.share))


def frames_text(frames: Sequence[int]) -> str:
    """Return frame numbers such as '3, 5 to 7'."""
    runs = np.split(np.asarray(frames), np.flatnonzero(np.diff(frames) != 1) + 1)
    return ", ".join(
        f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs
    )


def filled(package: str, **values: Any) -> str:
    """Render the template `page.html` of a package, which may import `parts.html`."""

    def source(name: str) -> str:
        home = "lampest.apps.page" if name == "parts.html" else package
        return files(home).joinpath(name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(**values)
