"""The report's maps, half a page wide so that they are read on a phone too, and what its figures share."""

from base64 import b64encode
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from math import ceil
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter

from lampest.panel.panel import Array, Panel
from lampest.report.plots.contours import DOTS_PER_INCH, SMALL_POINT, TEXT_POINT

HALF_INCH = 3.6
ACROSS, LONGEST_TITLE = 3, 22
BLUE, ORANGE = "#0072B2", "#D55E00"
STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)
Extend = Literal["both", "min", "max", "neither"]


@dataclass(frozen=True, eq=False)
class Scale:
    """Colours of a set of maps; label : what they mean, with its unit. ticks : of the bar, None for usual ones."""

    norm: Normalize
    colours: str
    label: str
    extend: Extend = "neither"
    ticks: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class Tile:
    """One map: (rows, columns); NaN is left grey, None says 'not solved'. note : second line of the title."""

    title: str
    values: Array | None
    note: str = ""


@contextmanager
def verbatim() -> Iterator[None]:
    """What figures made herein say is no formula, whatever signs a name holds."""
    with rc_context({"text.parse_math": False}):
        yield


def data_uri(figure: Figure, kind: Literal["png", "svg"] = "svg") -> str:
    """The figure as the address of an image that holds it; the same figure gives the same text."""
    stream = BytesIO()
    metadata: dict[str, Any] = {"Software": None} if kind == "png" else {"Date": None, "Creator": None}
    with rc_context({"svg.hashsalt": "lampest", "svg.fonttype": "path"}):
        figure.savefig(stream, format=kind, dpi=DOTS_PER_INCH, metadata=metadata)
    form = "image/png" if kind == "png" else "image/svg+xml"
    return f"data:{form};base64,{b64encode(stream.getvalue()).decode('ascii')}"


def positive_scale(values: Sequence[Array], label: str) -> Scale:
    """A logarithmic scale of round numbers that holds nearly all of the positive values."""
    known = np.concatenate([part[np.isfinite(part) & (part > 0)] for part in values] or [np.array([1.0])])
    low, high = np.percentile(known, [1, 99]) if known.size else (1.0, 10.0)
    first = max((tick for tick in STEPS if tick <= low), default=STEPS[0])
    last = min((tick for tick in STEPS if tick >= high and tick > first), default=STEPS[-1])
    ends = (bool(np.any(known < first)), bool(np.any([np.any(part > last) for part in values])))
    ticks = tuple(tick for tick in STEPS if first <= tick <= last)
    return Scale(LogNorm(first, last), "viridis", label, _extend(*ends), ticks)


def signed_scale(values: Sequence[Array], label: str, least: float, most: float = np.inf) -> Scale:
    """A scale symmetric about zero that holds 98 % of the values, ±least at least and ±most at most."""
    known = np.abs(np.concatenate([part[np.isfinite(part)] for part in values] or [np.zeros(1)]))
    reach = min(max(least, float(np.percentile(known, 98)) if known.size else 0.0), most)
    power = 10.0 ** np.floor(np.log10(reach))
    limit = float(next(step for step in (1, 2, 3, 5, 10) if step * power >= reach * (1 - 1e-9)) * power)
    beyond = (
        bool(np.any([np.any(part < -limit) for part in values])),
        bool(np.any([np.any(part > limit) for part in values])),
    )
    return Scale(Normalize(-limit, limit), "RdBu_r", label, _extend(*beyond))


def share_scale(label: str) -> Scale:
    """From 0 to 1."""
    return Scale(Normalize(0, 1), "YlGnBu", label)


def _extend(below: bool, above: bool) -> Extend:
    return ("both" if above else "min") if below else ("max" if above else "neither")


def maps_figure(tiles: Sequence[Tile], panel: Panel, scale: Scale) -> Figure:
    """Maps cell by cell, three abreast, on one scale."""
    across = min(ACROSS, len(tiles))
    down = ceil(len(tiles) / across)
    width = (HALF_INCH - 0.45) / across
    tall = (width - 0.12) * panel.rows / panel.columns
    figure = half_figure(max(1.4, min(down * (tall + 0.36) + 0.85, 7.0)))
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for number, axes in enumerate(grid.flat):
        if number >= len(tiles):
            axes.set_visible(False)
            continue
        draw_map(axes, tiles[number], panel, scale)
        lowest = number + across >= len(tiles)
        axes.tick_params(labelbottom=lowest)
        if lowest:
            axes.set_xlabel("columns [mm]", fontsize=SMALL_POINT, labelpad=1)
        if number % across == 0:
            axes.set_ylabel("rows [mm]", fontsize=SMALL_POINT, labelpad=1)
    bar = figure.colorbar(
        ScalarMappable(scale.norm, scale.colours),
        ax=grid,
        location="bottom",
        extend=scale.extend,
        aspect=45,
        pad=0.02,
        ticks=None if scale.ticks is None else FixedLocator(scale.ticks),
    )
    if scale.ticks is not None:
        bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.minorticks_off()
    bar.set_label(scale.label, fontsize=TEXT_POINT)
    bar.ax.tick_params(labelsize=SMALL_POINT)
    return figure


def draw_map(axes: Axes, tile: Tile, panel: Panel, scale: Scale) -> None:
    """One map, cell by cell, rows downwards, in millimetre."""
    x, y = panel.centres_mm()
    half = panel.pitch_mm / 2
    axes.set_title(short_title(tile.title) + (f"\n{tile.note}" if tile.note else ""), fontsize=SMALL_POINT + 0.5)
    axes.set_facecolor("0.88")
    axes.set_aspect("equal")
    axes.set_xlim(x[0] - half, x[-1] + half)
    axes.set_ylim(y[-1] + half, y[0] - half)
    axes.tick_params(labelsize=SMALL_POINT, length=2)
    axes.locator_params(nbins=4, steps=[1, 2, 5, 10])
    if tile.values is None:
        axes.text(0.5, 0.5, "not solved", transform=axes.transAxes, ha="center", va="center", fontsize=SMALL_POINT)
        return
    edges = (np.append(centres - half, centres[-1] + half) for centres in (x, y))
    colours = colormaps[scale.colours].with_extremes(bad="0.88")
    axes.pcolormesh(*edges, np.ma.masked_invalid(tile.values), cmap=colours, norm=scale.norm, edgecolor="face", lw=0.2)


def half_figure(height: float) -> Figure:
    """An empty figure, half a page wide, of that many inches."""
    figure = Figure(figsize=(HALF_INCH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def short_title(name: str, longest: int = LONGEST_TITLE) -> str:
    """A name that fits."""
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def shared_legend(figure: Figure, grid: Any) -> None:
    """One legend above all axes, each name once."""
    labelled: dict[str, Any] = {}
    for axes in grid.flat:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            labelled.setdefault(text, handle)
    if labelled:
        look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": len(labelled)}
        figure.legend(labelled.values(), labelled.keys(), loc="outside upper center", **look)
