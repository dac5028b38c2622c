"""Pressure of one frame: a signed map, how far the 95 % interval reaches, and the cells on the response curve."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.loads.response import TOLD_KPA, ratio_from_pressure
from lampest.panel.panel import Array, Panel
from lampest.report.plots.contours import COLOURS, SMALL_POINT, TEXT_POINT, WIDTH_INCH, place_of, shown_frame
from lampest.runs.results import CaseResult

HEIGHT_INCH = 3.2
BANDS_KPA = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)  # the same for all frames and recordings, white within the first
WIDTHS, LEAST_KPA, MOST_KPA = "YlGnBu", 0.1, 100.0
SHOWN_KPA = (-32.0, 132.0)

Marks = NDArray[np.bool_]


def pressure_figure(case: CaseResult, frame: int | None = None) -> Figure:
    """Three panels of one frame: pressure, half its 95 % interval, resistance against pressure with the response curve.

    `frame` is an index into the recording; without it `shown_frame` chooses. Crosses mark cells whose pressure the
    response does not tell. Raises InputError where the case holds no pressure, or the frame has no solution.
    """
    place = shown_frame((case,)) if frame is None else place_of(case, frame)
    pressure, lower, upper, marked = _shown(case, place)
    panel = case.scene.panel
    figure = Figure(figsize=(WIDTH_INCH, HEIGHT_INCH), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1, 1, 1.05))
    ends = np.concatenate([np.negative(BANDS_KPA)[::-1], BANDS_KPA])
    signed = BoundaryNorm(ends, colormaps[COLOURS].N, extend="both")
    _map(left, panel, pressure, marked, signed, COLOURS, "pressure [kPa]: suction − contact +")
    left.set_ylabel("position across the rows [mm]", fontsize=TEXT_POINT)
    left.set_title("(a) pressure of the load", fontsize=TEXT_POINT)
    wide = LogNorm(LEAST_KPA, MOST_KPA)
    half = np.clip((upper - lower) / 2, LEAST_KPA / 2, 2 * MOST_KPA)  # none and infinite: beyond the scale, not missing
    _map(middle, panel, half, marked, wide, WIDTHS, "half the 95 % interval [kPa]")
    middle.set_title("(b) uncertainty", fontsize=TEXT_POINT)
    _response(right, 1 + case.relative_change[place] / 100, pressure, lower, upper, marked)
    right.set_title("(c) cells and response", fontsize=TEXT_POINT)
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=SMALL_POINT, frameon=False)
    why = ", the last within 10 % of the strongest change" if frame is None else ""
    title = f"{case.recording}, {case.estimator}: frame {case.frame[place]} at {case.time[place]:g} s{why}"
    figure.suptitle(title, fontsize=TEXT_POINT + 1)
    return figure


def _shown(case: CaseResult, place: int) -> tuple[Array, Array, Array, Marks]:
    """Pressure, both ends of its interval in kPa, and where the response does not tell it; each (rows, columns)."""
    who = f"{case.recording}: {case.estimator}"
    if not case.solved[place]:
        raise InputError(f"{who} has not solved frame {case.frame[place]}")
    if case.pressure is None or case.pressure_lower is None or case.pressure_upper is None or case.saturated is None:
        raise InputError(f"{who} holds no pressure with its interval")
    return case.pressure[place], case.pressure_lower[place], case.pressure_upper[place], case.saturated[place] != 0


def _map(axes: Axes, panel: Panel, values: Array, marked: Marks, norm: Normalize, colours: str, label: str) -> None:
    """One square for a cell: values that stand for cells are not to be drawn as if they were known in between."""
    x, y = panel.centres_mm()
    half = panel.pitch_mm / 2
    edges = (np.append(centres - half, centres[-1] + half) for centres in (x, y))
    look = axes.pcolormesh(*edges, values, cmap=colours, norm=norm)
    axes.set_aspect("equal")
    axes.invert_yaxis()
    columns, rows = np.meshgrid(x, y)
    size = float(np.clip(30 / max(panel.shape), 0.5, 4))
    cross = axes.plot(columns[marked], rows[marked], "x", color="black", ms=size, mew=size / 4)
    cross[0].set_path_effects([withStroke(linewidth=size / 2, foreground="white")])
    axes.locator_params(nbins=5, steps=[1, 2, 5, 10])
    axes.set_xlabel("position across the columns [mm]", fontsize=TEXT_POINT)
    bar = axes.figure.colorbar(look, ax=axes, location="bottom", extend="both", spacing="uniform", aspect=22)
    if isinstance(norm, BoundaryNorm):
        shown = norm.boundaries[::2].tolist()
        bar.set_ticks(shown, labels=[f"{end:g}".replace("-", "−") for end in shown])
    else:
        bar.ax.xaxis.set_major_formatter(FuncFormatter(_plain))
    bar.set_label(label, fontsize=TEXT_POINT)
    bar.ax.tick_params(labelsize=SMALL_POINT, which="both")
    axes.tick_params(labelsize=SMALL_POINT)


def _plain(value: float, _: int) -> str:
    return f"{value:g}"


def _response(axes: Axes, ratio: Array, pressure: Array, lower: Array, upper: Array, marked: Marks) -> None:
    """Resistance against pressure with 95 % intervals; water and temperature move cells off the curve."""
    least, most = SHOWN_KPA
    curve = np.linspace(least, most, 1000)
    axes.plot(100 * ratio_from_pressure(curve), curve, color="0.6", lw=1, label="response in air", zorder=1)
    for beyond in ((least, TOLD_KPA[0]), (TOLD_KPA[1], most)):
        axes.axhspan(
            *beyond, color="0.93", lw=0, zorder=0, label="where resistance says little" if beyond[0] < 0 else None
        )
    for chosen, sign, colour, label in ((~marked, "o", "#0072B2", "cell, 95 %"), (marked, "x", "black", "saturated")):
        at, inside = 100 * ratio[chosen], np.clip(pressure[chosen], least, most)
        reach = np.abs(np.clip([lower[chosen], upper[chosen]], least, most) - inside)
        look: dict[str, Any] = {"color": colour, "ms": 2.5, "elinewidth": 0.5, "alpha": 0.8, "label": label}
        if at.size:
            axes.errorbar(at, inside, yerr=reach, fmt=sign, **look)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    axes.set_ylim(least, most)
    axes.set_yscale("symlog", linthresh=10, linscale=1.2)
    axes.set_yticks([-30, -10, -5, 0, 5, 10, 30, 100], labels=["−30", "−10", "−5", "0", "5", "10", "30", "100"])
    axes.minorticks_off()
    axes.tick_params(labelsize=SMALL_POINT)
    axes.set_xlabel("resistance [% of unloaded]", fontsize=TEXT_POINT)
    axes.set_ylabel("pressure [kPa]", fontsize=TEXT_POINT)
