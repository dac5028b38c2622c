"""Pressure of one frame: a signed map, how far the 95 % interval reaches, and the cells on the response curve."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from lampest.files.errors import InputError
from lampest.loads.response import ratio_from_pressure
from lampest.panel.panel import Array
from lampest.panel.response import Response
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, PRESSING, MapPainter, Scale, Tile, stepped_scale
from lampest.report.plots.plot import Plot, frame_title, shown_index
from lampest.report.plots.style import BLUE, SMALL_POINT, TEXT_POINT, new_figure, plain_number
from lampest.runs.case import CaseResult

# All in kPa, the same for all frames and recordings.
SHOWN = (-32.0, 132.0)


@dataclass(frozen=True)
class PressurePlot(Plot):
    """Three panels of one frame: pressure, half its 95 % interval, resistance against pressure with the response curve.

    Crosses mark cells whose pressure the response leaves open.

    >>> lampest.PressurePlot().apart
    True
    """

    kind: ClassVar[str] = "pressure"
    needs: ClassVar[tuple[str, ...]] = ("pressure", "pressure_lower", "pressure_upper", "saturated")
    apart: ClassVar[bool] = True

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One estimator's picture. Raises InputError where it has no pressure, or has not solved the frame."""
        (case,) = cases
        index, who = shown_index(cases, self.frame), f"{case.recording}: {case.estimator}"
        if not case.solved[index]:
            raise InputError(f"{who} has not solved frame {case.frame[index]}")
        if not self.drawable(cases):
            raise InputError(f"{who} holds no pressure with its interval")
        pressure, lower, upper, saturated = (case.column(name)[index] for name in self.needs)
        marked = saturated != 0
        figure = new_figure(3.2)
        left, middle, right = figure.subplots(1, 3, width_ratios=(1, 1, 1.05))
        steps, ticks = (0.5, 1, 2, 5, 10, 20, 40), (-40, -10, -2, -0.5, 1, 5, 20)
        signed = stepped_scale(steps, "pressure [kPa]: suction − contact +", ticks, PRESSING)
        _map(left, case, Tile("(a) pressure of the load", pressure, "", marked, "saturated"), signed)
        left.set_ylabel(DOWN_LABEL, fontsize=TEXT_POINT)
        least, most = 0.1, 100.0
        half = np.clip((upper - lower) / 2, least / 2, 2 * most)  # none and infinite: beyond the scale, not missing
        colours = colormaps["YlGnBu"]
        widths = Scale(LogNorm(least, most), colours, "half the 95 % interval [kPa]", "both", (0.1, 1.0, 10.0, 100.0))
        _map(middle, case, Tile("(b) uncertainty", half, "", marked, "saturated"), widths)
        if case.scene.response is not None:  # results of an older version may have pressures without
            _curve(right, case.scene.response)
        ratio = 1 + case.relative_change[index] / 100
        for chosen, sign, colour, label in ((~marked, "o", BLUE, "cell, 95 %"), (marked, "x", "black", "saturated")):
            if np.any(chosen):
                found = pressure[chosen], lower[chosen], upper[chosen]
                _cells(right, ratio[chosen], *found, fmt=sign, color=colour, label=label)
        _axes(right)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=SMALL_POINT, frameon=False)
        title = f"{case.recording}, {case.estimator}: {frame_title(case, index, self.frame)}"
        figure.suptitle(title, fontsize=TEXT_POINT + 1)
        return figure


def _map(axes: Axes, case: CaseResult, tile: Tile, scale: Scale) -> None:
    painter = MapPainter(case.scene.panel, scale)
    painter.draw(axes, tile)
    painter.bar(axes.figure, axes, "bottom", aspect=22)
    axes.set_xlabel(ACROSS_LABEL, fontsize=TEXT_POINT)


def _curve(axes: Axes, response: Response) -> None:
    """Resistance against pressure, as the scene says; water and temperature move cells off the curve."""
    least, most = SHOWN
    curve, known = np.linspace(least, most, 1000), response.told_kpa
    axes.plot(100 * ratio_from_pressure(curve, response), curve, color="0.6", lw=1, label="response", zorder=1)
    for low, high in ((least, max(known[0], least)), (min(known[1], most), most)):
        label = "where resistance determines little" if low < 0 else None
        axes.axhspan(low, high, color="0.93", lw=0, zorder=0, label=label)


def _cells(axes: Axes, ratio: Array, pressure: Array, lower: Array, upper: Array, **look: Any) -> None:
    """Resistance against pressure of some cells, with 95 % intervals."""
    inside = np.clip(pressure, *SHOWN)
    reach = np.abs(np.clip([lower, upper], *SHOWN) - inside)
    axes.errorbar(100 * ratio, inside, yerr=reach, ms=2.5, elinewidth=0.5, alpha=0.8, **look)


def _axes(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
    axes.set_ylim(*SHOWN)
    axes.set_yscale("symlog", linthresh=10, linscale=1.2)
    axes.set_yticks([-30, -10, -5, 0, 5, 10, 30, 100])
    axes.yaxis.set_major_formatter(FuncFormatter(plain_number))
    axes.minorticks_off()
    axes.tick_params(labelsize=SMALL_POINT)
    axes.set_xlabel("resistance [% of unloaded]", fontsize=TEXT_POINT)
    axes.set_ylabel("pressure [kPa]", fontsize=TEXT_POINT)
    axes.set_title("(c) cells and response", fontsize=TEXT_POINT)
