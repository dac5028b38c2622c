"""Sections of the page: one recording, and the comparison over all, each with tables and captioned figures."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import exp
from typing import Literal

import numpy as np

from lampest.panel.panel import Array
from lampest.report.page.batch import Subject
from lampest.report.page.compared import Comparison, Standing
from lampest.report.page.measures import Disagreement, Measures, disagreements, weighted_residual
from lampest.report.page.tables import failures, pair_sheet, recording_sheet, standing_sheet, unit_sheet
from lampest.report.page.template import Illustration, Sheet, digits
from lampest.report.plots.contours import ContourPlot
from lampest.report.plots.curves import (
    Forest,
    forest_figure,
    histogram_figure,
    paired_figure,
    profile_figure,
)
from lampest.report.plots.maps import Scale, Tile, maps_figure, positive_scale, resolution_scale, signed_scale
from lampest.report.plots.style import data_uri, short_title
from lampest.report.strongest import counted, percent_change, strongest_index
from lampest.runs.case import CaseResult

MOST_UNITS = 200  # whose figures are listed one by one
MOST_PAIRS, MOST_SHARP = 9, 1500  # pairs that are shown, and cells of a picture that is drawn as lines
LEAST_SIGMAS, LEAST_PERCENT = 3.0, 0.1  # that a signed scale reaches
POINTS = (1.0, 100.0)  # that a scale of percentage points reaches, at least and at most

UNCERTAIN = "How uncertain each cell is: one posterior standard deviation, logarithmic colours."
RESOLVED = (
    "Diagonal of the averaging kernel: how much of a cell's own change its estimate follows. Where it is 0 the penalty "
    "decides alone."
)
UNEXPLAINED = (
    "What the model leaves unexplained. A pattern means an effect that the model lacks, or too strong a penalty."
)
WEIGHTED = (
    "Residuals of all frames. Estimates that follow their noise have narrower ones than the line; wider ones do not "
    "explain the readings. What is beyond the axis stands in the last bins."
)
PLAIN = "Residuals of all frames; the noise of the readings is unknown, so there is nothing to hold them against."
DIFFERENT = (
    "Where two estimators differ by more than their joint 95 % interval (grey: they do not); in the titles, the share "
    "of cells over all frames. One in twenty is to be expected by chance, or fewer: both rest on the same readings."
)
UNDECIDED = "Where the estimators differ significantly cannot be told: fewer than two of them have error bars."


@dataclass(frozen=True)
class Section:
    """A recording. anchor : its place on the page. brief, about : a few words on its estimators, and on what it is.

    notes, failed : sentences.
    """

    name: str
    anchor: str
    brief: str
    about: str
    sheet: Sheet
    pictures: tuple[Illustration, ...]
    notes: tuple[str, ...]
    failed: tuple[str, ...]


def section(
    subject: Subject, number: int, found: Mapping[str, Measures], drawn: Collection[str], whole: bool
) -> Section:
    """Table and contours of one recording; every other figure too where it is shown whole.

    found : estimator → its figures. drawn : the estimators that pictures show, of those that the recording has.
    """
    cases = tuple(case for case in subject.cases if case.estimator in drawn) or subject.cases[:1]
    first, place = cases[0], strongest_index(cases)
    panel = first.scene.panel
    about = (
        f"{panel.rows} × {panel.columns} cells, pitch {panel.pitch_mm:g} mm, {counted(subject.frames, 'frame')} in "
        f"{digits(float(np.ptp(first.time)))} s; maps show frame {first.frame[place]} at {first.time[place]:g} s."
    )
    words = f"Maps of relative change of {subject.name}: measured, by every estimator, and true where that is known"
    contours = data_uri(ContourPlot().draw(cases), "png")
    pictures = [Illustration(contours, words, "Relative change of resistance against the unloaded panel.", True)]
    notes = [
        text
        for known, text in (
            (first.model_mark, f"Does the model explain the data? {first.model_mark}: {first.model_sentence}."),
            (first.noise_sentence, f"Is the noise as the scene says? {first.noise_sentence}."),
            (first.film_sentence, f"The film: {first.film_sentence}."),
        )
        if known
    ]
    if whole:
        pairs = disagreements(cases)
        pictures += [*_certainty(cases, place), *_residuals(cases, place), *_differences(cases, place, pairs)]
        notes += [UNDECIDED] if len(cases) > 1 and not pairs else []
    return Section(
        subject.name,
        f"recording-{number}",
        _brief(found),
        about,
        recording_sheet(found),
        tuple(pictures),
        tuple(notes),
        failures(found),
    )


def _brief(found: Mapping[str, Measures]) -> str:
    """The range of the cell errors, and failures."""
    errors = {name: own.cell_error.value for name, own in found.items() if own.cell_error is not None}
    failed = sum(own.frames - own.solved for own in found.values())
    parts = [f"{counted(failed, 'frame')} failed"] if failed else []
    if errors:
        low, high = min(errors, key=lambda name: errors[name]), max(errors, key=lambda name: errors[name])
        parts.insert(0, f"median cell error {digits(errors[low])} % ({low}) to {digits(errors[high])} % ({high})")
    return ", ".join(parts)


def _certainty(cases: Sequence[CaseResult], place: int) -> list[Illustration]:
    """Standard deviation, resolution, and a row with its intervals, as far as the results know them."""
    row = _strongest_row(cases[0], place)
    bars = any(case.relative_change_lower is not None for case in cases)
    about = (
        "bars: 95 % intervals, cut where they leave the axes; triangles: beyond them"
        if bars
        else "these results hold no intervals"
    )
    caption = f"The row with the strongest change; {about}. Logarithmic in the ratio of resistances."
    label = "posterior standard deviation [% of the cell]"
    deviations = _tiles(cases, place, lambda case: _percent(case.cell_resistance_errors, case.cell_resistance))
    resolutions = _tiles(cases, place, lambda case: case.resolution)
    return [
        *_maps(cases, deviations, lambda maps: positive_scale(maps, label), "the standard deviation", UNCERTAIN),
        *_maps(cases, resolutions, lambda maps: resolution_scale(), "the resolution", RESOLVED),
        Illustration(data_uri(profile_figure(cases, place, row)), f"Relative change along row {row}", caption),
    ]


def _residuals(cases: Sequence[CaseResult], place: int) -> list[Illustration]:
    """Maps of one frame and histograms of all, in units of the noise where that is known, else in percent."""
    weighted = all(case.sigma is not None for case in cases)

    def residual(case: CaseResult) -> Array:
        plain = np.where(case.valued, percent_change(case.reading_model, case.measured), np.nan)
        own = weighted_residual(case) if weighted else None
        return plain if own is None else own

    label = "(model − measured)/σ" if weighted else "(model − measured)/measured [%]"
    least = LEAST_SIGMAS if weighted else LEAST_PERCENT
    every = [(case.estimator, residual(case)) for case in cases]
    histograms = histogram_figure([(name, own[np.isfinite(own)]) for name, own in every], weighted)
    tiles = _tiles(cases, place, residual)
    return [
        *_maps(cases, tiles, lambda maps: signed_scale(maps, label, least), "the residuals", UNEXPLAINED),
        Illustration(data_uri(histograms), "Histograms of the residuals", WEIGHTED if weighted else PLAIN),
    ]


def _differences(cases: Sequence[CaseResult], place: int, found: Sequence[Disagreement]) -> list[Illustration]:
    """Maps of the pairs that disagree most, those first."""
    tiles = []
    for pair in found[:MOST_PAIRS]:
        known = not np.all(np.isnan(pair.difference[place]))
        values = np.where(pair.significant[place], pair.difference[place], np.nan) if known else None
        tiles.append(Tile(f"{pair.first} − {pair.second}", values, f"{digits(pair.share, 2)} %"))
    label = "difference of relative change [percentage points]"
    most = f" The {MOST_PAIRS} of {len(found)} pairs that differ most." if len(found) > MOST_PAIRS else ""
    scale = partial(signed_scale, label=label, least=POINTS[0], most=POINTS[1])
    return _maps(cases, tiles, scale, "significant differences", DIFFERENT + most)


def _tiles(cases: Sequence[CaseResult], place: int, values: Callable[[CaseResult], Array | None]) -> list[Tile]:
    """A map of each case that has the values, (frames, rows, columns)."""
    known = [(case, own) for case in cases if (own := values(case)) is not None]
    return [Tile(case.estimator, own[place] if case.solved[place] else None) for case, own in known]


def _maps(
    cases: Sequence[CaseResult],
    tiles: list[Tile],
    scale: Callable[[list[Array]], Scale],
    of_what: str,
    caption: str,
) -> list[Illustration]:
    """One picture, or none of no tiles. Lines stay sharp at any size; points where cells would make them heavy."""
    if not tiles:
        return []
    panel, drawn = cases[0].scene.panel, [tile.values for tile in tiles if tile.values is not None]
    kind: Literal["svg", "png"] = "svg" if panel.crossings * len(tiles) <= MOST_SHARP else "png"
    return [Illustration(data_uri(maps_figure(tiles, panel, scale(drawn)), kind), f"Maps of {of_what}", caption)]


def _percent(errors: Array | None, cells: Array) -> Array | None:
    return None if errors is None else 100 * errors / cells


def _strongest_row(first: CaseResult, place: int) -> int:
    """The row of the cell that changed most: in truth where it is known, else as measured."""
    if first.truth is not None and first.truth_baseline is not None:
        change = percent_change(first.truth[place], first.truth_baseline)
    else:
        change = percent_change(first.measured[place], first.measured_baseline)
    return int(np.argmax(np.where(np.isfinite(change), np.abs(change), 0.0)) // change.shape[1])


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


def _lines(rows: Sequence[Standing], scale: Callable[[float], float]) -> list[tuple[str, float, float, float]]:
    """All but the first, which the others are compared with."""
    differences = [(row.estimator, row.against_best.difference) for row in rows[1:]]
    return [(name, scale(one.value), scale(one.lower), scale(one.upper)) for name, one in differences]
