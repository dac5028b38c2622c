"""The report's tables: a recording's estimators, all recordings together, estimators against each other."""

from collections.abc import Callable, Mapping, Sequence
from statistics import fmean, median
from typing import NamedTuple

import numpy as np

from lampest.report.compare import LEAST, Table
from lampest.report.page.batch import Batch
from lampest.report.page.compared import Comparison
from lampest.report.page.measures import Interval, Measures
from lampest.report.page.template import HARD, NONE, between, frames_text, signed, weights_text
from lampest.report.words import digits


class Line(NamedTuple):
    """One line over estimators. name : of a figure of `Measures`. over : how those of several recordings become one."""

    label: str
    name: str
    over: Callable[[list[float]], float] = median


LINES = (
    Line("median cell error [%] (95 % interval)", "cell_error"),
    Line("data error, mean [%]", "data_error"),
    Line("residuals: mean of ((model − measured)/σ)²", "misfit"),
    Line("residuals: robust standard deviation [σ]", "spread"),
    Line("95 % intervals: mean width [% of the cell]", "width"),
    Line("95 % intervals with an open end", "endless", sum),
    Line("truth within its interval [%]", "coverage", fmean),
    Line("the same, cells away from bounds [%]", "free_coverage", fmean),
    Line("share of an estimate that data decide, median [%]", "share"),
    Line("time per frame, median [ms]", "time"),
    Line("open cells", "open", sum),
    Line("cells at the lower bound", "low", sum),
    Line("missing readings", "missing", sum),
    Line("readings at a rail, zero or below the series resistance", "bounds", sum),
    Line("saturated cells", "saturated", sum),
    Line("pressure, smallest [kPa]", "suction", min),
    Line("pressure, largest [kPa]", "contact", max),
)


def recording_table(found: Mapping[str, Measures]) -> Table:
    """Every figure of one recording, a column for each estimator; lines of which nothing is known are left out."""
    return _table({name: [own] for name, own in found.items()}, True)


def batch_table(batch: Batch, found: Mapping[str, Mapping[str, Measures]]) -> Table:
    """All recordings together: medians of their figures, means of coverages, sums of cells and frames."""
    counted = [found[subject.name] for subject in batch.subjects]
    return _table({name: [case[name] for case in counted if name in case] for name in batch.estimators}, False)


def _table(groups: Mapping[str, Sequence[Measures]], alone: bool) -> Table:
    """A column for every estimator's cases; alone : whether each has one."""
    every = groups.values()
    rows = [("frames solved", *map(_solved, every))]
    if any(one.case.local_optima for own in every for one in own):
        rows.append(("of them local optima (starts of a frame)", *map(_optima, every)))
    rows.append(("weights", *(weights_text([one.case.weights for one in own]) or NONE for own in every)))
    for line in LINES:
        if any(one.values(line.name) for own in every for one in own):
            label = line.label if alone else line.label.replace(" (95 % interval)", "")
            rows.append((label, *(_entry(line, own, alone) for own in every)))
    return Table(("", *groups), tuple(rows))


def _entry(line: Line, own: Sequence[Measures], alone: bool) -> str:
    known = [value for one in own for value in one.values(line.name)]
    if not known:
        return NONE
    figure, value, cells = own[0].figures.get(line.name), line.over(known), sum(one.cells for one in own)
    if alone and isinstance(figure, Interval):
        return between(figure)
    if line.over is not sum:
        return f"<{HARD}{LEAST:g}" if 0 < value < LEAST else digits(value)
    return f"{value:,.0f}" + (f" ({digits(100 * value / cells, 2)}{HARD}%)" if value and cells else "")


def _solved(own: Sequence[Measures]) -> str:
    return f"{sum(one.solved for one in own):,} of {sum(len(one.case.time) for one in own):,}"


def _optima(own: Sequence[Measures]) -> str:
    """'21 (1 to 7)': how many frames end at a local optimum, the lowest that so many starts reached."""
    known = [one.case.local_optima for one in own if one.case.local_optima is not None]
    if not known:
        return NONE
    least, most = min(one[1] for one in known), max(one[2] for one in known)
    return f"{sum(one[0] for one in known):,} ({least if least == most else f'{least} to {most}'})"


def failures(found: Mapping[str, Measures]) -> tuple[str, ...]:
    """A sentence for each way in which an estimator failed."""
    return tuple(
        f"{name}, {'frame' if len(frames) == 1 else 'frames'} {frames_text(frames)}: {sentence}"
        for name, own in found.items()
        for sentence, frames in own.failures.items()
    )


def standing_table(comparison: Comparison) -> Table:
    """Every estimator against the best one: criterion, difference, wins, time."""
    criterion, best = comparison.criterion, comparison.standings[0].estimator
    headers = (
        "",
        f"{criterion.name}, mean [{criterion.unit}] (95 % interval)",
        f"difference from {best} [{criterion.difference_unit}] (95 % interval)",
        "verdict",
        f"smallest in, of {len(comparison.scores.values)}",
        "time per frame [ms]",
        f"times as fast as {best}",
    )
    rows = []
    for row in comparison.standings:
        speed = comparison.milliseconds(row.estimator)
        difference, verdict, ratio = NONE, "smallest", NONE
        if row.estimator != best:
            difference, ratio = signed(row.difference), digits(comparison.milliseconds(best) / speed, 2)
            verdict = "larger" if row.told_apart else "cannot be told apart"
        rows.append((row.estimator, between(row.mean), difference, verdict, str(row.wins), digits(speed), ratio))
    return Table(headers, tuple(rows))


def unit_table(comparison: Comparison) -> Table:
    """The criterion of every unit, the smallest of each set off."""
    scores = comparison.scores
    rows = [(unit, *map(digits, values)) for unit, values in zip(scores.units, scores.values, strict=True)]
    smallest = np.argwhere(scores.values == scores.values.min(axis=1, keepdims=True))
    best = frozenset((int(row), int(column) + 1) for row, column in smallest)
    return Table(("", *scores.estimators), tuple(rows), best=best)
