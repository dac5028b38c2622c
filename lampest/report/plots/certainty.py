"""How certain estimates are, cell by cell: standard deviation, resolution, and how far off the truth is."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter

from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.report.plots.contours import SMALL_POINT, TEXT_POINT, WIDTH_INCH, shown_frame
from lampest.report.plots.report import Scale, Tile, draw_map, positive_scale, share_scale, signed_scale
from lampest.runs.results import CaseResult, Results

LEAST_ERROR, MOST_ERROR = 3.0, 5.0  # standard deviations at the ends of the scale
TALLEST_INCH, MOST_ACROSS = 9.0, 7


def certainty(results: Results, recording: str) -> Figure:
    """The strongest frame, one column for each of the first seven estimators with error bars, three rows of maps:

    standard deviation of the cells [%], resolution [1], and, where the truth is known, the error in units of the
    standard deviation [1]. Raises InputError where no estimate of the recording has error bars.
    """
    cases = [case for case in results.of(recording) if case.cell_resistance_errors is not None][:MOST_ACROSS]
    if not cases:
        raise InputError(f"{recording}: these results hold no error bars")
    place = shown_frame(cases)
    maps = [[values(case, place) for case in cases] for values in (_deviation, _resolution)]
    scales = [positive_scale(maps[0], "standard deviation [%]"), share_scale("resolution [1]")]
    if cases[0].truth is not None:
        maps.append([_error(case, place) for case in cases])
        scales.append(signed_scale(maps[-1], "error / standard deviation [1]", LEAST_ERROR, MOST_ERROR))
    figure = _grid([case.estimator for case in cases], maps, scales, cases[0].scene.panel)
    frame, time = cases[0].frame[place], cases[0].time[place]
    figure.suptitle(f"{recording}: frame {frame} at {time:g} s, 95 % intervals reach 1.96 sd", fontsize=TEXT_POINT + 1)
    return figure


def _deviation(case: CaseResult, place: int) -> Array:
    assert case.cell_resistance_errors is not None
    deviation: Array = 100 * case.cell_resistance_errors[place] / case.cell_resistance[place]
    return np.asarray(np.where(np.isfinite(deviation), deviation, np.nan))


def _resolution(case: CaseResult, place: int) -> Array:
    assert case.resolution is not None
    return np.asarray(case.resolution[place])


def _error(case: CaseResult, place: int) -> Array:
    assert case.truth is not None
    with np.errstate(divide="ignore", invalid="ignore"):
        error: Array = np.log(case.cell_resistance[place] / case.truth[place]) / (_deviation(case, place) / 100)
    return np.asarray(np.where(np.isfinite(error), error, np.nan))


def _grid(names: Sequence[str], maps: list[list[Array]], scales: list[Scale], panel: Panel) -> Figure:
    width = (WIDTH_INCH - 1.2) / max(len(names), 3)
    height = min(len(maps) * (width * panel.rows / panel.columns + 0.25) + 0.8, TALLEST_INCH)
    figure = Figure(figsize=(WIDTH_INCH, height), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(maps), len(names), squeeze=False, sharex=True, sharey=True)
    for row, (values, scale) in enumerate(zip(maps, scales, strict=True)):
        for column, (name, value) in enumerate(zip(names, values, strict=True)):
            draw_map(grid[row, column], Tile("" if row else name, value), panel, scale)
        ticks = None if scale.ticks is None else FixedLocator(scale.ticks)
        colours = ScalarMappable(scale.norm, colormaps[scale.colours])
        bar = figure.colorbar(colours, ax=grid[row], extend=scale.extend, ticks=ticks, pad=0.02)
        if scale.ticks is not None:
            bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.minorticks_off()
        bar.set_label(scale.label, fontsize=SMALL_POINT)
        bar.ax.tick_params(labelsize=SMALL_POINT)
    figure.supxlabel(
        "position across the columns [mm]; grey: no number (failed frame or open cell)", fontsize=TEXT_POINT
    )
    figure.supylabel("position across the rows [mm]", fontsize=TEXT_POINT)
    return figure
