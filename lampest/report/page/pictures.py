"""The report's figures of one recording, with their captions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lampest.report.page.measures import Disagreement, weighted_residual
from lampest.report.plots.contours import CertaintyPlot, ContourPlot
from lampest.report.plots.maps import Scale, Tile, maps_figure, signed_scale, values_of
from lampest.report.plots.plot import Plot
from lampest.report.plots.style import HALF_INCH, data_uri
from lampest.report.strongest import percent_change
from lampest.report.words import digits
from lampest.runs.case import CaseResult

CHANGED = "Relative change of resistance against the unloaded panel."
CERTAIN = (
    "How uncertain each cell is, one posterior standard deviation, in logarithmic colours; and the diagonal of the "
    "averaging kernel: how much of a cell's own change its estimate follows. Where it is 0 the penalty decides alone."
)
UNEXPLAINED = (
    "What the model leaves unexplained. A pattern means an effect that the model lacks, or too strong a penalty."
)
DIFFERENT = (
    "Where two estimators differ by more than their joint 95 % interval (grey: they do not); in the titles, the share "
    "of cells over all frames. One in twenty is to be expected by chance, or fewer: both rest on the same readings."
)


@dataclass(frozen=True)
class Illustration:
    """An image as text, what it shows in words, its caption; wide : over the whole page."""

    uri: str
    alternative: str
    caption: str
    wide: bool = False


def contours(cases: Sequence[CaseResult]) -> Illustration:
    """Maps of relative change."""
    words = f"Maps of relative change of {cases[0].recording}: measured, by every estimator, and true where known"
    return _wide(ContourPlot(), cases, words, CHANGED)


def certainty(cases: Sequence[CaseResult], place: int) -> list[Illustration]:
    """Standard deviation, resolution, and errors where the truth is known; none where no case has error bars."""
    plot = CertaintyPlot(int(cases[0].frame[place]))
    known = plot.drawable(cases)
    return [_wide(plot, known, "Maps of standard deviation and resolution", CERTAIN)] if known else []


def misfits(cases: Sequence[CaseResult], place: int) -> Illustration:
    """Maps of the residuals in units of the noise; in percent where that is unknown of any."""
    residuals = [weighted_residual(case) for case in cases]
    label, least = "(model − measured)/σ", 3.0
    if any(own is None for own in residuals):
        residuals = [np.where(case.valued, percent_change(case.reading_model, case.measured), np.nan) for case in cases]
        label, least = "(model − measured)/measured [%]", 0.1
    pairs = zip(cases, residuals, strict=True)
    tiles = [
        Tile(case.estimator, own[place] if own is not None and case.solved[place] else None) for case, own in pairs
    ]
    return _maps(cases, tiles, signed_scale(values_of(tiles), label, least), "the residuals", UNEXPLAINED)


def differences(cases: Sequence[CaseResult], place: int, found: Sequence[Disagreement]) -> list[Illustration]:
    """Maps of the pairs that disagree most, those first; none of no pairs."""
    tiles = [Tile(pair.title, pair.significant[place], f"{digits(pair.share, 2)} %") for pair in found[:9]]
    most = f" The 9 of {len(found)} pairs that differ most." if len(found) > 9 else ""
    scale = signed_scale(values_of(tiles), "difference of relative change [percentage points]", 1.0, 100.0)
    return [_maps(cases, tiles, scale, "significant differences", DIFFERENT + most)] if tiles else []


def _wide(plot: Plot, cases: Sequence[CaseResult], words: str, caption: str) -> Illustration:
    return Illustration(data_uri(plot.draw(cases), "png"), words, caption, True)


def _maps(cases: Sequence[CaseResult], tiles: list[Tile], scale: Scale, of_what: str, caption: str) -> Illustration:
    """Half as wide. Lines stay sharp at any size; points where cells would make them heavy."""
    panel = cases[0].scene.panel
    kind: Literal["svg", "png"] = "svg" if panel.crossings * len(tiles) <= 1500 else "png"
    figure = maps_figure(tiles, panel, scale, width=HALF_INCH)
    return Illustration(data_uri(figure, kind), f"Maps of {of_what}", caption)
