"""The comparison over recordings on the page: its tables and figures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp

from lampest.report.page.compared import Comparison
from lampest.report.page.section import Illustration
from lampest.report.page.statistics import Standing
from lampest.report.page.tables import Sheet, pair_sheet, standing_sheet, unit_sheet
from lampest.report.page.words import counted, digits
from lampest.report.plots.standing import Forest, ForestLine, forest_figure, paired_figure
from lampest.report.plots.style import data_uri, short_title

MOST_UNITS = 200


@dataclass(frozen=True)
class StandingSection:
    """about : what is compared and how, sentences. units : every recording's or frame's figure, or None if too many."""

    about: tuple[str, ...]
    standings: Sheet
    pictures: tuple[Illustration, ...]
    pairs: Sheet
    units: Sheet | None
    units_title: str


def standing_section(comparison: Comparison) -> StandingSection:
    """Everything on the page about who is better."""
    few = len(comparison.scores.units) <= MOST_UNITS
    return StandingSection(
        _about(comparison),
        standing_sheet(comparison),
        _pictures(comparison),
        pair_sheet(comparison),
        unit_sheet(comparison) if few else None,
        "Every frame" if comparison.scores.over_frames else "Every recording",
    )


def _about(comparison: Comparison) -> tuple[str, ...]:
    scores, criterion = comparison.scores, comparison.criterion
    if scores.over_frames:
        drawn = "single frames" if scores.block == 1 else f"blocks of {scores.block} neighbouring frames"
        units = (
            f"The {counted(len(scores.values), 'frame')} of one recording that all estimators solved are compared in "
            f"pairs; the bootstrap draws {drawn}."
        )
    else:
        units = (
            f"{counted(len(scores.values), 'recording')} with {counted(comparison.match.frames, 'frame')} that all "
            "estimators solved are compared in pairs; the bootstrap draws recordings."
        )
    smaller = "Smaller is better." if criterion.decides else "Smaller is nearer to the readings, not to the cells."
    return (f"Criterion: {criterion.name}, {criterion.meaning}. {smaller}", units)


def _pictures(comparison: Comparison) -> tuple[Illustration, ...]:
    scores, criterion, rows = comparison.scores, comparison.criterion, comparison.standings
    order = [scores.estimators.index(row.estimator) for row in rows]
    best, unit = rows[0].estimator, "frame" if scores.over_frames else "recording"
    dots = paired_figure(
        [row.estimator for row in rows], scores.values[:, order], f"{criterion.name} [{criterion.unit}]"
    )
    quickest = comparison.times[0].estimator
    forests = (
        Forest(
            _lines(rows, lambda end: end),
            f"difference from {short_title(best)} [{criterion.difference_unit}]",
            0.0,
            False,
        ),
        Forest(_lines(comparison.times, exp), f"time per frame, times that of {short_title(quickest)}", 1.0, True),
    )
    return (
        Illustration(
            data_uri(dots),
            f"{criterion.name} of every {unit}",
            f"A dot for each {unit}, grey lines join those of one {unit}, orange bars are means.",
        ),
        Illustration(
            data_uri(forest_figure(forests)),
            f"Differences from {best}, and times compared with {quickest}",
            f"Paired differences from {best}, and times over that of the fastest, {quickest} with "
            f"{digits(comparison.milliseconds(quickest), 2)} ms; 95 % bootstrap intervals, filled where they exclude "
            "the line.",
        ),
    )


def _lines(rows: Sequence[Standing], scale: Callable[[float], float]) -> tuple[ForestLine, ...]:
    """All but the first, which the others are held against."""
    pairs = [row.against_best for row in rows[1:]]
    return tuple(
        ForestLine(
            pair.first,
            scale(pair.difference.value),
            scale(pair.difference.lower),
            scale(pair.difference.upper),
            pair.told_apart,
        )
        for pair in pairs
    )
