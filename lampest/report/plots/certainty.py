"""How certain estimates are, cell by cell: standard deviation, resolution, and how far off the truth is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure

from lampest.panel.panel import Array
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, MapPainter, Tile
from lampest.report.plots.plot import Plot, shown_index
from lampest.report.plots.scales import Scale, positive_scale, share_scale, signed_scale
from lampest.report.plots.style import SMALL_POINT, TALLEST_INCH, TEXT_POINT, WIDTH_INCH, new_figure, short_title
from lampest.runs.case import CaseResult

LEAST_ERROR, MOST_ERROR = 3.0, 5.0  # standard deviations at the ends of the scale
MOST_ACROSS = 7


@dataclass(frozen=True)
class CertaintyPlot(Plot):
    """One frame, one column for each of the first seven estimators with error bars, three rows of maps:

    standard deviation of the cells [%], resolution, and, where the truth is known, the error in units of the
    standard deviation. `frame` is an index into the recording; without it `strongest_index` chooses.
    """

    kind: ClassVar[str] = "certainty"
    needs: ClassVar[tuple[str, ...]] = ("cell_resistance_errors", "resolution")

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture of all estimators. Raises InputError where the frame has no results."""
        cases = cases[:MOST_ACROSS]
        index, first = shown_index(cases, self.frame), cases[0]
        rows = _rows(cases, index)
        width = (WIDTH_INCH - 1.2) / max(len(cases), 3)
        tall = width * first.scene.panel.rows / first.scene.panel.columns
        figure = new_figure(min(len(rows) * (tall + 0.25) + 0.8, TALLEST_INCH))
        grid = figure.subplots(len(rows), len(cases), squeeze=False, sharex=True, sharey=True)
        for number, (scale, maps) in enumerate(rows):
            painter = MapPainter(first.scene.panel, scale, point=SMALL_POINT + 0.5)
            for axes, case, values in zip(grid[number], cases, maps, strict=True):
                painter.draw(axes, Tile("" if number else short_title(case.estimator), values))
            painter.bar(figure, grid[number], "right")
        figure.supxlabel(f"{ACROSS_LABEL}; grey: no number (failed frame or open cell)", fontsize=TEXT_POINT)
        figure.supylabel(DOWN_LABEL, fontsize=TEXT_POINT)
        title = (
            f"{first.recording}: frame {first.frame[index]} at {first.time[index]:g} s, 95 % intervals reach 1.96 sd"
        )
        figure.suptitle(title, fontsize=TEXT_POINT + 1)
        return figure


def _rows(cases: Sequence[CaseResult], index: int) -> list[tuple[Scale, list[Array]]]:
    """Scale and maps of every row of the picture."""
    deviations = [_deviation(case, index) for case in cases]
    resolutions = [case.resolution[index] for case in cases if case.resolution is not None]
    rows = [
        (positive_scale(deviations, "standard deviation [%]"), deviations),
        (share_scale("resolution"), resolutions),
    ]
    truth = cases[0].truth
    if truth is not None:
        pairs = zip(cases, deviations, strict=True)
        errors = [_error(case.cell_resistance[index], truth[index], deviation) for case, deviation in pairs]
        rows.append((signed_scale(errors, "error / standard deviation", LEAST_ERROR, MOST_ERROR), errors))
    return rows


def _deviation(case: CaseResult, index: int) -> Array:
    """Of a cell [%]; NaN where it is infinite."""
    assert case.cell_resistance_errors is not None
    deviation: Array = 100 * case.cell_resistance_errors[index] / case.cell_resistance[index]
    return np.where(np.isfinite(deviation), deviation, np.nan)


def _error(cells: Array, truth: Array, deviation: Array) -> Array:
    """log(r/truth) in units of its standard deviation [%]; NaN where that says nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error: Array = np.log(cells / truth) / (deviation / 100)
    return np.where(np.isfinite(error), error, np.nan)
