"""The report's tables: a recording's estimators, all recordings together, estimators against each other."""

from collections.abc import Callable, Mapping, Sequence
from statistics import fmean, median

import numpy as np

from lampest.report.compare import LEAST, Table
from lampest.report.page.batch import Batch
from lampest.report.page.compared import Comparison
from lampest.report.page.measures import COVERED, FREE_COVERED, LARGEST, SMALLEST, Interval, Measures
from lampest.report.page.template import HARD, NONE, between, frames_text, signed, weights_text
from lampest.report.words import digits

OVER: dict[str, Callable[[list[float]], float]] = {COVERED: fmean, FREE_COVERED: fmean, SMALLEST: min, LARGEST: max}


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
    solved = (f"{sum(one.solved for one in own):,} of {sum(len(one.case.time) for one in own):,}" for own in every)
    rows = [("frames solved", *solved)]
    if any(one.case.local_optima for own in every for one in own):
        rows.append(("of them local optima (starts of a frame)", *map(_optima, every)))
    rows.append(("weights", *(weights_text([one.case.weights for one in own]) or NONE for own in every)))
    for line in dict.fromkeys(line for own in every for one in own for line in one.figures):
        label = line if alone else line.replace(" (95 % interval)", "")
        rows.append((label, *(_entry(line, own, alone) for own in every)))
    return Table(("", *groups), tuple(rows))


def _entry(line: str, own: Sequence[Measures], alone: bool) -> str:
    """One case's figure with its interval, or those of several as one: sums of counts, see `OVER` for the rest."""
    known = [value for one in own for value in one.values(line)]
    if not known:
        return NONE
    figure = own[0].figures.get(line)
    if alone and isinstance(figure, Interval):
        return between(figure)
    if all(isinstance(value, int) for value in known):
        total, cells = sum(known), sum(one.solved * one.case.measured[0].size for one in own)
        return f"{total:,}" + (f" ({digits(100 * total / cells, 2)}{HARD}%)" if total and cells else "")
    value = OVER.get(line, median)(known)
    return f"<{HARD}{LEAST:g}" if 0 < value < LEAST else digits(value)


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
        speed = comparison.milliseconds[row.estimator]
        difference, verdict, ratio = NONE, "smallest", NONE
        if row.estimator != best:
            difference, ratio = signed(row.difference), digits(comparison.milliseconds[best] / speed, 2)
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
