"""The report's figures with their captions: of one recording, and of the comparison over all."""

from collections.abc import Callable, Sequence
from functools import partial
from math import exp
from typing import Literal

import numpy as np

from lampest.panel.panel import Array
from lampest.report.page.compared import Comparison, Standing
from lampest.report.page.measures import Disagreement, weighted_residual
from lampest.report.page.template import Illustration
from lampest.report.plots.contours import ContourPlot
from lampest.report.plots.curves import forest_figure, histogram_figure, paired_figure, profile_figure
from lampest.report.plots.maps import Scale, Tile, maps_figure, percent_scale, resolution_scale, signed_scale
from lampest.report.plots.style import data_uri, short_title
from lampest.report.strongest import percent_change
from lampest.report.words import digits
from lampest.runs.case import CaseResult

UNCERTAIN = "How uncertain each cell is: one posterior standard deviation, logarithmic colours."
RESOLVED = (
    "Diagonal of the averaging kernel: how much of a cell's own change its estimate follows. Where it is 0 the penalty "
    "decides alone."
)
UNEXPLAINED = (
    "What the model leaves unexplained. A pattern means an effect that the model lacks, or too strong a penalty."
)
DISTRIBUTED = (
    "Residuals of all frames. Estimates that follow their noise have narrower ones than the line; wider ones do not "
    "explain the readings. What is beyond the axis stands in the last bins."
)
DIFFERENT = (
    "Where two estimators differ by more than their joint 95 % interval (grey: they do not); in the titles, the share "
    "of cells over all frames. One in twenty is to be expected by chance, or fewer: both rest on the same readings."
)


def contours(cases: Sequence[CaseResult]) -> Illustration:
    """Maps of relative change, over the whole page."""
    words = (
        f"Maps of relative change of {cases[0].recording}: measured, by every estimator, and true where that is known"
    )
    caption = "Relative change of resistance against the unloaded panel."
    return Illustration(data_uri(ContourPlot().draw(cases), "png"), words, caption, True)


def certainty(cases: Sequence[CaseResult], place: int) -> list[Illustration]:
    """Standard deviation, resolution, and a row with its intervals, as far as the results know them."""
    row = _strongest_row(cases[0], place)
    bars = any(case.relative_change_lower is not None for case in cases)
    about = (
        "bars: 95 % intervals, cut where they leave the axes; triangles: beyond them"
        if bars
        else "these results hold no intervals"
    )
    caption = f"The row with the strongest change; {about}. Logarithmic in the ratio of resistances."
    scale = partial(percent_scale, label="posterior standard deviation [% of the cell]")
    known = [case for case in cases if case.cell_resistance_errors is not None]
    deviations = _tiles(known, place, lambda case: 100 * case.column("cell_resistance_errors") / case.cell_resistance)
    resolutions = _tiles(cases, place, lambda case: case.resolution)
    return [
        *_maps(cases, deviations, scale, "the standard deviation", UNCERTAIN),
        *_maps(cases, resolutions, lambda maps: resolution_scale(), "the resolution", RESOLVED),
        Illustration(data_uri(profile_figure(cases, place, row)), f"Relative change along row {row}", caption),
    ]


def misfits(cases: Sequence[CaseResult], place: int) -> list[Illustration]:
    """Maps of one frame and histograms of all, in units of the noise; where that is unknown, maps in percent."""
    residuals = [weighted_residual(case) for case in cases]
    known = [own for own in residuals if own is not None]
    if len(known) < len(cases):
        scale = partial(signed_scale, label="(model − measured)/measured [%]", least=0.1)
        percent = _tiles(
            cases, place, lambda case: np.where(case.valued, percent_change(case.reading_model, case.measured), np.nan)
        )
        return _maps(cases, percent, scale, "the residuals", UNEXPLAINED)
    scale = partial(signed_scale, label="(model − measured)/σ", least=3.0)
    values = [(case.estimator, own[np.isfinite(own)]) for case, own in zip(cases, known, strict=True)]
    return [
        *_maps(cases, _tiles(cases, place, weighted_residual), scale, "the residuals", UNEXPLAINED),
        Illustration(data_uri(histogram_figure(values)), "Histograms of the residuals", DISTRIBUTED),
    ]


def differences(cases: Sequence[CaseResult], place: int, found: Sequence[Disagreement]) -> list[Illustration]:
    """Maps of the pairs that disagree most, those first."""
    shown = found[:9]
    tiles = []
    for pair in shown:
        known = not np.all(np.isnan(pair.difference[place]))
        values = np.where(pair.significant[place], pair.difference[place], np.nan) if known else None
        tiles.append(Tile(f"{pair.first} − {pair.second}", values, f"{digits(pair.share, 2)} %"))
    most = f" The {len(shown)} of {len(found)} pairs that differ most." if len(found) > len(shown) else ""
    scale = partial(signed_scale, label="difference of relative change [percentage points]", least=1.0, most=100.0)
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
    kind: Literal["svg", "png"] = "svg" if panel.crossings * len(tiles) <= 1500 else "png"
    return [Illustration(data_uri(maps_figure(tiles, panel, scale(drawn)), kind), f"Maps of {of_what}", caption)]


def _strongest_row(first: CaseResult, place: int) -> int:
    """The row of the cell that changed most: in truth where it is known, else as measured."""
    change = percent_change(first.measured[place], first.measured_baseline)
    if first.truth is not None and first.truth_baseline is not None:
        change = percent_change(first.truth[place], first.truth_baseline)
    return int(np.argmax(np.where(np.isfinite(change), np.abs(change), 0.0)) // change.shape[1])


def standings(comparison: Comparison) -> list[Illustration]:
    """The criterion of every unit, and differences and times with their intervals."""
    scores, criterion, rows = comparison.scores, comparison.criterion, comparison.standings
    order = [scores.estimators.index(row.estimator) for row in rows]
    best, unit = rows[0].estimator, "frame" if scores.over_frames else "recording"
    label = f"{criterion.name} [{criterion.unit}]"
    dots = paired_figure([row.estimator for row in rows], scores.values[:, order], label)
    quickest = comparison.times[0].estimator
    from_best = f"difference from {short_title(best)} [{criterion.difference_unit}]"
    times = f"time per frame, times that of {short_title(quickest)}"
    forests = ((_lines(rows, float), from_best, 0.0), (_lines(comparison.times, exp), times, 1.0))
    return [
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
    ]


def _lines(rows: Sequence[Standing], scale: Callable[[float], float]) -> list[tuple[str, float, float, float]]:
    """All but the first, which the others are compared with."""
    differences = [(row.estimator, row.against_best.difference) for row in rows[1:]]
    return [(name, scale(one.value), scale(one.lower), scale(one.upper)) for name, one in differences]
