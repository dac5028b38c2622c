"""The report's tables as text: a recording's estimators, all recordings together, estimators against each other."""

from collections.abc import Callable, Mapping, Sequence
from statistics import fmean, median
from typing import NamedTuple

import numpy as np

from lampest.report.page.batch import Batch
from lampest.report.page.compared import Comparison
from lampest.report.page.measures import Interval, Measures
from lampest.report.page.template import HARD, NONE, Sheet, between, digits, frames_text, signed, weights_text

LEAST = 1e-3  # of a figure: less is not spelt out


class Line(NamedTuple):
    """One line over estimators. name : of a figure of `Measures`. over : how those of several recordings become one."""

    label: str
    name: str
    over: Callable[[Sequence[float]], float] = median


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
)


def recording_sheet(found: Mapping[str, Measures]) -> Sheet:
    """Every figure of one recording, a column for each estimator; lines of which nothing is known are left out."""
    rows = _rows({name: [own] for name, own in found.items()}, True)
    pressures = [own.pressure for own in found.values()]
    if any(pressures):
        texts = (NONE if pair is None else f"{digits(pair[0], 2)} to {digits(pair[1], 2)}" for pair in pressures)
        rows.append(("pressure, smallest to largest [kPa]", *texts))
    return Sheet(("", *found), tuple(rows))


def batch_sheet(batch: Batch, found: Mapping[str, Mapping[str, Measures]]) -> Sheet:
    """All recordings together: medians of their figures, means of coverages, sums of cells and frames."""
    counted = [found[subject.name] for subject in batch.subjects]
    own = {name: [case[name] for case in counted if name in case] for name in batch.estimators}
    return Sheet(("", *own), tuple(_rows(own, False)))


def _rows(groups: Mapping[str, Sequence[Measures]], alone: bool) -> list[tuple[str, ...]]:
    """A column for every estimator's cases; alone : whether each has one."""
    every = groups.values()
    rows = [
        ("frames solved", *(f"{sum(o.solved for o in all_):,} of {sum(o.frames for o in all_):,}" for all_ in every))
    ]
    if any(own.optima for all_ in every for own in all_):
        rows.append(("of them local optima (starts of a frame)", *map(_optima, every)))
    rows.append(("weights", *(weights_text([own.weights for own in all_]) or NONE for all_ in every)))
    for line in LINES:
        known = [[value for own in all_ if (value := getattr(own, line.name)) is not None] for all_ in every]
        if any(known):
            label = line.label if alone else line.label.replace(" (95 % interval)", "")
            rows.append((label, *(_entry(line, *both, alone) for both in zip(every, known, strict=True))))
    return rows


def _entry(line: Line, own: Sequence[Measures], known: Sequence[Interval | float], alone: bool) -> str:
    if not known:
        return NONE
    if alone and isinstance(known[0], Interval):
        return between(known[0])
    value = line.over([one.value if isinstance(one, Interval) else one for one in known])
    cells = sum(one.cells for one in own)
    if line.over is not sum:
        return digits(value) if value == 0 or value >= LEAST else f"<{HARD}{LEAST:g}"
    return f"{value:,.0f}" + (f" ({digits(100 * value / cells, 2)}{HARD}%)" if value and cells else "")


def _optima(all_: Sequence[Measures]) -> str:
    """'21 (1 to 7)': how many frames end at a local optimum, the lowest that so many starts reached."""
    known = [own.optima for own in all_ if own.optima is not None]
    if not known:
        return NONE
    least, most = min(one[1] for one in known), max(one[2] for one in known)
    return f"{sum(one[0] for one in known):,} ({least if least == most else f'{least} to {most}'})"


def failures(found: Mapping[str, Measures]) -> tuple[str, ...]:
    """A sentence for each way in which an estimator failed."""
    return tuple(
        f"{name}, {'frame' if len(frames) == 1 else 'frames'} {frames_text(frames)}: {sentence}"
        for name, own in found.items()
        for sentence, frames in own.failures
    )


def standing_sheet(comparison: Comparison) -> Sheet:
    """Every estimator against the best one: criterion, difference, wins, time."""
    criterion, best = comparison.criterion, comparison.standings[0].estimator
    units = len(comparison.scores.values)
    least = comparison.milliseconds(best)
    headers = (
        "",
        f"{criterion.name}, mean [{criterion.unit}] (95 % interval)",
        f"difference from {best} [{criterion.difference_unit}] (95 % interval)",
        "verdict",
        f"smallest in, of {units}",
        "time per frame [ms]",
        f"times as fast as {best}",
    )
    rows = []
    for row in comparison.standings:
        first = row.estimator == best
        verdict = "smallest" if first else ("larger" if row.against_best.told_apart else "cannot be told apart")
        speed = comparison.milliseconds(row.estimator)
        rows.append(
            (
                row.estimator,
                between(row.mean),
                NONE if first else signed(row.against_best.difference),
                verdict,
                str(row.wins),
                digits(speed),
                NONE if first else digits(least / speed, 2),
            )
        )
    return Sheet(headers, tuple(rows))


def pair_sheet(comparison: Comparison) -> Sheet:
    """Every two estimators: paired difference and in how many units each was the smaller one."""
    headers = ("", f"difference [{comparison.criterion.difference_unit}] (95 % interval)", "smaller in", "verdict")
    rows = []
    for pair in comparison.pairs:
        smaller = pair.first if pair.difference.value < 0 else pair.second
        verdict = f"{smaller} is smaller" if pair.told_apart else "cannot be told apart"
        rows.append(
            (
                f"{pair.first} − {pair.second}",
                signed(pair.difference),
                f"{pair.wins} : {pair.losses}",
                verdict,
            )
        )
    return Sheet(headers, tuple(rows))


def unit_sheet(comparison: Comparison) -> Sheet:
    """The criterion of every unit, the smallest of each set off."""
    scores = comparison.scores
    rows, best = [], set()
    for number, (unit, values) in enumerate(zip(scores.units, scores.values, strict=True)):
        rows.append((unit, *(digits(float(value)) for value in values)))
        best |= {(number, int(column) + 1) for column in np.flatnonzero(values == values.min())}
    return Sheet(("", *scores.estimators), tuple(rows), frozenset(best))
