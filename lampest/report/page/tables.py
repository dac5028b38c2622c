"""The report's tables: a recording's estimators, all recordings together, estimators against each other."""

from collections.abc import Mapping, Sequence

import numpy as np

from lampest.report.compare import LEAST, Table
from lampest.report.page.compared import Comparison
from lampest.report.page.measures import HARD, NONE, between, figures, frames_text, weights_text
from lampest.report.words import digits
from lampest.runs.case import CaseResult


def case_table(groups: Mapping[str, Sequence[CaseResult]]) -> Table:
    """A column for each estimator's cases, a line for each figure: medians over the cases, sums of counts.

    Lines of which nothing is known are left out.
    """
    known = [[figures(case) for case in cases] for cases in groups.values()]
    rows = [
        ("frames at a verified optimum (starts of a frame)", *map(_optima, groups.values())),
        ("weights", *(weights_text([case.weights for case in cases]) or NONE for cases in groups.values())),
    ]
    for line in dict.fromkeys(line for column in known for one in column for line in one):
        values = [[one[line] for one in column if isinstance(one.get(line), int | float)] for column in known]
        rows.append((line, *map(_figure, values)))
    return Table(("", *groups), tuple(row for row in rows if set(row[1:]) != {NONE}))


def _figure(values: Sequence[float]) -> str:
    if not values:
        return NONE
    if all(isinstance(value, int) for value in values):
        return f"{sum(values):,}"
    value = float(np.median(values))
    return f"<{HARD}{LEAST:g}" if 0 < value < LEAST else digits(value)


def _optima(cases: Sequence[CaseResult]) -> str:
    """'21 (1 to 7)': how many frames end at a local optimum, the lowest that so many starts reached."""
    known = [case.local_optima for case in cases if case.local_optima is not None]
    if not known:
        return NONE
    least, most = min(one[1] for one in known), max(one[2] for one in known)
    return f"{sum(one[0] for one in known):,} ({least if least == most else f'{least} to {most}'})"


def failures(cases: Sequence[CaseResult]) -> list[str]:
    """A sentence for each way in which an estimator failed."""
    sentences = []
    for case in cases:
        for status in dict.fromkeys(case.status[index] for index in np.flatnonzero(~case.solved)):
            frames = case.frame[[one == status for one in case.status]]
            noun = "frame" if len(frames) == 1 else "frames"
            sentences.append(f"{case.estimator}, {noun} {frames_text(frames.tolist())}: {status}")
    return sentences


def standing_table(comparison: Comparison) -> Table:
    """Every estimator against the best one: criterion, difference, wins, time."""
    criterion, best = comparison.criterion, comparison.standings[0].estimator
    headers = (
        "",
        f"{criterion.name}, mean [{criterion.unit}] (95 % interval)",
        f"difference from {best} [{criterion.difference_unit}] (95 % interval)",
        "significance",
        f"units with the smallest error, of {len(comparison.units)}",
        "time per frame [ms]",
        f"times as fast as {best}",
    )
    rows = []
    for row in comparison.standings:
        speed = comparison.milliseconds[row.estimator]
        difference, verdict, ratio = NONE, "smallest", NONE
        if row.estimator != best:
            difference, ratio = between(row.difference, sign="+"), digits(comparison.milliseconds[best] / speed, 2)
            verdict = "significant" if row.told_apart else "not significant"
        rows.append((row.estimator, between(row.mean), difference, verdict, str(row.wins), digits(speed), ratio))
    return Table(headers, tuple(rows))


def unit_table(comparison: Comparison) -> Table:
    """The criterion of every unit, the smallest of each set off."""
    rows = [(unit, *map(digits, values)) for unit, values in zip(comparison.units, comparison.values, strict=True)]
    smallest = np.argwhere(comparison.values == comparison.values.min(axis=1, keepdims=True))
    best = frozenset((int(row), int(column) + 1) for row, column in smallest)
    return Table(("", *comparison.match.estimators), tuple(rows), best=best)
