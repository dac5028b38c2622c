"""Mapping contours: relative change of resistance over the panel, one map for each estimator, on one colour scale."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from textwrap import fill
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from lampest.files.errors import InputError
from lampest.files.whole import whole_file
from lampest.panel.panel import Array, Panel
from lampest.recording.readings import strongest_frame
from lampest.runs.results import CaseResult, Results

COLOURS = "RdBu_r"
LIMITS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
WIDTH_INCH, TALLEST_INCH, MOST_ACROSS = 7.2, 9.0, 7
REFINEMENT, NEARLY = 8, 0.1
TEXT_POINT, SMALL_POINT = 8, 6.5
DOTS_PER_INCH = 200
Extend = Literal["both", "min", "max", "neither"]
SUFFIXES = (".png", ".pdf")


@dataclass(frozen=True, eq=False)
class _Map:
    """One picture of a figure: relative change (rows, columns) in percent, or None where the frame failed."""

    title: str
    change: Array | None
    open_cell: Any = None


@dataclass(frozen=True)
class _Scale:
    """Bands of relative change in percent, their colours, and which ends values go beyond."""

    norm: BoundaryNorm
    colours: Colormap
    extend: Extend


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as .png or .pdf, whole or not at all; the same figure gives the same bytes.

    Raises InputError for another suffix or where the place cannot be written.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: pictures are written as {' or '.join(SUFFIXES)}")
    metadata = {"Software": None} if path.suffix == ".png" else {"CreationDate": None}
    with whole_file(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix[1:], dpi=DOTS_PER_INCH, metadata=metadata)


def contours(results: Results, recording: str, frame: int | None = None) -> Figure:
    """Maps of one frame side by side: measured two-point resistance, each estimator's cell resistance, the truth.

    All show 100·(R/R₀ − 1) in percent on one scale that is symmetric about zero. `frame` is an index into the
    recording; without it `shown_frame` chooses. Raises InputError where the recording or the frame has no results.
    Source: paper, figure 8.
    """
    cases = results.of(recording)
    place = shown_frame(cases) if frame is None else place_of(cases[0], frame)
    maps = _maps(cases, place)
    panel = cases[0].scene.panel
    scale = _scale([item.change for item in maps if item.change is not None])
    across = _maps_across(len(maps), panel)
    down = ceil(len(maps) / across)
    height = min(_height(across, down, panel), TALLEST_INCH)
    figure = Figure(figsize=(WIDTH_INCH, height), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for number, axes in enumerate(grid.flat):
        if number < len(maps):
            letter = f"({chr(ord('a') + number)}) " if number < 26 else ""
            _draw(
                axes, maps[number], panel, scale, fill(letter + maps[number].title, max(10, int(17 * _width(across))))
            )
            axes.tick_params(labelbottom=number + across >= len(maps))
        else:
            axes.set_visible(False)
    _decorate(figure, grid, scale)
    why = ", the last within 10 % of the strongest change" if frame is None else ""
    index, time = cases[0].frame[place], cases[0].time[place]
    figure.suptitle(f"{recording}: frame {index} at {time:g} s{why}", fontsize=TEXT_POINT + 1)
    return figure


def shown_frame(cases: Sequence[CaseResult]) -> int:
    """Where the last of those frames stands that are nearly the strongest and that most of the cases solved."""
    solved = np.sum([case.solved for case in cases], axis=0)
    frames = np.flatnonzero(solved == solved.max())
    return strongest_frame(cases[0].measured, cases[0].measured_baseline, frames, NEARLY)


def place_of(case: CaseResult, frame: int) -> int:
    """Where a recording's frame stands in the case. Raises InputError where it has no results."""
    places = np.flatnonzero(case.frame == frame)
    if places.size == 0:
        raise InputError(
            f"{case.recording}: frame {frame} has no results; there are frames {case.frame.min()} to {case.frame.max()}"
        )
    return int(places[0])


def _maps(cases: Sequence[CaseResult], place: int) -> list[_Map]:
    first = cases[0]
    maps = [_Map("measured two-point", percent_change(first.measured[place], first.measured_baseline))]
    for case in cases:
        change = case.relative_change[place] if case.solved[place] else None
        maps.append(_Map(case.estimator, change, case.open_cell[place] != 0))
    if first.truth is not None and first.truth_baseline is not None:
        maps.append(_Map("truth", percent_change(first.truth[place], first.truth_baseline)))
    return maps


def percent_change(resistance: Array, baseline: Array) -> Array:
    """100·(R/R₀ − 1), any shape, in percent."""
    return 100 * (resistance / baseline - 1)


def _scale(changes: Sequence[Array]) -> _Scale:
    """Bands of a tenth of the limit, the middle one from −1/10 to +1/10 so that noise about zero stays white.

    The limit is the smallest round number that holds 98 % of all values, 100 % at most; arrows stand for the rest.
    """
    values = np.concatenate([change.ravel() for change in changes])
    reach = np.percentile(np.abs(values), 98)
    limit = next((limit for limit in LIMITS if limit >= reach), LIMITS[-1])
    tenths = np.arange(1, 11) * limit / 10
    bands = colormaps[COLOURS](np.linspace(0.04, 0.96, 19))
    colours = ListedColormap(bands).with_extremes(under=colormaps[COLOURS](0.0), over=colormaps[COLOURS](1.0))
    below, above = bool(np.any(values < -limit)), bool(np.any(values > limit))
    extend: Extend = ("both" if above else "min") if below else ("max" if above else "neither")
    return _Scale(BoundaryNorm(np.concatenate([-tenths[::-1], tenths]), len(bands)), colours, extend)


def _maps_across(maps: int, panel: Panel) -> int:
    """How many maps stand side by side, so that the figure comes close to three by two with few gaps."""

    def misfit(across: int) -> float:
        down = ceil(maps / across)
        return abs(_height(across, down, panel) - WIDTH_INCH / 1.5) + 0.3 * (across * down - maps)

    return min(range(1, min(maps, MOST_ACROSS) + 1), key=misfit)


def _height(across: int, down: int, panel: Panel) -> float:
    """Inches that `down` maps of the panel's proportions and their titles need."""
    return down * (_width(across) * _extent(panel.rows) / _extent(panel.columns) + 0.4) + 0.8


def _width(across: int) -> float:
    """Inches of one map."""
    return (WIDTH_INCH - 1.0) / across - 0.2


def _extent(lines: int) -> float:
    return lines - 1.0 if lines > 1 else 1.0


def _draw(axes: Axes, item: _Map, panel: Panel, scale: _Scale, name: str) -> None:
    x, y = panel.centres_mm()
    single, half = min(panel.shape) == 1, panel.pitch_mm / 2
    axes.set_aspect("equal")
    axes.set_xlim(x[0] - half * single, x[-1] + half * single)
    axes.set_ylim(y[-1] + half * single, y[0] - half * single)
    axes.tick_params(labelsize=SMALL_POINT)
    axes.locator_params(nbins=5, steps=[1, 2, 5, 10])
    if item.change is None:
        axes.set_title(name, fontsize=TEXT_POINT)
        axes.set_facecolor("0.92")
        axes.text(0.5, 0.5, "not solved", transform=axes.transAxes, ha="center", va="center", fontsize=TEXT_POINT)
        return
    axes.set_title(f"{name}\n{_range(item.change)}", fontsize=TEXT_POINT, linespacing=1.3)
    if single:  # contours need two lines each way
        edges = (np.append(centres - half, centres[-1] + half) for centres in (x, y))
        axes.pcolormesh(*edges, item.change, cmap=scale.colours, norm=scale.norm)
    else:
        colours: dict[str, Any] = {"cmap": scale.colours, "norm": scale.norm, "extend": scale.extend}
        # A cell far beyond the scale must not spread its colour over its neighbours: it is drawn as just beyond.
        beyond = 1.1 * scale.norm.boundaries[-1]
        axes.contourf(*_refined(x, y, np.clip(item.change, -beyond, beyond)), scale.norm.boundaries, **colours)
    columns, rows = np.meshgrid(x, y)
    axes.plot(columns.ravel(), rows.ravel(), ".", color="0.35", ms=1, label="cell centre", clip_on=False)
    if item.open_cell is not None and np.any(item.open_cell):
        at = item.open_cell
        mark = axes.plot(columns[at], rows[at], "x", color="black", ms=4, mew=1, label="open cell", clip_on=False)
        mark[0].set_path_effects([withStroke(linewidth=2.2, foreground="white")])


def _refined(x: Array, y: Array, values: Array) -> tuple[Array, Array, Array]:
    """Bilinear interpolation on a finer grid: contours without the corners that straight pieces between cells have."""
    fine = [np.linspace(centres[0], centres[-1], (len(centres) - 1) * REFINEMENT + 1) for centres in (x, y)]
    across = np.array([np.interp(fine[0], x, row) for row in values])
    return fine[0], fine[1], np.array([np.interp(fine[1], y, column) for column in across.T]).T


def _range(change: Array) -> str:
    low, high = (
        f"{value:+.{0 if abs(value) >= 10 else 1}f}".replace("-", "−") for value in (change.min(), change.max())
    )
    return f"{low} … {high} %"


def _decorate(figure: Figure, grid: Any, scale: _Scale) -> None:
    limit = scale.norm.boundaries[-1]
    look: dict[str, Any] = {"aspect": figure.get_figheight() / 0.16, "pad": 0.02, "extendfrac": 0.04}
    bar = figure.colorbar(
        ScalarMappable(scale.norm, scale.colours),
        ax=grid,
        ticks=np.linspace(-limit, limit, 11),
        spacing="proportional",
        extend=scale.extend,
        **look,
    )
    bar.set_label(f"relative change of resistance [%] (ends at ±{limit:g} %)", fontsize=TEXT_POINT)
    bar.ax.tick_params(labelsize=SMALL_POINT)
    bar.minorticks_off()
    figure.supxlabel("position across the columns [mm]", fontsize=TEXT_POINT)
    figure.supylabel("position across the rows [mm]", fontsize=TEXT_POINT)
    labelled: dict[str, Any] = {}
    for axes in grid.flat:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            labelled.setdefault(label, handle)
    if len(labelled) > 1:
        figure.legend(
            labelled.values(), labelled.keys(), loc="outside lower right", ncols=2, fontsize=SMALL_POINT, frameon=False
        )
