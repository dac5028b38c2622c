"""Maps of a panel: colour scales, and a painter of cells."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator
from matplotlib.tri import Triangulation

from lampest.files.errors import InputError
from lampest.panel.panel import Array, Mask, Panel
from lampest.report.plots.style import (
    PLAIN_NUMBER,
    SMALL_POINT,
    TEXT_POINT,
    WIDTH_INCH,
    labelled,
    new_figure,
    round_numbers,
    shared_legend,
    short_title,
    wrapped,
)

# loads are blue: they lower the resistance and raise the pressure
SIGNED = "RdBu_r"
PRESSING = "RdBu"
ACROSS_LABEL = "x [mm]"
DOWN_LABEL = "y [mm]"
NO_NUMBER = "0.88"  # grey
MAX_TICKS_ACROSS = 7  # of a horizontal colour bar
SIGNS_PER_INCH = 12  # of a colour bar's label
TICK_INCH = 0.28  # across of a number below a map, with its gap
MIN_WIDE_INCH = 0.9  # of a map with its title
MAX_ASPECT = 0.75  # largest height of a figure over its width
FACTORS = (1.1, 1.5, 2, 3, 5, 10, 20)  # between bands of large changes


@dataclass(frozen=True, eq=False)
class Scale:
    """Colour scale of maps; values beyond an end have the colour of that end.

    Attributes
    ----------
    norm, colours
        Normalisation and colour map of Matplotlib.
    label : str
        Label of the colour bar, with unit.
    ticks : sequence of float, optional
        Ticks of the bar.
    """

    norm: Normalize
    colours: Colormap
    label: str
    ticks: Sequence[float] | None = None


def log_scale(
    values: Sequence[Array],
    label: str,
    ends: tuple[float, float] = (0.1, 500.0),
    colours: str = "viridis",
) -> Scale:
    """Return a logarithmic scale between round numbers about the 1st and 99th percentile.

    The ends of the scale lie within `ends`.
    """
    numbers = _finite(values)
    numbers = numbers[numbers > 0]
    low, high = np.percentile(numbers, [1, 99]) if numbers.size else (1.0, 10.0)
    steps = round_numbers(*ends)
    first = max((step for step in steps[:-1] if step <= low), default=steps[0])
    last = min((step for step in steps if step >= high and step > first), default=steps[-1])
    return Scale(LogNorm(first, last), colormaps[colours], label, round_numbers(first, last))


def signed_scale(values: Sequence[Array], label: str, least: float, most: float = np.inf) -> Scale:
    """Return a scale symmetric about zero that covers 98 % of the values, from ±least to ±most."""
    reach = np.clip(_reach(values), least, most)
    power = 10.0 ** np.floor(np.log10(reach))
    limit = float(power * np.ceil(reach / power * (1 - 1e-9)))
    return Scale(Normalize(-limit, limit), colormaps[SIGNED], label)


def banded_scale(values: Sequence[Array], label: str) -> Scale:
    """Return a scale of bands of a tenth of its limit, white from −1/10 to +1/10, where noise is.

    The limit is the smallest round number that covers 98 % of all values, 100 at most.
    """
    limit = next((step for step in round_numbers(1, 100) if step >= _reach(values)), 100.0)
    ticks = np.linspace(-limit, limit, 11).tolist()
    steps = np.arange(1, 11) * limit / 10
    return stepped_scale(steps.tolist(), f"{label} (ends at ±{limit:g} %)", ticks)


def change_scale(values: Sequence[Array], label: str) -> Scale:
    """Return bands of relative change in percent that show falls and rises alike.

    Small changes have those of `banded_scale`. From 50 % on, where a fall ends at −100 % and a rise
    does not end, bands are factors: the colour of half the value, −50 %, is as strong as that of
    twice the value, +100 %.
    """
    if _reach(values) <= 50:
        return banded_scale(values, label)
    factors = np.array(FACTORS)
    bounds = np.append(100 / factors[::-1], 100 * factors).round() - 100
    return _with_bounds(bounds, colormaps[SIGNED], label, bounds.tolist())


def stepped_scale(
    steps: Sequence[float], label: str, ticks: Sequence[float], colours: str = SIGNED
) -> Scale:
    """Return a scale of bands between ±steps, white within the first."""
    bounds = np.append(np.negative(steps)[::-1], steps)
    return _with_bounds(bounds, colormaps[colours], label, ticks)


def _with_bounds(bounds: Array, colours: Colormap, label: str, ticks: Sequence[float]) -> Scale:
    """Return a scale of bands between given bounds."""
    return Scale(BoundaryNorm(bounds, colours.N, extend="both"), colours, label, ticks)


def limited(scale: Scale, low: float | None, high: float | None) -> Scale:
    """Return a scale that begins at `low` and ends at `high`; None keeps its own end.

    Raises InputError if the ends are not in order, or not positive on a logarithmic scale.
    """
    if low is None and high is None:
        return scale
    first = float(scale.norm.vmin or 0.0) if low is None else low
    last = float(scale.norm.vmax or 0.0) if high is None else high
    logarithmic = isinstance(scale.norm, LogNorm)
    if not first < last or (logarithmic and first <= 0):
        positive = " and positive" if logarithmic else ""
        raise InputError(f"vmin and vmax must be in order{positive}, not {first:g} and {last:g}")
    label = re.sub(r" \(ends at .*\)", "", scale.label)
    if logarithmic:
        return Scale(LogNorm(first, last), scale.colours, label, round_numbers(first, last))
    if isinstance(scale.norm, BoundaryNorm):
        ticks = np.linspace(first, last, 11)
        # The band about zero.
        white = np.linspace(first, last, 21)[[9, 11]] if first == -last else ticks[5:6]
        bounds = np.sort([*ticks[:5], *white, *ticks[6:]])
        return _with_bounds(bounds, scale.colours, label, ticks.tolist())
    return Scale(Normalize(first, last), scale.colours, label)


def _finite(values: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0), *(part[np.isfinite(part)] for part in values)])


def _reach(values: Sequence[Array]) -> float:
    """Return the 98th percentile of the absolute values."""
    numbers = np.abs(_finite(values))
    return float(np.percentile(numbers, 98)) if numbers.size else 0.0


@dataclass(frozen=True, eq=False)
class Tile:
    """A map.

    Attributes
    ----------
    title, note : str
        First and second line of the title.
    values : array, shape (rows, columns), or None
        NaN is grey; None is drawn as 'not solved'.
    marked, mark
        Cells (rows, columns) with a cross, and its label.
    outlined
        Cells (rows, columns) within a line, the true outline of the load.
    """

    title: str
    values: Array | None
    note: str = ""
    marked: Mask | None = None
    mark: str = "open cell"
    outlined: Mask | None = None


@dataclass(frozen=True, eq=False)
class MapPainter:
    """Painter of maps of a panel on a scale.

    Attributes
    ----------
    panel : Panel
    scale : Scale
    contoured : bool
        Whether interpolated bands are drawn, with dots at the cells, instead of one patch for each
        cell.
    """

    panel: Panel
    scale: Scale
    contoured: bool = False

    def draw(self, axes: Axes, tile: Tile) -> None:
        """Draw a map, rows downwards."""
        self._frame(axes)
        title = "\n".join(filter(None, (tile.title, tile.note)))
        axes.set_title(title, fontsize=SMALL_POINT + 0.5, linespacing=1.3)
        if tile.values is None:
            axes.annotate(
                "not solved",
                (0.5, 0.5),
                xycoords="axes fraction",
                ha="center",
                fontsize=SMALL_POINT,
            )
            return
        if self.contoured and self.panel.cells is None and min(self.panel.shape) > 1:
            # Percentages become factors, so that rises and falls are alike.
            logs = np.log1p(np.maximum(self._cut(tile.values), -99.9) / 100)
            # Bilinear at eight points a cell, constant beyond the outer centres.
            half = self.panel.pitch_mm / 2
            x, y = self.panel.centres_mm()
            fine_x, fine_y = (
                np.linspace(line[0] - half, line[-1] + half, len(line) * 8 + 1) for line in (x, y)
            )
            across = np.array([np.interp(fine_x, x, row) for row in logs])
            fine = np.array([np.interp(fine_y, y, column) for column in across.T]).T
            axes.contourf(fine_x, fine_y, 100 * np.expm1(fine), **self._bands())
        else:
            self._patches(axes, tile.values)
        if self.contoured:
            centres = map(np.ravel, self.panel.places_mm)
            axes.plot(*centres, ".", color="0.35", ms=1, label="cell centre", clip_on=False)
        if tile.outlined is not None and np.any(tile.outlined) and self.panel.cells is None:
            self._outline(axes, tile.outlined)
        if tile.marked is not None and np.any(tile.marked):
            size = float(np.clip(40 / max(self.panel.shape), 0.5, 4))
            (cross,) = axes.plot(
                *self.panel.places_mm[:, tile.marked],
                marker="x",
                label=tile.mark,
                color="black",
                ms=size,
                mew=size / 4,
                ls="none",
                clip_on=False,
            )
            cross.set_path_effects([withStroke(linewidth=size / 2, foreground="white")])

    def _outline(self, axes: Axes, outlined: Mask) -> None:
        """Draw the outline of the true load along the edges of its cells."""
        # Ones and zeros on a grid so fine that the outline has the cells' corners.
        pitch = self.panel.pitch_mm
        fine = np.pad(np.kron(outlined, np.ones((16, 16))), 8)
        grid = (
            np.linspace(line[0] - pitch, line[-1] + pitch, 16 * (len(line) + 1))
            for line in self.panel.centres_mm()
        )
        edges = axes.contour(*grid, fine, levels=[0.5], colors="black", linewidths=1.3)
        edges.set_path_effects([withStroke(linewidth=2.8, foreground="white")])
        axes.plot([], [], color="black", lw=1.3, label="true outline of the load")

    def bar(
        self, figure: Any, axes: Any, location: Literal["right", "bottom"], aspect: float = 28
    ) -> None:
        """Draw the colour bar of some axes of a figure next to them."""
        placed = {}
        if (ticks := self.scale.ticks) is not None:
            # Numbers beside each other need more room than above each other.
            step = ceil(len(ticks) / MAX_TICKS_ACROSS) if location == "bottom" else 1
            placed = {"ticks": FixedLocator(ticks[::step]), "format": PLAIN_NUMBER}
        bar = figure.colorbar(
            ScalarMappable(self.scale.norm, self.scale.colours),
            ax=axes,
            location=location,
            extend="both",
            extendfrac=0.04,
            spacing="uniform",
            aspect=aspect,
            pad=0.02,
            **placed,
        )
        bar.minorticks_off()
        extent = figure.bbox.height if location == "right" else figure.bbox.width
        label = wrapped(self.scale.label, int(SIGNS_PER_INCH * extent / figure.dpi))
        bar.set_label(label, fontsize=TEXT_POINT)
        bar.ax.tick_params(labelsize=SMALL_POINT)

    def _frame(self, axes: Axes) -> None:
        """Set the limits of the axes to the edges of the cells."""
        (left, right), (top, bottom) = self.panel.extents_mm
        full = self.panel.cells is None
        beyond = self.panel.pitch_mm * (0.5 if full else 0.93)  # 1.3/√2: turned
        axes.set_facecolor(NO_NUMBER if full else "white")
        axes.set_aspect("equal")
        axes.set_xlim(left - beyond, right + beyond)
        axes.set_ylim(bottom + beyond, top - beyond)
        axes.tick_params(labelsize=SMALL_POINT)
        axes.locator_params(nbins=5, steps=[1, 2, 5, 10])
        broad = right - left + 2 * beyond
        tall = bottom - top + 2 * beyond
        if broad < tall / 2:
            axes.locator_params(axis="x", nbins=2 if broad < tall / 3 else 3)

    def _patches(self, axes: Axes, values: Array) -> None:
        """Draw squares at the cells, and contours between neighbours.

        Listed cells have a dark outline.
        """
        places = self.panel.places_mm[:, self.panel.present].T
        values = values[self.panel.present]
        # Squares point to the nearest neighbour; their corners (cells, 4, 2) are in millimetre.
        first, second, distance = self.panel.neighbours
        number = np.cumsum(self.panel.present.ravel()) - 1
        cell, neighbour = np.concatenate([number[[first, second]], number[[second, first]]], axis=1)
        nearest_last = np.argsort(np.tile(distance, 2), kind="stable")[::-1]
        way = np.tile([1.0, 0.0], (len(places), 1))
        distance_mm = (np.tile(distance, 2) * self.panel.pitch_mm)[:, None]
        way[cell[nearest_last]] = ((places[neighbour] - places[cell]) / distance_mm)[nearest_last]
        across = np.stack([-way[:, 1], way[:, 0]], axis=1)
        half = self.panel.pitch_mm / 2
        corners = np.stack(
            [
                places + half * (a * way + b * across)
                for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
            ],
            axis=1,
        )
        centres = places[:, None]
        listed = self.panel.cells is not None
        outlines = list(centres + 1.3 * (corners - centres)) if listed else []
        around = PolyCollection(outlines, facecolors="0.25", edgecolors="none", zorder=0.5)
        colours = self.scale.colours.with_extremes(bad=NO_NUMBER)
        patches = PolyCollection(
            list(corners), edgecolor="face", lw=0.2, cmap=colours, norm=self.scale.norm
        )
        patches.set_array(np.ma.masked_invalid(values))
        axes.add_collection(around)
        axes.add_collection(patches)
        flat = np.linalg.matrix_rank(places - places.mean(axis=0)) < 2
        if not (self.contoured and listed) or flat or not np.isfinite(values).all():
            return
        mesh = Triangulation(*places.T)
        sides = places[mesh.triangles] - places[np.roll(mesh.triangles, 1, axis=1)]
        # The diagonal of a square and its rounding; between cells farther apart nothing was
        # measured.
        too_long = np.hypot(*sides.T).T.max(axis=1) > 1.5 * self.panel.pitch_mm
        mesh.set_mask(too_long)
        if not too_long.all():
            axes.tricontourf(mesh, self._cut(values), **self._bands())

    def _bands(self) -> dict[str, Any]:
        """Colours, norm and levels of filled contours between the boundaries of the scale."""
        norm = self.scale.norm
        assert isinstance(norm, BoundaryNorm)
        look = {"cmap": self.scale.colours, "norm": norm, "extend": "both"}
        return look | {"levels": norm.boundaries}

    def _cut(self, values: Array) -> Array:
        """Clip values to just beyond the scale, so that no cell spreads its colour over others."""
        beyond = 1.1 * float(self.scale.norm.vmax or 0.0)
        return np.clip(values, -beyond, beyond)


def values_of(tiles: Sequence[Tile]) -> list[Array]:
    """Return the values of tiles."""
    return [tile.values for tile in tiles if tile.values is not None]


def maps_in_rows(
    count: int, panel: Panel, width: float, *, rows: int | None, own_bars: bool
) -> tuple[int, int, float, float, float]:
    """Arrange equal maps in a figure with about the proportions 3 : 2 and few gaps.

    Parameters
    ----------
    count : int
        Number of maps.
    panel : Panel
    width : float
        Largest width of the figure, inches.
    rows : int or None
        Rows of maps, if their number is given.
    own_bars : bool
        Whether every map has a colour bar.

    Returns
    -------
    across, down : int
        Columns and rows of maps.
    map_width : float
        Width of a map, inches.
    width, height : float
        Size of the figure, inches.
    """
    broad, tall = (most - least + panel.pitch_mm for least, most in panel.extents_mm)
    # Inches for the colour bars, and between maps.
    beside, gap = (0.4, 0.9) if own_bars else (1.0, 0.2)

    def map_width(across: int) -> float:
        return (width - beside) / across - gap

    def height(across: int) -> float:
        return ceil(count / across) * (map_width(across) * tall / broad + 0.4) + 0.8

    def unfit(across: int) -> float:
        # deviation from 3 : 2, with a cost for empty places
        return abs(height(across) - width / 1.5) + 0.3 * (-count % across)

    most = min(count, int((width - 1.0) / 0.88))
    across = min(range(1, most + 1), key=unfit) if rows is None else count // rows
    down = ceil(count / across)
    # The maps of a tall panel get narrower.
    tallest = MAX_ASPECT * width
    beyond = max(height(across) - tallest, 0.0) * broad / tall
    beyond = min(beyond, max(0.0, (map_width(across) - MIN_WIDE_INCH) * down))
    narrowed = map_width(across) - beyond / down
    return across, down, narrowed, width - beyond * across / down, min(height(across), tallest)


def maps_figure(
    tiles: Sequence[Tile],
    panel: Panel,
    scale: Scale | Sequence[Scale],
    title: str = "",
    width: float = WIDTH_INCH,
    *,
    contoured: bool = False,
    about: str = "",
) -> Figure:
    """Draw maps side by side, as `maps_in_rows` places them.

    Parameters
    ----------
    tiles : sequence of Tile
        The maps.
    panel : Panel
    scale : Scale or sequence of Scale
        One for all maps, one for each, or one for each row of maps.
    title : str
    width : float
        Width of the figure in inches.
    contoured : bool
        As in `MapPainter`.
    about : str
        A remark on the maps, behind the label of x.
    """
    scales = [scale] if isinstance(scale, Scale) else scale
    own_bars = len(scales) == len(tiles) > 1
    in_rows = 1 < len(scales) < len(tiles)
    across, down, map_width, wide, tall = maps_in_rows(
        len(tiles), panel, width, rows=len(scales) if in_rows else None, own_bars=own_bars
    )
    figure = new_figure(tall, wide)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for axes in grid.flat[len(tiles) :]:
        axes.set_visible(False)
    signs = max(10, int(17 * map_width))  # that fit over a map
    painters = [MapPainter(panel, level, contoured) for level in scales]
    maps_of_scale = len(tiles) // len(scales)
    for number, (axes, tile) in enumerate(zip(grid.flat, tiles, strict=False)):
        lowest = number + across >= len(tiles)  # ticks where numbers stand beside them
        axes.tick_params(bottom=lowest, labelbottom=lowest, left=number % across == 0)
        name = short_title(tile.title.replace("paper's lambda", "paper's λ"), 60)
        painters[number // maps_of_scale].draw(axes, replace(tile, title=wrapped(name, signs)))
        if map_width < 5 * TICK_INCH:
            axes.locator_params(axis="x", nbins=max(1, int(map_width / TICK_INCH)))
    # The maps beside which a colour bar stands: each, those of a row, or all.
    beside = grid.flat if own_bars else grid if in_rows else [grid]
    for painter, axes in zip(painters, beside, strict=False):
        painter.bar(figure, axes, "right", aspect=tall / 0.16)
    shared_legend(figure, grid, "lower right", least=2 if contoured else 1, ncols=2)
    if len(tiles) == 1:  # the axes of a map that stands alone have labels of their own
        grid[0, 0].set_xlabel(ACROSS_LABEL, fontsize=TEXT_POINT)
        grid[0, 0].set_ylabel(DOWN_LABEL, fontsize=TEXT_POINT)
        return labelled(figure, about, "", title)
    signs = int(16 * wide)  # of the labels' size across the figure
    below = wrapped("; ".join(filter(None, (ACROSS_LABEL, about))), signs)
    title = "\n".join(wrapped(line, signs) for line in title.split("\n"))
    return labelled(figure, below, DOWN_LABEL, title)
