"""The report's comparison of estimators: a dot for every recording, and differences with their intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from lampest.panel.panel import Array
from lampest.report.plots.style import BLUE, ORANGE, SMALL_POINT, TEXT_POINT, half_figure, plain_number, short_title


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
