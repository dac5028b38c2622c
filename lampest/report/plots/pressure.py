"""Pressure of one frame: a signed map, how far the 95 % interval reaches, and the cells on the response curve."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from lampest.files.errors import InputError
from lampest.loads.response import ratio_from_pressure
from lampest.panel.response import Response
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, PRESSING, MapPainter, Scale, Tile, stepped_scale
from lampest.report.plots.plot import Plot
from lampest.report.plots.style import BLUE, SMALL_POINT, TEXT_POINT, dressed, new_figure, plain_number
from lampest.runs.case import CaseResult

SHOWN = (-32.0, 132.0)  # kPa, the same for all frames and recordings


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
        index, title = self.shown(cases)
        if not case.solved[index]:
            raise InputError(f"{case.recording}: {case.estimator} has not solved frame {case.frame[index]}")
        if not self.drawable(cases):
            raise InputError(f"{case.recording}: {case.estimator} holds no pressure with its interval")
        pressure, lower, upper, saturated = (case.column(name)[index] for name in self.needs)
        figure = new_figure(3.2)
        left, middle, right = figure.subplots(1, 3, width_ratios=(1, 1, 1.05))
        steps, ticks = (0.5, 1, 2, 5, 10, 20, 40), (-40, -10, -2, -0.5, 1, 5, 20)
        signed = stepped_scale(steps, "pressure [kPa]: suction − contact +", ticks, PRESSING)
        half = np.clip((upper - lower) / 2, 0.05, 200)  # none and infinite: beyond the scale, not missing
        norm, label = LogNorm(0.1, 100), "half the 95 % interval [kPa]"
        widths = Scale(norm, colormaps["YlGnBu"], label, "both", (0.1, 1.0, 10.0, 100.0))
        maps = (left, "(a) pressure of the load", pressure, signed), (middle, "(b) uncertainty", half, widths)
        for axes, name, values, scale in maps:
            painter = MapPainter(case.scene.panel, scale)
            painter.draw(axes, Tile(name, values, "", saturated != 0, "saturated"))
            painter.bar(figure, axes, "bottom", aspect=22)
            axes.set_xlabel(ACROSS_LABEL, fontsize=TEXT_POINT)
        left.set_ylabel(DOWN_LABEL, fontsize=TEXT_POINT)
        if case.scene.response is not None:  # results of an older version may have pressures without
            _curve(right, case.scene.response)
        inside, ratio = np.clip(pressure, *SHOWN), 100 + case.relative_change[index]
        reach = np.abs(np.clip([lower, upper], *SHOWN) - inside)
        for chosen, sign, colour, label in (
            (saturated == 0, "o", BLUE, "cell, 95 %"),
            (saturated != 0, "x", "black", "saturated"),
        ):
            look = {"fmt": sign, "color": colour, "ms": 2.5, "elinewidth": 0.5, "alpha": 0.8}
            if np.any(chosen):
                right.errorbar(ratio[chosen], inside[chosen], yerr=reach[:, chosen], label=label, **look)
        _axes(right)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=SMALL_POINT, frameon=False)
        figure.suptitle(title.replace(":", f", {case.estimator}:", 1), fontsize=TEXT_POINT + 1)
        return figure


def _curve(axes: Axes, response: Response) -> None:
    """Resistance against pressure, as the scene says; water and temperature move cells off the curve."""
    least, most = SHOWN
    curve, known = np.linspace(least, most, 1000), response.told_kpa
    axes.plot(100 * ratio_from_pressure(curve, response), curve, color="0.6", lw=1, label="response", zorder=1)
    for low, high in ((least, max(known[0], least)), (min(known[1], most), most)):
        label = "where resistance determines little" if low < 0 else None
        axes.axhspan(low, high, color="0.93", lw=0, zorder=0, label=label)


def _axes(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.set_ylim(*SHOWN)
    axes.set_yscale("symlog", linthresh=10, linscale=1.2)
    axes.set_yticks([-30, -10, -5, 0, 5, 10, 30, 100])
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(plain_number))
    axes.minorticks_off()
    dressed(axes, "resistance [% of unloaded]", "pressure [kPa]")
    axes.set_title("(c) cells and response", fontsize=SMALL_POINT + 0.5)
