"""The paper's figures, drawn anew: published numbers as marks or in words beside what our scenes give."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lampest.loads.response import ratio_from_pressure, relative_change_from_pressure
from lampest.panel.film import Film
from lampest.panel.panel import Array, Panel
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, MapPainter, Tile, banded_scale
from lampest.report.plots.style import BLUE, ORANGE, SMALL_POINT, TEXT_POINT, change_text, new_figure
from lampest.studies.paper.sides import MEASURED, Published, Side

CHANGE = "relative change of resistance [%]"
COLOURS = ("#222222", "#0072B2", "#E69F00", "#009E73")


def response_figure(published: Published) -> Figure:
    """Figure 1-e with its inset: the curve that lampest uses through the published numbers."""
    figure = new_figure(3.2)
    axes = figure.subplots()
    pressures = np.linspace(-10.0, 235.0, 981)
    axes.plot(pressures, 100 * relative_change_from_pressure(pressures), color=BLUE, lw=1.2, label="lampest")
    points = [(point.kpa, point.percent) for point in published.changes]
    axes.plot(*zip(*points, strict=True), "o", color=ORANGE, ms=4.5, label="published")
    _dressed(axes, "pressure [kPa]", "relative change of resistance ΔR/R₀ [%]")
    axes.legend(fontsize=SMALL_POINT, frameon=False, loc="upper left", bbox_to_anchor=(0.12, 1.0))
    inset = axes.inset_axes((0.42, 0.38, 0.55, 0.52))
    fine = np.linspace(0, 60, 601)
    slope = np.gradient(relative_change_from_pressure(fine), fine)
    inset.plot(fine, slope, color=BLUE, lw=1.1)
    for part in published.slopes:
        inset.plot(
            [part.from_kpa, part.to_kpa], [part.per_kpa] * 2, color=ORANGE, lw=3, alpha=0.6, solid_capstyle="butt"
        )
    _dressed(inset, "pressure [kPa]", "sensitivity S [1/kPa]")
    return figure


def bending_figure(published: Published) -> Figure:
    """Figure 2-a and 2-d: unloaded resistance over curvature, and the answer of bent cells up to 40 kPa."""
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)
    curvature = np.linspace(0, published.bent_cells[-1].curvature_per_m, 120)
    unloaded = published.bent_cells[0].ohm * np.array([Film(curvature_per_m=float(one)).lowering for one in curvature])
    left.plot(curvature, unloaded, color=BLUE, lw=1.2, label="lampest")
    points = [(cell.curvature_per_m, cell.ohm) for cell in published.bent_cells]
    left.plot(*zip(*points, strict=True), "o", color=ORANGE, ms=4.5, label="published")
    left.set_yscale("log")
    left.set_yticks([300, 500, 1000, 2000, 3000], ["300", "500", "1000", "2000", "3000"])
    left.minorticks_off()
    left.legend(fontsize=SMALL_POINT, frameon=False)
    _dressed(left, "curvature [1/m]", "unloaded resistance R₀ [ohm]")
    pressures = np.linspace(0.0, 40.0, 161)
    for cell, colour in zip(published.bent_cells, COLOURS, strict=True):
        answer = Film(curvature_per_m=cell.curvature_per_m).answer
        change = 100 * (ratio_from_pressure(pressures) ** answer - 1)
        name = "flat" if cell.radius_mm is None else f"radius {cell.radius_mm:g} mm"
        right.plot(pressures, change, color=colour, lw=1.1, label=name)
        right.plot(40, cell.percent, "o", color=colour, ms=4.5, clip_on=False)
    right.legend(fontsize=SMALL_POINT, frameon=False, title="dots: published", title_fontsize=SMALL_POINT)
    _dressed(right, "pressure [kPa]", CHANGE)
    return figure


def loads_figure(side: Side, published: Published) -> Figure:
    """Figure 6: what was measured of six loads, in the frame in which the film feels what is named."""
    tiles = []
    for load in published.loads:
        seen = side.loads[load.letter]
        note = f"measured {_span(seen.change)}\nfilm feels {_plain(seen.felt[0])} … {_plain(seen.felt[1])} kPa"
        tiles.append(Tile(f"({load.letter}) {_wrapped(load.condition)}", seen.change, note))
    return maps_figure_of(tiles, side.panel, side.name)


def methods_figure(side: Side, published: Published) -> Figure:
    """Figure 8: six maps of one frame; the published range stands below ours."""
    tiles = []
    for one in published.ranges:
        change = side.change(one.method)
        note = f"ours {_span(change)}\npaper {_plain(one.low)} … {_plain(one.high)} %"
        tiles.append(
            Tile(f"({one.letter}) {'measured two-point' if one.method == MEASURED else one.method}", change, note)
        )
    return maps_figure_of(tiles, side.panel, side.name)


def mouths_figure(side: Side, published: Published) -> Figure:
    """Figure 9: a large and a small mouth by one method."""
    tiles = []
    for number, mouth in enumerate(published.mouths):
        change = side.change(published.mouth_method, number)
        rows, columns = covered(change)
        note = f"ours {rows} × {columns} cells, paper {mouth.cells} × {mouth.cells}"
        tiles.append(
            Tile(f"({mouth.letter}) mouth of {mouth.diameter_mm:g} mm, {published.mouth_method}", change, note)
        )
    return maps_figure_of(tiles, side.panel, side.name, 2)


def covered(change: Array) -> tuple[int, int]:
    """Rows and columns that hold a cell which fell by more than half as much as the one that fell most."""
    fallen = change < 0.5 * np.nanmin(change)
    return int(np.sum(fallen.any(axis=1))), int(np.sum(fallen.any(axis=0)))


def maps_figure_of(tiles: Sequence[Tile], panel: Panel, title: str, across: int = 3) -> Figure:
    """Contoured maps on one scale of ±100 %."""
    down = -(-len(tiles) // across)
    figure = new_figure(down * (5.9 / across * panel.rows / panel.columns + 0.62) + 0.6)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    painter = MapPainter(panel, banded_scale([np.array([-100.0, 100.0, *_beyond(tiles)])], CHANGE), contoured=True)
    painter.draw_all(grid, tiles)
    painter.bar(figure, grid, "right", aspect=figure.get_figheight() / 0.16)
    figure.supxlabel(ACROSS_LABEL, fontsize=TEXT_POINT)
    figure.supylabel(DOWN_LABEL, fontsize=TEXT_POINT)
    figure.suptitle(title, fontsize=TEXT_POINT + 1)
    return figure


def _beyond(tiles: Sequence[Tile]) -> tuple[float, ...]:
    """The largest value where one leaves the scale, so that its bar has an arrow."""
    largest = max((float(np.nanmax(tile.values)) for tile in tiles if tile.values is not None), default=0.0)
    return (largest,) if largest > 100 else ()


def _dressed(axes: Axes, across: str, down: str) -> None:
    look: dict[str, Any] = {"fontsize": TEXT_POINT}
    axes.set_xlabel(across, **look)
    axes.set_ylabel(down, **look)
    axes.tick_params(labelsize=SMALL_POINT)
    axes.grid(True, color="0.92", lw=0.5)
    axes.set_axisbelow(True)


def _span(change: Array) -> str:
    return f"{_plain(float(np.nanmin(change)))} … {_plain(float(np.nanmax(change)))} %"


def _plain(value: float) -> str:
    return change_text(value, 100.0)


def _wrapped(text: str) -> str:
    """In two lines where it is long."""
    middle = text.find(" ", len(text) // 2)
    return text if len(text) < 24 or middle < 0 else f"{text[:middle]}\n{text[middle + 1 :]}"
