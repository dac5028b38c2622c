"""The report's tables: a recording's estimators, all recordings together, estimators against each other."""

from collections.abc import Mapping, Sequence

import numpy as np

from lampest.report.compare import LEAST, Table
from lampest.report.page.compared import Comparison
from lampest.report.page.measures import HARD, NONE, between, figures, frames_text, weights_text
from lampest.report.words import digits
from lampest.runs.case import CaseResult


def case_table(groups: Mapping[str, Sequence[CaseResult]]) -> Table:
    """Return a table with a column for each estimator and a line for each figure.

    Figures are medians over the cases, counts are sums. Lines without figures are omitted.
    """
    known = [[figures(case) for case in cases] for cases in groups.values()]
    rows = [
        ("frames at a verified optimum (starts of a frame)", *map(_optima, groups.values())),
        ("weights", *(weights_text([case.weights for case in cases]) or NONE for cases in groups.values())),
    ]
    for line in dict.fromkeys(line for column in known for case in column for line in case):
        values = [[case[line] for case in column if isinstance(case.get(line), int | float)] for column in known]
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
    """Return the number of frames at a verified optimum and the number of starts, such as '21 (1 to 7)'."""
    known = [case.local_optima for case in cases if case.local_optima is not None]
    if not known:
        return NONE
    least, most = min(optima[1] for optima in known), max(optima[2] for optima in known)
    return f"{sum(optima[0] for optima in known):,} ({least if least == most else f'{least} to {most}'})"


def failures(cases: Sequence[CaseResult]) -> list[str]:
    """Return a sentence for each way in which an estimator failed."""
    sentences = []
    for case in cases:
        for status in dict.fromkeys(case.status[index] for index in np.flatnonzero(~case.solved)):
            frames = case.frame[[text == status for text in case.status]]
            noun = "frame" if len(frames) == 1 else "frames"
            sentences.append(f"{case.estimator}, {noun} {frames_text(frames.tolist())}: {status}")
    return sentences


def standing_table(comparison: Comparison) -> Table:
    """Compare every estimator with the best one: criterion, difference, wins, time."""
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
    """Return a table of the criterion by unit, with the smallest values highlighted."""
    rows = [(unit, *map(digits, values)) for unit, values in zip(comparison.units, comparison.values, strict=True)]
    smallest = np.argwhere(comparison.values == comparison.values.min(axis=1, keepdims=True))
    best = frozenset((int(row), int(column) + 1) for row, column in smallest)
    return Table(("", *comparison.match.estimators), tuple(rows), best=best)
