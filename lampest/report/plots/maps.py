"""Maps of a panel: colour scales, and the one painter of cells in millimetre, with crosses and grey for no number."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FuncFormatter
from numpy.typing import NDArray

from lampest.panel.panel import Array, Panel
from lampest.report.plots.places import draw_patches
from lampest.report.plots.style import HALF_INCH, SMALL_POINT, TEXT_POINT, half_figure, plain_number, short_title

SIGNED, PRESSING = "RdBu_r", "RdBu"  # what presses is blue: it lowers resistance and raises pressure
STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)  # round ends of scales
Extend = Literal["both", "min", "max", "neither"]
ACROSS_LABEL, DOWN_LABEL = "x [mm]", "y [mm]"
NO_NUMBER = "0.88"  # grey
REFINEMENT = 8  # points of the interpolation to a cell
ACROSS = 3  # maps side by side, half a page wide


@dataclass(frozen=True, eq=False)
class Scale:
    """Colours of a set of maps.

    label : what they mean, with its unit. extend : which ends values go beyond. ticks : of the bar, None for usual
    ones. proportional : whether the bands of the bar are as wide as the values they stand for.
    """

    norm: Normalize
    colours: Colormap
    label: str
    extend: Extend = "neither"
    ticks: tuple[float, ...] | None = None
    proportional: bool = False


def positive_scale(values: Sequence[Array], label: str) -> Scale:
    """A logarithmic scale of round numbers that holds nearly all of the positive values."""
    numbers = _finite(values)
    numbers = numbers[numbers > 0]
    low, high = np.percentile(numbers, [1, 99]) if numbers.size else (1.0, 10.0)
    first = max((tick for tick in STEPS if tick <= low), default=STEPS[0])
    last = min((tick for tick in STEPS if tick >= high and tick > first), default=STEPS[-1])
    ends = (bool(np.any(numbers < first)), bool(np.any([np.any(part > last) for part in values])))
    ticks = tuple(tick for tick in STEPS if first <= tick <= last)
    return Scale(LogNorm(first, last), colormaps["viridis"], label, _extend(*ends), ticks)


def signed_scale(values: Sequence[Array], label: str, least: float, most: float = np.inf) -> Scale:
    """A scale symmetric about zero that holds 98 % of the values, ±least at least and ±most at most."""
    numbers = np.abs(_finite(values))
    reach = min(max(least, float(np.percentile(numbers, 98)) if numbers.size else 0.0), most)
    power = 10.0 ** np.floor(np.log10(reach))
    limit = float(next(step for step in (1, 2, 3, 5, 10) if step * power >= reach * (1 - 1e-9)) * power)
    return Scale(Normalize(-limit, limit), colormaps[SIGNED], label, _beyond(values, limit))


def resolution_scale() -> Scale:
    """Of resolutions, from 0 to 1."""
    return Scale(Normalize(0, 1), colormaps["YlGnBu"], "resolution")


def banded_scale(values: Sequence[Array], label: str) -> Scale:
    """Bands of a tenth of the limit, the middle one from −1/10 to +1/10 so that noise about zero stays white.

    The limit is the smallest round number that holds 98 % of all values, 100 at most; arrows stand for the rest.
    """
    numbers = np.abs(_finite(values))
    reach = np.percentile(numbers, 98) if numbers.size else 0.0
    limit = next((step for step in STEPS if 1 <= step <= 100 and step >= reach), 100)
    tenths = np.arange(1, 11) * limit / 10
    bands = colormaps[SIGNED](np.linspace(0.04, 0.96, 19))
    colours = ListedColormap(bands).with_extremes(under=colormaps[SIGNED](0.0), over=colormaps[SIGNED](1.0))
    norm = BoundaryNorm(np.concatenate([-tenths[::-1], tenths]), len(bands))
    ticks = tuple(np.linspace(-limit, limit, 11).tolist())
    return Scale(norm, colours, f"{label} (ends at ±{limit:g} %)", _beyond(values, limit), ticks, proportional=True)


def stepped_scale(steps: Sequence[float], label: str, ticks: Sequence[float], colours: str = SIGNED) -> Scale:
    """Bands between ±steps, white within the first; the same whatever is shown."""
    bounds = np.concatenate([np.negative(steps)[::-1], steps])
    norm = BoundaryNorm(bounds, colormaps[colours].N, extend="both")
    return Scale(norm, colormaps[colours], label, "both", tuple(ticks))


def _finite(values: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0), *(part[np.isfinite(part)] for part in values)])


def _beyond(values: Sequence[Array], limit: float) -> Extend:
    return _extend(*(bool(np.any([np.any(sign * part > limit) for part in values])) for sign in (-1, 1)))


def _extend(below: bool, above: bool) -> Extend:
    return ("both" if above else "min") if below else ("max" if above else "neither")


@dataclass(frozen=True, eq=False)
class Tile:
    """One map: values (rows, columns); NaN is left grey, None says 'not solved'.

    note : second line of the title. marked : (rows, columns) cells with a cross, which stands for `mark`.
    """

    title: str
    values: Array | None
    note: str = ""
    marked: NDArray[np.bool_] | None = None
    mark: str = "open cell"


@dataclass(frozen=True, eq=False)
class MapPainter:
    """Draws maps of one panel on one scale.

    contoured : bands of a banded scale over interpolated values, with dots at the cells; else one square for a cell,
    for values that are not to be drawn as if they were known in between. point : size of titles.
    """

    panel: Panel
    scale: Scale
    contoured: bool = False
    point: float = TEXT_POINT

    def draw(self, axes: Axes, tile: Tile) -> None:
        """One map, rows downwards."""
        self._frame(axes)
        axes.set_title("\n".join(filter(None, (tile.title, tile.note))), fontsize=self.point, linespacing=1.3)
        if tile.values is None:
            axes.text(0.5, 0.5, "not solved", transform=axes.transAxes, ha="center", va="center", fontsize=self.point)
            return
        bands = self.contoured and min(self.panel.shape) > 1  # there is something between cells, both ways
        if self.panel.cells is not None:
            draw_patches(axes, self.panel, tile.values, self.scale.norm, self.scale.colours, bands)
        else:
            (self._bands if bands else self._squares)(axes, tile.values)
        columns, rows = self.panel.places_mm
        if self.contoured:
            axes.plot(columns.ravel(), rows.ravel(), ".", color="0.35", ms=1, label="cell centre", clip_on=False)
        if tile.marked is not None and np.any(tile.marked):
            size = float(np.clip(40 / max(self.panel.shape), 0.5, 4))
            look: dict[str, Any] = {"color": "black", "ms": size, "mew": size / 4, "ls": "none", "clip_on": False}
            (cross,) = axes.plot(columns[tile.marked], rows[tile.marked], marker="x", label=tile.mark, **look)
            cross.set_path_effects([withStroke(linewidth=size / 2, foreground="white")])

    def draw_all(self, grid: Any, tiles: Sequence[Tile]) -> None:
        """Maps row by row into a grid of axes, numbers of columns below the lowest; what is left over is hidden."""
        across = grid.shape[1]
        for number, axes in enumerate(grid.flat):
            if number < len(tiles):
                self.draw(axes, tiles[number])
                axes.tick_params(labelbottom=number + across >= len(tiles))
            else:
                axes.set_visible(False)

    def bar(self, figure: Any, axes: Any, location: Literal["right", "bottom"], aspect: float = 28) -> None:
        """The bar beside some axes of a figure, with what the colours mean."""
        ticks = self.scale.ticks
        bar = figure.colorbar(
            ScalarMappable(self.scale.norm, self.scale.colours),
            ax=axes,
            location=location,
            extend=self.scale.extend,
            extendfrac=0.04,
            spacing="proportional" if self.scale.proportional else "uniform",
            ticks=None if ticks is None else FixedLocator(ticks),
            aspect=aspect,
            pad=0.02,
        )
        if ticks is not None:
            axis = bar.ax.yaxis if location == "right" else bar.ax.xaxis
            axis.set_major_formatter(FuncFormatter(plain_number))
        bar.minorticks_off()
        bar.set_label(self.scale.label, fontsize=TEXT_POINT)
        bar.ax.tick_params(labelsize=SMALL_POINT)

    def _frame(self, axes: Axes) -> None:
        """The panel's extent, to the cells' edges."""
        places = self.panel.places_mm
        (left, top), (right, bottom) = np.nanmin(places, axis=(1, 2)), np.nanmax(places, axis=(1, 2))
        beyond = self.panel.pitch_mm / 2
        axes.set_facecolor(NO_NUMBER if self.panel.cells is None else "white")
        axes.set_aspect("equal")
        axes.set_xlim(left - beyond, right + beyond)
        axes.set_ylim(bottom + beyond, top - beyond)
        axes.tick_params(labelsize=SMALL_POINT)
        axes.locator_params(nbins=5, steps=[1, 2, 5, 10])

    def _bands(self, axes: Axes, values: Array) -> None:
        assert isinstance(self.scale.norm, BoundaryNorm)
        bounds = self.scale.norm.boundaries
        # A cell far beyond the scale must not spread its colour over its neighbours: it is drawn as just beyond.
        beyond = 1.1 * bounds[-1]
        look: dict[str, Any] = {"cmap": self.scale.colours, "norm": self.scale.norm, "extend": self.scale.extend}
        axes.contourf(*_refined(self.panel, np.clip(values, -beyond, beyond)), bounds, **look)

    def _squares(self, axes: Axes, values: Array) -> None:
        half = self.panel.pitch_mm / 2
        edges = (np.append(centres - half, centres[-1] + half) for centres in self.panel.centres_mm())
        colours = self.scale.colours.with_extremes(bad=NO_NUMBER)
        look: dict[str, Any] = {"cmap": colours, "norm": self.scale.norm, "edgecolor": "face", "lw": 0.2}
        axes.pcolormesh(*edges, np.ma.masked_invalid(values), **look)


def _refined(panel: Panel, values: Array) -> tuple[Array, Array, Array]:
    """Bilinear interpolation on a finer grid, constant beyond the outer centres: no corners between cells."""
    x, y = panel.centres_mm()
    half = panel.pitch_mm / 2
    fine = [np.linspace(own[0] - half, own[-1] + half, len(own) * REFINEMENT + 1) for own in (x, y)]
    across = np.array([np.interp(fine[0], x, row) for row in values])
    return fine[0], fine[1], np.array([np.interp(fine[1], y, column) for column in across.T]).T


def maps_figure(tiles: Sequence[Tile], panel: Panel, scale: Scale) -> Figure:
    """Maps cell by cell, three abreast, on one scale; half a page wide."""
    across = min(ACROSS, len(tiles))
    down = ceil(len(tiles) / across)
    tall = ((HALF_INCH - 0.45) / across - 0.12) * panel.rows / panel.columns
    figure = half_figure(max(1.4, min(down * (tall + 0.36) + 0.85, 7.0)))
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    painter = MapPainter(panel, scale, point=SMALL_POINT + 0.5)
    painter.draw_all(grid, [replace(tile, title=short_title(tile.title)) for tile in tiles])
    for number, axes in enumerate(grid.flat[: len(tiles)]):
        if number + across >= len(tiles):
            axes.set_xlabel(ACROSS_LABEL, fontsize=SMALL_POINT, labelpad=1)
        if number % across == 0:
            axes.set_ylabel(DOWN_LABEL, fontsize=SMALL_POINT, labelpad=1)
    painter.bar(figure, grid, "bottom", aspect=45)
    return figure
