"""Maps of one frame side by side: relative change, certainty, or resistance, by every estimator."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from textwrap import fill
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lampest.panel.panel import Array, Panel
from lampest.report.plots.maps import (
    ACROSS_LABEL,
    DOWN_LABEL,
    MapPainter,
    Scale,
    Tile,
    banded_scale,
    percent_scale,
    proportion,
    resistance_scale,
    resolution_scale,
    signed_scale,
)
from lampest.report.plots.plot import Plot, frame_title, shown_index
from lampest.report.plots.style import (
    SMALL_POINT,
    TALLEST_INCH,
    WIDTH_INCH,
    change_text,
    labelled,
    new_figure,
    shared_legend,
    short_title,
)
from lampest.report.strongest import percent_change
from lampest.runs.case import CaseResult

MOST_ACROSS = 7  # maps side by side, an inch wide each


@dataclass(frozen=True)
class ContourPlot(Plot):
    """Maps of one frame side by side: measured readings, each estimator's cell resistance, the truth.

    All show the change against the unloaded panel in percent on one scale that is symmetric about zero. Source: paper,
    figure 8.

    >>> lampest.ContourPlot(frame=2).kind
    'contours'
    """

    kind: ClassVar[str] = "contours"

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture of all estimators. Raises InputError where the frame has no results."""
        index, panel = shown_index(cases, self.frame), cases[0].scene.panel
        tiles = _tiles(cases, index)
        shown = [tile.values for tile in tiles if tile.values is not None]
        painter = MapPainter(panel, banded_scale(shown, "relative change of resistance [%]"), contoured=True)
        across = _maps_across(len(tiles), panel)
        down = ceil(len(tiles) / across)
        figure = new_figure(min(_height(across, down, panel), TALLEST_INCH))
        grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
        painter.draw_all(grid, [_lettered(number, tile, across) for number, tile in enumerate(tiles)])
        painter.bar(figure, grid, "right", aspect=figure.get_figheight() / 0.16)
        shared_legend(figure, grid, "lower right", least=2, ncols=2)
        title = f"{cases[0].recording}: {frame_title(cases[0], index, self.frame)}"
        return labelled(figure, f"{ACROSS_LABEL}; bands interpolate between the cells (dots)", DOWN_LABEL, title)


def _tiles(cases: Sequence[CaseResult], index: int) -> list[Tile]:
    first = cases[0]
    kind = "measured two-point" if first.scene.circuit.unit == "ohm" else "measured voltage"
    tiles = [_tile(kind, percent_change(first.measured[index], first.measured_baseline))]
    for case in cases:
        shown = _tile(case.estimator, case.relative_change[index], case.open_cell[index] != 0)
        tiles.append(shown if case.solved[index] else Tile(case.estimator, None))
    if first.truth is not None and first.truth_baseline is not None:
        tiles.append(_tile("truth", percent_change(first.truth[index], first.truth_baseline)))
    return tiles


def _tile(title: str, change: Array, open_cells: NDArray[np.bool_] | None = None) -> Tile:
    """With the range of the values below its title."""
    known = change[np.isfinite(change)]
    if not known.size:
        return Tile(title, change, "no number")
    low, high = (change_text(float(value), 10.0) for value in (known.min(), known.max()))
    return Tile(title, change, f"{low} … {high} %", open_cells)


def _lettered(number: int, tile: Tile, across: int) -> Tile:
    """With a letter before its title, and that as wide as the map."""
    letter = f"({chr(ord('a') + number)}) " if number < 26 else ""
    title = tile.title.replace("paper's lambda", "paper's λ")
    return replace(tile, title=fill(letter + title, max(10, int(17 * _width(across)))))


def _maps_across(maps: int, panel: Panel) -> int:
    """How many maps stand side by side, so that the figure comes close to three by two with few gaps."""

    def misfit(across: int) -> float:
        down = ceil(maps / across)
        return abs(_height(across, down, panel) - WIDTH_INCH / 1.5) + 0.3 * (across * down - maps)

    return min(range(1, min(maps, MOST_ACROSS) + 1), key=misfit)


def _height(across: int, down: int, panel: Panel) -> float:
    """Inches that `down` maps of the panel's proportions, edge to edge of their centres, and their titles need."""
    wide, tall = (max(most - least, panel.pitch_mm) for least, most in panel.extents_mm)
    return down * (_width(across) * tall / wide + 0.4) + 0.8


def _width(across: int) -> float:
    """Inches of one map."""
    return (WIDTH_INCH - 1.0) / across - 0.2


@dataclass(frozen=True)
class CertaintyPlot(Plot):
    """One frame, one column for each of the first seven estimators with error bars, three rows of maps:

    standard deviation of the cells [%], resolution, and, where the truth is known, the error in units of the
    standard deviation.

    >>> lampest.CertaintyPlot().needs
    ('cell_resistance_errors', 'resolution')
    """

    kind: ClassVar[str] = "certainty"
    needs: ClassVar[tuple[str, ...]] = ("cell_resistance_errors", "resolution")

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture of all estimators. Raises InputError where the frame has no results."""
        cases = cases[:MOST_ACROSS]
        index, first = shown_index(cases, self.frame), cases[0]
        rows = _rows(cases, index)
        width = (WIDTH_INCH - 1.2) / max(len(cases), 3)
        tall = width * proportion(first.scene.panel)
        figure = new_figure(min(len(rows) * (tall + 0.25) + 0.8, TALLEST_INCH))
        grid = figure.subplots(len(rows), len(cases), squeeze=False, sharex=True, sharey=True)
        for number, (scale, maps) in enumerate(rows):
            painter = MapPainter(first.scene.panel, scale, point=SMALL_POINT + 0.5)
            for axes, case, values in zip(grid[number], cases, maps, strict=True):
                painter.draw(axes, Tile("" if number else short_title(case.estimator), values))
            painter.bar(figure, grid[number], "right")
        at = f"frame {first.frame[index]} at {first.time[index]:g} s"
        title = f"{first.recording}: {at}, 95 % intervals reach 1.96 sd"
        return labelled(figure, f"{ACROSS_LABEL}; grey: no number (failed frame or open cell)", DOWN_LABEL, title)


def _rows(cases: Sequence[CaseResult], index: int) -> list[tuple[Scale, list[Array]]]:
    """Scale and maps of every row of the picture."""
    known = [(case.cell_resistance[index], case.cell_resistance_errors, case.resolution) for case in cases]
    deviations = [_finite(100 * errors[index] / cells) for cells, errors, _ in known if errors is not None]
    resolutions = [resolution[index] for *_, resolution in known if resolution is not None]
    rows = [
        (percent_scale(deviations, "standard deviation [%]"), deviations),
        (resolution_scale(), resolutions),
    ]
    if cases[0].truth is not None:
        truth, pairs = cases[0].truth[index], zip(known, deviations, strict=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            errors = [_finite(np.log(cells / truth) / (deviation / 100)) for (cells, *_), deviation in pairs]
        rows.append((signed_scale(errors, "error / standard deviation", least=3.0, most=5.0), errors))
    return rows


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


@dataclass(frozen=True)
class ResistancePlot(Plot):
    """Maps of one frame: what was measured, the first six estimators' cells, the truth; r in ohm, dark where low.

    For recordings without unloaded frames.
    """

    kind: ClassVar[str] = "resistance"

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture. Raises InputError where the frame has no results."""
        index, first = shown_index(cases, self.frame), cases[0]
        panel = first.scene.panel
        tiles = [Tile("measured", first.measured[index])]
        for case in cases[:6]:
            cells = case.cell_resistance[index] if case.solved[index] else None
            tiles.append(Tile(short_title(case.estimator), cells))
        if first.truth is not None:
            tiles.append(Tile("truth", first.truth[index]))
        scale = resistance_scale([tile.values for tile in tiles if tile.values is not None], "resistance [ohm]")
        painter = MapPainter(panel, scale)
        tall = proportion(panel)
        width = min((WIDTH_INCH - 1.2) / len(tiles), (TALLEST_INCH - 1.2) / tall)
        figure = new_figure(width * tall + 1.2)
        grid = figure.subplots(1, len(tiles), squeeze=False, sharex=True, sharey=True)
        painter.draw_all(grid, tiles)
        painter.bar(figure, grid, "right")
        title = f"{first.recording}: {frame_title(first, index, self.frame)}"
        return labelled(figure, ACROSS_LABEL, DOWN_LABEL, title)
