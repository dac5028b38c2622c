"""The report's curves: rows of cells with intervals, histograms of residuals, and estimators compared in pairs."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, erf, floor, log10, sqrt
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from lampest.panel.panel import Array
from lampest.report.plots.maps import ACROSS
from lampest.report.plots.style import (
    BLUE,
    ORANGE,
    SMALL_POINT,
    TEXT_POINT,
    half_figure,
    plain_number,
    shared_legend,
    short_title,
)
from lampest.runs.case import CaseResult

BINS, LEAST_REACH = 41, 5.0  # of a histogram; its reach in standard deviations
TALLEST = 2.5  # a histogram's axis, against the highest bin of the standard normal
DEVIATIONS = (-3000, -100, -3, 0, 3, 100, 3000)
CHANGES = (-50, 100, -90, 900, -80, 400, -99, 9900, -95, 1900, 200, -98, 20, -20, 10, -10, 5, -5, 2, -2)  # percent
DRAWABLE = (1e-4, 1e6)


def profile_figure(cases: Sequence[CaseResult], place: int, row: int) -> Figure:
    """Relative change along one row of one frame: estimates with their 95 % intervals, and the truth.

    The axis is logarithmic in r/r₀, so that −90 % and +900 % are as far from zero as each other.
    """
    across = min(2, len(cases))
    down = ceil(len(cases) / across)
    figure = half_figure(1.25 * down + 0.65)
    limits = _limits(cases, place, row)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for number, axes in enumerate(grid.flat):
        if number >= len(cases):
            axes.set_visible(False)
            continue
        _profile(axes, cases[number], place, row, limits)
        axes.tick_params(labelbottom=number + across >= len(cases))
    _change_ticks(grid[0, 0].yaxis, *limits)
    figure.supxlabel(f"position in row {row} [mm]", fontsize=TEXT_POINT)
    figure.supylabel("relative change of resistance [%]", fontsize=TEXT_POINT)
    shared_legend(figure, grid)
    return figure


def _profile(axes: Axes, case: CaseResult, place: int, row: int, limits: tuple[float, float]) -> None:
    axes.set_title(short_title(case.estimator, 30), fontsize=SMALL_POINT + 0.5)
    axes.tick_params(labelsize=SMALL_POINT, length=2)
    axes.set_yscale("log")
    axes.set_ylim(*limits)
    axes.axhline(1, color="0.85", lw=0.6, zorder=0)
    x = case.scene.panel.centres_mm()[0]
    if case.truth is not None and case.truth_baseline is not None:
        axes.plot(x, case.truth[place, row] / case.truth_baseline[row], color="black", lw=0.9, label="truth", zorder=2)
    if not case.solved[place]:
        axes.text(0.5, 0.5, "not solved", transform=axes.transAxes, ha="center", va="center", fontsize=SMALL_POINT)
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
    return np.clip(1 + change / 100, *DRAWABLE)


def _limits(cases: Sequence[CaseResult], place: int, row: int) -> tuple[float, float]:
    """Three times as far in r/r₀ as the truth goes, or the estimates where it is unknown, if anything goes there."""
    first = cases[0]
    estimates = [_ratio(case.relative_change[place, row]) for case in cases if case.solved[place]]
    known = (case.relative_change_lower for case in cases), (case.relative_change_upper for case in cases)
    ends = [_ratio(part[place, row]) for side in known for part in side if part is not None]
    far = np.concatenate([np.ones(1), *(part[np.isfinite(part)] for part in (*estimates, *ends))])
    held = np.concatenate([np.ones(1), *(part[np.isfinite(part)] for part in estimates)])
    if first.truth is not None and first.truth_baseline is not None:
        held = np.append(first.truth[place, row] / first.truth_baseline[row], 1.0)
    low, high = max(held.min() / 3, min(far.min(), held.min())), min(held.max() * 3, max(far.max(), held.max()))
    return float(low) / 1.15, float(high) * 1.15


def _change_ticks(axis: Axis, low: float, high: float) -> None:
    """Round changes in percent at their r/r₀, none too close to the next, zero always."""
    apart = log10(high / low) / 6
    ticks = [1.0]
    for change in CHANGES:
        ratio = 1 + change / 100
        if low <= ratio <= high and all(abs(log10(ratio / tick)) > apart for tick in ticks):
            ticks.append(ratio)
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FuncFormatter(lambda ratio, _: _signed(100 * (ratio - 1))))
    axis.set_minor_locator(NullLocator())


def _signed(change: float) -> str:
    return f"{change:+,.4g}".replace("-", "−") if abs(change) > 1e-9 else "0"


def histogram_figure(residuals: Sequence[tuple[str, Array]], weighted: bool) -> Figure:
    """How many of the residuals of each estimator fall into which bin, in percent.

    In units of σ the bins widen as sinh so that large ones are seen, and a line gives the standard normal's shares.
    """
    across = min(ACROSS, len(residuals))
    down = ceil(len(residuals) / across)
    figure = half_figure(1.1 * down + 0.7)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    reach = _reach([values for _, values in residuals])
    edges = np.linspace(-reach, reach, BINS + 1)
    if weighted:
        reach = float(np.arcsinh(max(reach, LEAST_REACH)))
        edges = np.sinh(np.linspace(-reach, reach, BINS + 1))
    for number, axes in enumerate(grid.flat):
        if number >= len(residuals):
            axes.set_visible(False)
            continue
        _histogram(axes, *residuals[number], edges, weighted)
        axes.tick_params(labelbottom=number + across >= len(residuals))
    figure.supxlabel(f"(model − measured)/{'σ' if weighted else 'measured [%]'}", fontsize=TEXT_POINT)
    figure.supylabel("share of readings [%]", fontsize=TEXT_POINT)
    shared_legend(figure, grid)
    return figure


def _histogram(axes: Axes, name: str, values: Array, edges: Array, weighted: bool) -> None:
    axes.set_title(short_title(name), fontsize=SMALL_POINT + 0.5)
    axes.tick_params(labelsize=SMALL_POINT, length=2)
    if weighted:
        axes.set_xscale("asinh")
        axes.xaxis.set_major_locator(FixedLocator([tick for tick in DEVIATIONS if abs(tick) < edges[-1]]))
        axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
        axes.xaxis.set_minor_locator(NullLocator())
    if values.size == 0:
        axes.text(0.5, 0.5, "not solved", transform=axes.transAxes, ha="center", va="center", fontsize=SMALL_POINT)
        return
    counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
    shares = 100 * counts / values.size
    axes.stairs(shares, edges, fill=True, color=BLUE, alpha=0.7, label="residuals")
    if not weighted:
        return
    normal = 100 * np.diff([0.5 * (1 + erf(edge / sqrt(2))) for edge in edges])
    axes.stairs(normal, edges, color="black", lw=0.8, label="standard normal")
    axes.set_ylim(0, TALLEST * normal.max())
    if shares.max() > TALLEST * normal.max():
        place: dict[str, Any] = {"transform": axes.transAxes, "ha": "right", "va": "top", "fontsize": SMALL_POINT - 0.5}
        axes.text(0.97, 0.95, f"up to {shares.max():.0f} %", **place)


def _reach(values: Sequence[Array]) -> float:
    """What 99.8 % of the residuals do not exceed; those beyond are counted in the outermost bins."""
    known = np.abs(np.concatenate([part.ravel() for part in values] or [np.zeros(0)]))
    return max(float(np.percentile(known, 99.8)), 1e-9) if known.size else 1.0


def paired_figure(names: Sequence[str], values: Array, label: str) -> Figure:
    """values (units, estimators): a dot for each unit, lines join those of one unit, a bar marks the mean."""
    figure = half_figure(2.6)
    axes = figure.subplots()
    place = np.arange(len(names))
    shown = values if np.all(values > 0) else np.maximum(values, 0)
    if np.all(shown > 0):
        axes.set_yscale("log")
        low, high = float(shown.min()) / 1.2, float(shown.max()) * 1.2
        axes.set_ylim(low, high)
        _plain_ticks(axes.yaxis, low, high)
    axes.plot(place, shown.T, "-", color="0.75", lw=0.5, zorder=1)
    for at in place:
        axes.plot(np.full(len(shown), at), shown[:, at], "o", color=BLUE, ms=2.4, mew=0, alpha=0.7, zorder=2)
        axes.plot([at - 0.22, at + 0.22], [shown[:, at].mean()] * 2, color=ORANGE, lw=1.8, zorder=3)
    axes.set_xlim(-0.5, len(names) - 0.5)
    long = sum(map(len, names)) > 40
    axes.set_xticks(
        place, [short_title(name) for name in names], rotation=35 if long else 0, ha="right" if long else "center"
    )
    axes.tick_params(labelsize=SMALL_POINT, which="both")
    axes.set_ylabel(label, fontsize=TEXT_POINT)
    axes.grid(True, axis="y", color="0.92", lw=0.5)
    axes.set_axisbelow(True)
    return figure


@dataclass(frozen=True)
class ForestLine:
    """One line of a forest: name, value and its interval, and whether the interval excludes the reference."""

    name: str
    value: float
    lower: float
    upper: float
    marked: bool


@dataclass(frozen=True)
class Forest:
    """Lines beside a vertical one at the reference; label : of the axis, with its unit."""

    lines: tuple[ForestLine, ...]
    label: str
    reference: float
    logarithmic: bool


def forest_figure(forests: Sequence[Forest]) -> Figure:
    """Values with their intervals, forest below forest; filled where an interval excludes the reference."""
    high = [0.2 * len(forest.lines) + 0.45 for forest in forests]
    figure = half_figure(sum(high) + 0.3)
    for axes, forest in zip(
        figure.subplots(len(forests), squeeze=False, height_ratios=high).flat, forests, strict=True
    ):
        _forest(axes, forest)
    return figure


def _forest(axes: Axes, forest: Forest) -> None:
    if forest.logarithmic:
        axes.set_xscale("log")
    axes.axvline(forest.reference, color="black", lw=0.7)
    for place, line in enumerate(forest.lines):
        axes.plot([line.lower, line.upper], [place, place], color=BLUE, lw=1.4)
        axes.plot(line.value, place, "o", mec=BLUE, mfc=BLUE if line.marked else "white", ms=4.5, mew=1.1)
    axes.set_yticks(range(len(forest.lines)), [short_title(line.name, 30) for line in forest.lines])
    axes.set_ylim(len(forest.lines) - 0.4, -0.6)
    axes.tick_params(labelsize=SMALL_POINT)
    if forest.logarithmic:
        _plain_ticks(axes.xaxis, *axes.get_xlim())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.set_xlabel(forest.label, fontsize=TEXT_POINT)
    axes.grid(True, axis="x", color="0.92", lw=0.5)
    axes.set_axisbelow(True)


def _plain_ticks(axis: Axis, low: float, high: float) -> None:
    """Ticks at 1, 2, 5, 10 …, or at powers of ten where there would be too many, written without powers."""
    powers = range(floor(log10(low)), ceil(log10(high)) + 1)
    ticks = [step * 10.0**power for power in powers for step in (1, 2, 5) if low <= step * 10.0**power <= high]
    if len(ticks) > 7:
        ticks = [10.0**power for power in powers]
    if len(ticks) < 2:
        ticks = list(MaxNLocator(4).tick_values(low, high))
    axis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axis.set_major_formatter(FuncFormatter(plain_number))
    axis.set_minor_locator(NullLocator())
