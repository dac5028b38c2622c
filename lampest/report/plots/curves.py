"""The report's curves: rows of cells with intervals, histograms of residuals, and estimators compared in pairs."""

from collections.abc import Callable, Iterator, Sequence
from math import ceil, floor, log10
from statistics import NormalDist
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from lampest.panel.panel import Array
from lampest.report.plots.maps import ABREAST
from lampest.report.plots.style import (
    BLUE,
    HALF_INCH,
    ORANGE,
    SMALL_POINT,
    dressed,
    labelled,
    new_figure,
    plain_number,
    round_numbers,
    shared_legend,
    short_title,
)
from lampest.report.strongest import percent_change
from lampest.runs.case import CaseResult


def _grid(titles: Sequence[str], across: int, tall: float, room: float) -> tuple[Figure, Any, Iterator[Axes]]:
    """A half figure, its grid, and its axes in order; numbers of columns below the lowest, what is left over hidden."""
    across = min(across, len(titles))
    down = ceil(len(titles) / across)
    figure = new_figure(tall * down + room, HALF_INCH)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for number, axes in enumerate(grid.flat):
        axes.set_visible(number < len(titles))
        axes.tick_params(labelsize=SMALL_POINT, length=2, labelbottom=number + across >= len(titles))
    for axes, title in zip(grid.flat, titles, strict=False):
        axes.set_title(short_title(title, 90 // (across + 1)), fontsize=SMALL_POINT + 0.5)
    return figure, grid, iter(grid.flat)


def _not_solved(axes: Axes) -> None:
    axes.text(0.5, 0.5, "not solved", transform=axes.transAxes, ha="center", va="center", fontsize=SMALL_POINT)


def profile_figure(cases: Sequence[CaseResult], place: int, row: int) -> Figure:
    """Relative change along one row of one frame: estimates with their 95 % intervals, and the truth.

    The axis is logarithmic in r/r₀, so that −90 % and +900 % are as far from zero as each other.
    """
    figure, grid, every = _grid([case.estimator for case in cases], 2, 1.25, 0.65)
    limits = _limits(cases, place, row)
    for case, axes in zip(cases, every, strict=False):
        _profile(axes, case, place, row, limits)
    _change_ticks(grid[0, 0].yaxis, *limits)
    shared_legend(figure, grid)
    return labelled(figure, f"position in row {row} [mm]", "relative change of resistance [%]")


def _profile(axes: Axes, case: CaseResult, place: int, row: int, limits: tuple[float, float]) -> None:
    axes.set_yscale("log")
    axes.set_ylim(*limits)
    axes.axhline(1, color="0.85", lw=0.6, zorder=0)
    x = case.scene.panel.centres_mm()[0]
    if case.truth is not None and case.truth_baseline is not None:
        axes.plot(x, case.truth[place, row] / case.truth_baseline[row], color="black", lw=0.9, label="truth", zorder=2)
    if not case.solved[place]:
        _not_solved(axes)
        return
    if case.relative_change_lower is not None and case.relative_change_upper is not None:
        lower, upper = (_ratio(part[place, row]) for part in (case.relative_change_lower, case.relative_change_upper))
        axes.vlines(x, lower, upper, color=BLUE, lw=1.3, alpha=0.6, label="95 % interval")
    value = _ratio(case.relative_change[place, row])
    axes.plot(x, value, "o", color=BLUE, ms=2.8, label="estimate", zorder=3)
    for mark, end, beyond in (("v", limits[0], value < limits[0]), ("^", limits[1], value > limits[1])):
        if np.any(beyond):
            axes.plot(x[beyond], np.full(int(np.sum(beyond)), end), mark, color=ORANGE, ms=4, clip_on=False, zorder=4)


def _ratio(change: Array) -> Array:
    """r/r₀ of a change in percent, kept where a logarithmic axis can draw it."""
    return np.clip(1 + change / 100, 1e-4, 1e6)


def _limits(cases: Sequence[CaseResult], place: int, row: int) -> tuple[float, float]:
    """Three times as far in r/r₀ as the truth goes, or the estimates where it is unknown, if anything goes there."""
    first = cases[0]
    held = [case.relative_change for case in cases if case.solved[place]]
    bars = [end for case in cases for end in (case.relative_change_lower, case.relative_change_upper)]
    low, high = _ends([*held, *(end for end in bars if end is not None)], place, row)
    if first.truth is not None and first.truth_baseline is not None:
        held = [percent_change(first.truth, first.truth_baseline)]
    inner_low, inner_high = _ends(held, place, row)
    return max(inner_low / 3, min(low, inner_low)) / 1.15, min(inner_high * 3, max(high, inner_high)) * 1.15


def _ends(changes: Sequence[Array], place: int, row: int) -> tuple[float, float]:
    """The smallest and the largest r/r₀ of one row of one frame, of all that are finite, and 1."""
    ratios = np.concatenate([np.ones(1), *(_ratio(part[place, row]) for part in changes)])
    known = ratios[np.isfinite(ratios)]
    return float(known.min()), float(known.max())


def _change_ticks(axis: Axis, low: float, high: float) -> None:
    """Round changes in percent at their r/r₀, none too close to the next, zero always."""
    apart = log10(high / low) / 6
    ticks = [1.0]
    for change in (-50, 100, -90, 900, -80, 400, -99, 9900, -95, 1900, 200, -98, 20, -20, 10, -10, 5, -5, 2, -2):
        ratio = 1 + change / 100
        if low <= ratio <= high and all(abs(log10(ratio / tick)) > apart for tick in ticks):
            ticks.append(ratio)
    _fixed_ticks(axis, ticks, lambda ratio, _: f"{100 * (ratio - 1):+,.4g}".replace("-", "−") if ratio != 1 else "0")


def histogram_figure(residuals: Sequence[tuple[str, Array]]) -> Figure:
    """How many of the residuals of each estimator, in units of σ, fall into which of 41 bins, in percent.

    The bins widen as sinh so that large ones are seen, the outermost hold what is beyond; a line gives the standard
    normal's shares.
    """
    figure, grid, every = _grid([name for name, _ in residuals], ABREAST, 1.1, 0.7)
    known = np.abs(np.concatenate([values for _, values in residuals]))
    reach = float(np.arcsinh(max(5.0, np.percentile(known, 99.8) if known.size else 0.0)))
    edges = np.sinh(np.linspace(-reach, reach, 42))
    normal = 100 * np.diff([NormalDist().cdf(edge) for edge in edges])
    for (_, values), axes in zip(residuals, every, strict=False):
        axes.set_xscale("asinh")
        _fixed_ticks(axes.xaxis, [tick for tick in (-3000, -100, -3, 0, 3, 100, 3000) if abs(tick) < edges[-1]])
        if values.size == 0:
            _not_solved(axes)
        else:
            counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
            _histogram(axes, 100 * counts / values.size, normal, edges)
    shared_legend(figure, grid)
    return labelled(figure, "(model − measured)/σ", "share of readings [%]")


def _histogram(axes: Axes, shares: Array, normal: Array, edges: Array) -> None:
    axes.stairs(shares, edges, fill=True, color=BLUE, alpha=0.7, label="residuals")
    axes.stairs(normal, edges, color="black", lw=0.8, label="standard normal")
    tallest = 2.5 * normal.max()
    axes.set_ylim(0, tallest)
    if shares.max() > tallest:
        place: dict[str, Any] = {"transform": axes.transAxes, "ha": "right", "va": "top", "fontsize": SMALL_POINT - 0.5}
        axes.text(0.97, 0.95, f"up to {shares.max():.0f} %", **place)


def _fixed_ticks(axis: Axis, ticks: Sequence[float], text: Callable[[float, int | None], str] = plain_number) -> None:
    axis.set_major_locator(FixedLocator(list(ticks)))
    axis.set_major_formatter(FuncFormatter(text))
    axis.set_minor_locator(NullLocator())


def _plain_ticks(axis: Axis, low: float, high: float) -> None:
    """Ticks at 1, 2, 5, 10 …, or at powers of ten where there would be too many, written without powers."""
    ticks = round_numbers(low, high)
    if len(ticks) > 7:
        ticks = [10.0**power for power in range(ceil(log10(low)), floor(log10(high)) + 1)]
    if len(ticks) < 2:
        ticks = [tick for tick in MaxNLocator(4).tick_values(low, high) if low <= tick <= high]
    _fixed_ticks(axis, ticks)


def paired_figure(names: Sequence[str], values: Array, label: str) -> Figure:
    """values (units, estimators): a dot for each unit, lines join those of one unit, a bar marks the mean."""
    figure = new_figure(2.6, HALF_INCH)
    axes = figure.subplots()
    place = np.arange(len(names))
    shown = np.maximum(values, 0)
    if np.all(shown > 0):
        axes.set_yscale("log")
        low, high = float(shown.min()) / 1.2, float(shown.max()) * 1.2
        axes.set_ylim(low, high)
        _plain_ticks(axes.yaxis, low, high)
    axes.plot(place, shown.T, "-", color="0.75", lw=0.5, zorder=1)
    axes.plot(np.broadcast_to(place, shown.shape), shown, "o", color=BLUE, ms=2.4, mew=0, alpha=0.7, zorder=2)
    axes.hlines(shown.mean(axis=0), place - 0.22, place + 0.22, color=ORANGE, lw=1.8, zorder=3)
    axes.set_xlim(-0.5, len(names) - 0.5)
    slant: dict[str, Any] = {"rotation": 35, "ha": "right"} if sum(map(len, names)) > 40 else {}
    axes.set_xticks(place, [short_title(name) for name in names], **slant)
    dressed(axes, "", label, "y")
    return figure


Lines = Sequence[tuple[str, float, float, float]]  # name, value, lower and upper end


def forest_figure(forests: Sequence[tuple[Lines, str, float]]) -> Figure:
    """Values with their intervals, forest below forest; filled where an interval excludes the reference.

    forests : lines, the label of their axis with its unit, and the reference: 1 of ratios, on a logarithmic axis.
    """
    high = [0.2 * len(lines) + 0.45 for lines, _, _ in forests]
    figure = new_figure(sum(high) + 0.3, HALF_INCH)
    every = figure.subplots(len(forests), squeeze=False, height_ratios=high).flat
    for axes, forest in zip(every, forests, strict=True):
        _forest(axes, *forest)
    return figure


def _forest(axes: Axes, lines: Lines, label: str, reference: float) -> None:
    if reference:
        axes.set_xscale("log")
    axes.axvline(reference, color="black", lw=0.7)
    for place, (_, value, lower, upper) in enumerate(lines):
        axes.plot([lower, upper], [place, place], color=BLUE, lw=1.4)
        covered = lower <= reference <= upper
        axes.plot(value, place, "o", mec=BLUE, mfc="white" if covered else BLUE, ms=4.5, mew=1.1)
    axes.set_yticks(range(len(lines)), [short_title(name, 30) for name, *_ in lines])
    axes.set_ylim(len(lines) - 0.4, -0.6)
    if reference:
        _plain_ticks(axes.xaxis, *axes.get_xlim())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(6))
    dressed(axes, label, "", "x")
