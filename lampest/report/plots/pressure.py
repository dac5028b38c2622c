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
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.loads.response import ratio_from_pressure
from lampest.panel.panel import Array
from lampest.panel.response import Response
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, PRESSING, MapPainter, Scale, Tile, stepped_scale
from lampest.report.plots.plot import Plot, frame_title, shown_index
from lampest.report.plots.style import BLUE, SMALL_POINT, TEXT_POINT, new_figure, plain_number
from lampest.runs.case import CaseResult

HEIGHT_INCH = 3.2
STEPS_KPA = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)  # the same for all frames and recordings, white within the first
TICKS_KPA = (-40.0, -10.0, -2.0, -0.5, 1.0, 5.0, 20.0)
WIDTH_TICKS_KPA = (0.1, 1.0, 10.0, 100.0)
SHOWN_KPA = (-32.0, 132.0)

Marks = NDArray[np.bool_]


@dataclass(frozen=True)
class PressurePlot(Plot):
    """Three panels of one frame: pressure, half its 95 % interval, resistance against pressure with the response curve.

    `frame` is an index into the recording; without it `strongest_index` chooses. Crosses mark cells whose pressure the
    response leaves open.

    >>> lampest.PressurePlot().apart
    True
    """

    kind: ClassVar[str] = "pressure"
    needs: ClassVar[tuple[str, ...]] = ("pressure", "pressure_lower", "pressure_upper", "saturated")
    apart: ClassVar[bool] = True

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One estimator's picture. Raises InputError where it has no pressure, or has not solved the frame."""
        (case,) = cases
        index = shown_index(cases, self.frame)
        pressure, lower, upper, marked = _shown(case, index)
        figure = new_figure(HEIGHT_INCH)
        left, middle, right = figure.subplots(1, 3, width_ratios=(1, 1, 1.05))
        _map(left, case, Tile("(a) pressure of the load", pressure, "", marked, "saturated"), _signed())
        left.set_ylabel(DOWN_LABEL, fontsize=TEXT_POINT)
        least, most = WIDTH_TICKS_KPA[0], WIDTH_TICKS_KPA[-1]
        half = np.clip((upper - lower) / 2, least / 2, 2 * most)  # none and infinite: beyond the scale, not missing
        _map(middle, case, Tile("(b) uncertainty", half, "", marked, "saturated"), _widths())
        ratio, response = 1 + case.relative_change[index] / 100, case.scene.response
        if response is not None:  # results of an older version may have pressures without
            _curve(right, response)
        _cells(right, ratio, pressure, lower, upper, marked)
        right.set_title("(c) cells and response", fontsize=TEXT_POINT)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=SMALL_POINT, frameon=False)
        title = f"{case.recording}, {case.estimator}: {frame_title(case, index, self.frame)}"
        figure.suptitle(title, fontsize=TEXT_POINT + 1)
        return figure


def _shown(case: CaseResult, index: int) -> tuple[Array, Array, Array, Marks]:
    """Pressure, both ends of its interval in kPa, and where the response leaves it open; each (rows, columns)."""
    who = f"{case.recording}: {case.estimator}"
    if not case.solved[index]:
        raise InputError(f"{who} has not solved frame {case.frame[index]}")
    if case.pressure is None or case.pressure_lower is None or case.pressure_upper is None or case.saturated is None:
        raise InputError(f"{who} holds no pressure with its interval")
    return case.pressure[index], case.pressure_lower[index], case.pressure_upper[index], case.saturated[index] != 0


def _signed() -> Scale:
    return stepped_scale(STEPS_KPA, "pressure [kPa]: suction − contact +", TICKS_KPA, PRESSING)


def _widths() -> Scale:
    norm = LogNorm(WIDTH_TICKS_KPA[0], WIDTH_TICKS_KPA[-1])
    return Scale(norm, colormaps["YlGnBu"], "half the 95 % interval [kPa]", "both", WIDTH_TICKS_KPA)


def _map(axes: Axes, case: CaseResult, tile: Tile, scale: Scale) -> None:
    painter = MapPainter(case.scene.panel, scale)
    painter.draw(axes, tile)
    painter.bar(axes.figure, axes, "bottom", aspect=22)
    axes.set_xlabel(ACROSS_LABEL, fontsize=TEXT_POINT)


def _curve(axes: Axes, response: Response) -> None:
    """Resistance against pressure, as the scene says; water and temperature move cells off the curve."""
    least, most = SHOWN_KPA
    curve, known = np.linspace(least, most, 1000), response.told_kpa
    axes.plot(100 * ratio_from_pressure(curve, response), curve, color="0.6", lw=1, label="response", zorder=1)
    for low, high in ((least, max(known[0], least)), (min(known[1], most), most)):
        label = "where resistance determines little" if low < 0 else None
        axes.axhspan(low, high, color="0.93", lw=0, zorder=0, label=label)


def _cells(axes: Axes, ratio: Array, pressure: Array, lower: Array, upper: Array, marked: Marks) -> None:
    """Resistance against pressure of every cell, with 95 % intervals."""
    least, most = SHOWN_KPA
    for chosen, sign, colour, label in ((~marked, "o", BLUE, "cell, 95 %"), (marked, "x", "black", "saturated")):
        at, inside = 100 * ratio[chosen], np.clip(pressure[chosen], least, most)
        reach = np.abs(np.clip([lower[chosen], upper[chosen]], least, most) - inside)
        look: dict[str, Any] = {"color": colour, "ms": 2.5, "elinewidth": 0.5, "alpha": 0.8, "label": label}
        if at.size:
            axes.errorbar(at, inside, yerr=reach, fmt=sign, **look)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
    axes.set_ylim(least, most)
    axes.set_yscale("symlog", linthresh=10, linscale=1.2)
    axes.set_yticks([-30, -10, -5, 0, 5, 10, 30, 100], labels=["−30", "−10", "−5", "0", "5", "10", "30", "100"])
    axes.minorticks_off()
    axes.tick_params(labelsize=SMALL_POINT)
    axes.set_xlabel("resistance [% of unloaded]", fontsize=TEXT_POINT)
    axes.set_ylabel("pressure [kPa]", fontsize=TEXT_POINT)
