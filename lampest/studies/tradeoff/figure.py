"""The trade between speed and accuracy: time per frame against cell error and against the objective's gap."""

from collections.abc import Sequence
from string import ascii_lowercase
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, new_figure
from lampest.studies.study import Row, grouped
from lampest.studies.timing import NO_GAP

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
MARKERS = "osD^vPX"
SPOTS = ((0, 9), (0, -9), (7, 0), (-7, 0), (7, 7), (-7, 7), (7, -7), (-7, -7), (0, 16), (0, -16), (14, 11), (-14, 11))

Placed = list[tuple[str, tuple[float, float]]]
Box = tuple[float, float, float, float]


def tradeoff_figure(rows: Sequence[Row]) -> Figure:
    """A row of panels for every size: time against the changed cells' error, and against the gap.

    rows : of all methods, all recordings of a size together. The labelled points are the first method's rungs, the line
    through some of them is their Pareto front, and small signs are the other methods' rungs. Gaps below 1e-12 are
    drawn there, on a line that says so.
    """
    sizes = grouped(rows, lambda row: (row.rows, row.columns))
    methods = list(dict.fromkeys(row.method for row in rows))
    figure = new_figure(2.2 * len(sizes) + 0.6)
    grid = figure.subplots(len(sizes), 2, squeeze=False, sharex="row")
    letters, labelled = iter(ascii_lowercase), []
    for (shape, own), pair in zip(sizes.items(), grid, strict=True):
        for axes, gap in zip(pair, (False, True), strict=True):
            labelled.append((axes, _draw(axes, own, methods, gap)))
            axes.set_title(f"({next(letters)}) {shape[0]} × {shape[1]} cells", fontsize=TEXT_POINT, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("time per frame [ms]", fontsize=TEXT_POINT)
    handles, labels = grid[0, 1].get_legend_handles_labels()
    shown = dict(zip(labels, handles, strict=True))
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": len(shown)}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", **look)
    figure.draw_without_rendering()
    for axes, placed in labelled:
        _label(axes, figure.dpi / 72, placed)
    return figure


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates, smaller being better, by the first one."""
    best, kept = float("inf"), []
    for index in sorted(range(len(points)), key=lambda index: points[index]):
        if points[index][1] < best:
            best = points[index][1]
            kept.append(index)
    return kept


def _draw(axes: Axes, rows: Sequence[Row], methods: Sequence[str], gap: bool) -> Placed:
    """Everything but the names; returns the rungs' names and where they stand."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.tick_params(labelsize=SMALL_POINT, which="both")
    axes.grid(True, which="major", color="0.9", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.set_ylabel("objective gap" if gap else "median error of changed cells [%]", fontsize=TEXT_POINT)
    for number, method in enumerate(methods[1:]):
        points = [point for row in rows if row.method == method if (point := _place(row, gap)) is not None]
        if points:
            look: dict[str, Any] = {"color": COLOURS[number % len(COLOURS)], "ms": 2.8, "mew": 0, "alpha": 0.75}
            axes.plot(*zip(*points, strict=True), MARKERS[number % len(MARKERS)], label=method, ls="", **look)
    placed = [(row, point) for row in rows if row.method == methods[0] and (point := _place(row, gap)) is not None]
    if not placed:
        axes.text(0.5, 0.5, "no truth", transform=axes.transAxes, ha="center", fontsize=TEXT_POINT)
        return []
    points = [point for _, point in placed]
    best = front(points)
    x, y = zip(*(points[index] for index in best), strict=True)
    axes.step(x, y, where="post", color="0.3", lw=0.9, label="Pareto front", zorder=2.5)
    for index, point in enumerate(points):
        filled = "black" if index in best else "white"
        look = {"label": methods[0]} if index == best[0] else {}
        axes.plot(*point, "o", ms=5.5, mfc=filled, mec="black", mew=0.9, zorder=3, **look)
    if gap and min(value for _, value in points) <= NO_GAP:
        axes.axhline(NO_GAP, color="0.5", lw=0.6, ls=":")
        axes.text(
            0.01, NO_GAP * 1.5, "0 (or below 1e-12)", transform=axes.get_yaxis_transform(), fontsize=SMALL_POINT - 1
        )
        axes.set_ylim(bottom=NO_GAP / 30)
    axes.margins(0.12, 0.14)
    return [(row.formulation.replace("_", " "), point) for row, point in placed]


def _place(row: Row, gap: bool) -> tuple[float, float] | None:
    """Where a row stands; None without a truth, or where it failed."""
    value = row.gap if gap else row.changed_error
    if value is None or not np.isfinite(value):
        return None
    return row.frame_ms, max(value, NO_GAP) if gap else value


def _label(axes: Axes, scale: float, placed: Placed) -> None:
    """Each name at the spot round its point where it covers least of points and names; scale : pixels of a point."""
    pixels = [(float(x), float(y)) for x, y in (axes.transData.transform(point) for _, point in placed)]
    taken = [(x - 4 * scale, y - 4 * scale, x + 4 * scale, y + 4 * scale) for x, y in pixels]
    frame = axes.get_window_extent()
    for (name, point), (x, y) in zip(placed, pixels, strict=True):
        wide, high = 0.52 * SMALL_POINT * len(name) * scale, 1.1 * SMALL_POINT * scale
        choices: list[tuple[float, int, Box]] = []
        for right, up in SPOTS:
            left = x + right * scale - (wide / 2 if right == 0 else wide if right < 0 else 0)
            low = y + up * scale - high / 2
            box = (left, low, left + wide, low + high)
            outside = box[0] < frame.x0 or box[2] > frame.x1 or box[1] < frame.y0 or box[3] > frame.y1
            choices.append((sum(_overlap(box, other) for other in taken) + 1e4 * outside, len(choices), box))
        _, number, box = min(choices)
        right, up = SPOTS[number]
        text = axes.annotate(
            name,
            point,
            (right, up),
            textcoords="offset points",
            fontsize=SMALL_POINT,
            ha="center" if right == 0 else "left" if right > 0 else "right",
            va="center",
            zorder=4,
        )
        text.set_path_effects([withStroke(linewidth=1.8, foreground="white")])
        taken.append(box)


def _overlap(one: Box, other: Box) -> float:
    wide = min(one[2], other[2]) - max(one[0], other[0])
    high = min(one[3], other[3]) - max(one[1], other[1])
    return max(wide, 0) * max(high, 0)
