"""The report's tables as text: a recording's estimators, all recordings together, estimators against each other."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lampest.report.page.batch import Batch
from lampest.report.page.compared import Comparison
from lampest.report.page.interval import Interval
from lampest.report.page.measures import Measures
from lampest.report.page.words import HARD, NONE, between, digits, frames_text, signed, weights_text

NEXT_TO_NOTHING = 1e-3


@dataclass(frozen=True)
class Sheet:
    """A table: headers, then rows whose first cell is their name; `best` : (row, column) of cells to set off."""

    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: frozenset[tuple[int, int]] = frozenset()


class Line(NamedTuple):
    """One line over estimators. value : of a case, None if unknown. text : of one case; None: `digits` of the value.

    over : how the values of several recordings become one.
    """

    label: str
    value: Callable[[Measures], float | None]
    text: Callable[[Measures], str] | None
    over: Callable[[Sequence[float]], float]


def _plain(value: float) -> str:
    """Digits of a figure that is never negative; what is next to nothing is not spelt out."""
    return digits(value) if value == 0 or value >= NEXT_TO_NOTHING else f"<{HARD}{NEXT_TO_NOTHING:g}"


def _sum(values: Sequence[float]) -> float:
    return float(np.sum(values))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def _value(interval: Interval | None) -> float | None:
    return None if interval is None else interval.value


def _text(interval: Interval | None) -> str:
    return NONE if interval is None else between(interval)


def _of_cells(count: float | None, cells: int) -> str:
    if count is None:
        return NONE
    return f"{count:,.0f}" + (f" ({digits(100 * count / cells, 2)}{HARD}%)" if count else "")


def _count(count: int | None) -> str:
    return NONE if count is None else f"{count:,}"


def _optima(all_: Sequence[Measures]) -> str:
    """'21 (1 to 7)': how many frames end at a local optimum, the lowest that so many starts reached."""
    told = [own.optima for own in all_ if own.optima is not None]
    if not told:
        return NONE
    least, most = min(one[1] for one in told), max(one[2] for one in told)
    return f"{sum(one[0] for one in told):,} ({least if least == most else f'{least} to {most}'})"


LINES = (
    Line(
        "median cell error [%] (95 % interval)",
        lambda own: _value(own.cell_error),
        lambda own: _text(own.cell_error),
        _median,
    ),
    Line("data error, mean [%]", lambda own: own.data_error, None, _median),
    Line("residuals: mean of ((model − measured)/σ)²", lambda own: own.misfit, None, _median),
    Line("residuals: robust standard deviation [σ]", lambda own: own.spread, None, _median),
    Line("95 % intervals: mean width [% of the cell]", lambda own: own.width, None, _median),
    Line(
        "95 % intervals with an open end",
        lambda own: own.endless,
        lambda own: _of_cells(own.endless, own.cells),
        _sum,
    ),
    Line("truth within its interval [%]", lambda own: _value(own.coverage), lambda own: _text(own.coverage), _mean),
    Line(
        "the same, cells away from bounds [%]",
        lambda own: _value(own.free_coverage),
        lambda own: _text(own.free_coverage),
        _mean,
    ),
    Line("share of an estimate that data decide, median [%]", lambda own: own.share, None, _median),
    Line("time per frame, median [ms]", lambda own: own.time, None, _median),
    Line("open cells", lambda own: own.open, lambda own: _of_cells(own.open, own.cells), _sum),
    Line("cells at the lower bound", lambda own: own.low, lambda own: _of_cells(own.low, own.cells), _sum),
    Line("missing readings", lambda own: own.missing or None, lambda own: _count(own.missing), _sum),
    Line(
        "readings at a rail, zero or below the series resistance",
        lambda own: own.bounds or None,
        lambda own: _count(own.bounds),
        _sum,
    ),
    Line("saturated cells", lambda own: own.saturated, lambda own: _of_cells(own.saturated, own.cells), _sum),
)


def recording_sheet(found: Mapping[str, Measures]) -> Sheet:
    """Every figure of one recording, a column for each estimator; lines of which nothing is known are left out."""
    rows = [("frames solved", *(f"{own.solved} of {own.frames}" for own in found.values()))]
    if any(own.optima for own in found.values()):
        rows.append(("of them local optima (starts of a frame)", *(_optima([own]) for own in found.values())))
    rows.append(("weights", *(weights_text([own.weights]) or NONE for own in found.values())))
    for line in LINES:
        known = [line.value(own) for own in found.values()]
        if any(value is not None for value in known):
            texts = (
                NONE if value is None else _plain(value) if line.text is None else line.text(own)
                for own, value in zip(found.values(), known, strict=True)
            )
            rows.append((line.label, *texts))
    pressures = [own.pressure for own in found.values()]
    if any(pressures):
        texts = (NONE if pair is None else f"{digits(pair[0], 2)} to {digits(pair[1], 2)}" for pair in pressures)
        rows.append(("pressure, smallest to largest [kPa]", *texts))
    return Sheet(("", *found), tuple(rows))


def batch_sheet(batch: Batch, found: Mapping[str, Mapping[str, Measures]]) -> Sheet:
    """All recordings together: medians of their figures, means of coverages, sums of cells and frames."""
    counted = [found[subject.name] for subject in batch.subjects]
    own = {name: [case[name] for case in counted if name in case] for name in batch.estimators}
    rows = [
        (
            "frames solved",
            *(f"{sum(one.solved for one in all_):,} of {sum(one.frames for one in all_):,}" for all_ in own.values()),
        ),
    ]
    if any(one.optima for all_ in own.values() for one in all_):
        rows.append(("of them local optima (starts of a frame)", *(_optima(all_) for all_ in own.values())))
    rows.append(("weights", *(weights_text([one.weights for one in all_]) or NONE for all_ in own.values())))
    for line in LINES:
        values = [[value for one in all_ if (value := line.value(one)) is not None] for all_ in own.values()]
        if not any(values):
            continue
        texts = []
        for all_, known in zip(own.values(), values, strict=True):
            if not known:
                texts.append(NONE)
            elif line.over is _sum:
                texts.append(_of_cells(line.over(known), sum(one.cells for one in all_)))
            else:
                texts.append(_plain(line.over(known)))
        rows.append((line.label.replace(" (95 % interval)", ""), *texts))
    return Sheet(("", *own), tuple(rows))


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
        rows.append((f"{pair.first} − {pair.second}", signed(pair.difference), f"{pair.wins} : {pair.losses}", verdict))
    return Sheet(headers, tuple(rows))


def unit_sheet(comparison: Comparison) -> Sheet:
    """The criterion of every unit, the smallest of each set off."""
    scores = comparison.scores
    rows, best = [], set()
    for number, (unit, values) in enumerate(zip(scores.units, scores.values, strict=True)):
        rows.append((unit, *(digits(float(value)) for value in values)))
        best |= {(number, int(column) + 1) for column in np.flatnonzero(values == values.min())}
    return Sheet(("", *scores.estimators), tuple(rows), frozenset(best))
