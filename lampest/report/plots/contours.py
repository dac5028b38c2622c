"""Maps of one frame side by side: relative change, resistance, certainty, or pressure, by every estimator."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.report.plots import maps, style
from lampest.report.plots.plot import Plot
from lampest.report.strongest import percent_change
from lampest.runs.case import CaseResult


@dataclass(frozen=True)
class ContourPlot(Plot):
    """Maps of one frame side by side: measured readings, each estimator's cell resistance, the truth.

    All show the change against the unloaded panel in percent on one scale that is symmetric about zero. Source: paper,
    figure 8.

    >>> lampest.ContourPlot(frame=2).kind
    'contours'
    """

    kind: ClassVar[str] = "contours"

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture of all estimators. Raises InputError where the frame has no results."""
        index, title = self.shown(cases)
        first, letters = cases[0], iter("abcdefghijklmnopqrstuvwxyz")

        def tile(name: str, change: Array | None, crosses: NDArray[np.bool_] | None = None) -> maps.Tile:
            letter = next(letters, "")
            lettered = f"({letter}) {name}" if letter else name
            return maps.Tile(lettered.replace("paper's lambda", "paper's λ"), change, _range(change), crosses)

        kind = "measured two-point" if first.scene.circuit.unit == "ohm" else "measured voltage"
        tiles = [tile(kind, percent_change(first.measured[index], first.measured_baseline))]
        for case in cases:
            change = case.relative_change[index] if case.solved[index] else None
            tiles.append(tile(case.estimator, change, case.open_cell[index] != 0))
        if first.truth is not None and first.truth_baseline is not None:
            tiles.append(tile("truth", percent_change(first.truth[index], first.truth_baseline)))
        scale = maps.banded_scale(maps.values_of(tiles), "relative change of resistance [%]")
        return maps.maps_figure(tiles, first.scene.panel, scale, title, contoured=True)


def _range(change: Array | None) -> str:
    """'−82 … +9.5 %'."""
    if change is None:
        return ""
    known = change[np.isfinite(change)]
    ends = [style.change_text(float(value), 10.0) for value in (known.min(), known.max())] if known.size else []
    return f"{' … '.join(ends)} %" if ends else "no number"


@dataclass(frozen=True)
class ResistancePlot(Plot):
    """Maps of one frame: what was measured, each estimator's cells, the truth; r in ohm, dark where low.

    For recordings without unloaded frames. The scale ends at the 90th percentile: open cells reach any resistance.
    A reference of exactly 1 ohm stands for an unknown one, R_ref: resistances are in units of it.
    """

    kind: ClassVar[str] = "resistance"

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture. Raises InputError where the frame has no results."""
        index, title = self.shown(cases)
        first = cases[0]
        found = [(case.estimator, case.cell_resistance[index] if case.solved[index] else None) for case in cases]
        given = [("measured", first.measured[index])]
        true = [] if first.truth is None else [("truth", first.truth[index])]
        tiles = [maps.Tile(*named) for named in (*given, *found, *true)]
        unit = "R_ref" if getattr(first.scene.readout, "reference_ohm", None) == 1 else "ohm"
        scale = maps.log_scale(maps.values_of(tiles), f"resistance [{unit}]", 90.0, (1e-3, 1e12))
        return maps.maps_figure(tiles, first.scene.panel, scale, title)


@dataclass(frozen=True)
class RowsPlot(Plot):
    """One frame, a column for each of the first seven estimators that hold what it needs, a row for each quantity."""

    about: ClassVar[str]

    @abstractmethod
    def rows(self, cases: Sequence[CaseResult], index: int) -> list[tuple[maps.Scale, list[maps.Tile]]]:
        """Scale and maps of every row."""

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture of all estimators. Raises InputError where the frame has no results."""
        cases = cases[: int(style.WIDTH_INCH)]
        index, title = self.shown(cases)
        rows, panel = self.rows(cases, index), cases[0].scene.panel
        tall = (style.WIDTH_INCH - 1.2) / max(len(cases), 2) * maps.proportion(panel)
        figure = style.new_figure(min(len(rows) * (tall + 0.25) + 0.8, style.TALLEST_INCH))
        grid = figure.subplots(len(rows), len(cases), squeeze=False, sharex=True, sharey=True)
        for number, (scale, tiles) in enumerate(rows):
            painter = maps.MapPainter(panel, scale)
            painter.draw_all(grid[number : number + 1], tiles)
            painter.bar(figure, grid[number], "right")
        for axes, case in zip(grid[0], cases, strict=True):
            axes.set_title(style.short_title(case.estimator), fontsize=style.SMALL_POINT + 0.5)
        style.shared_legend(figure, grid, "lower right")
        return style.labelled(figure, f"{maps.ACROSS_LABEL}; {self.about}", maps.DOWN_LABEL, title)


@dataclass(frozen=True)
class CertaintyPlot(RowsPlot):
    """Of every estimator with error bars: standard deviation of the cells [%], resolution, and, where the truth is
    known, the error in units of the standard deviation.

    >>> lampest.CertaintyPlot().needs
    ('cell_resistance_errors', 'resolution')
    """

    kind: ClassVar[str] = "certainty"
    needs: ClassVar[tuple[str, ...]] = ("cell_resistance_errors", "resolution")
    about: ClassVar[str] = "grey: no number (failed frame or open cell); 95 % intervals reach 1.96 sd"

    def rows(self, cases: Sequence[CaseResult], index: int) -> list[tuple[maps.Scale, list[maps.Tile]]]:
        """Standard deviations, resolutions, and errors."""
        cells = [case.cell_resistance[index] for case in cases]
        errors, resolutions = ([case.column(name)[index] for case in cases] for name in self.needs)
        deviations = [100 * error / own for error, own in zip(errors, cells, strict=True)]
        rows = [(maps.log_scale(deviations, "standard deviation [%]"), deviations), (maps.RESOLUTION, resolutions)]
        truth = cases[0].truth
        if truth is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                logs = [100 * np.log(own / truth[index]) for own in cells]
                ratios = [one / deviation for one, deviation in zip(logs, deviations, strict=True)]
            rows.append((maps.signed_scale(ratios, "error / standard deviation", least=3.0, most=5.0), ratios))
        return [
            (scale, [maps.Tile("", np.where(np.isfinite(one), one, np.nan)) for one in each]) for scale, each in rows
        ]


@dataclass(frozen=True)
class PressurePlot(RowsPlot):
    """Of every estimator: pressure, and half its 95 % interval. Crosses mark cells whose pressure the response leaves
    open. The scales are the same for all frames and recordings.

    >>> lampest.PressurePlot().kind
    'pressure'
    """

    kind: ClassVar[str] = "pressure"
    needs: ClassVar[tuple[str, ...]] = ("pressure", "pressure_lower", "pressure_upper", "saturated")
    about: ClassVar[str] = "grey: no number"

    def rows(self, cases: Sequence[CaseResult], index: int) -> list[tuple[maps.Scale, list[maps.Tile]]]:
        """Pressures, and half the widths of their intervals."""
        steps, ticks = (0.5, 1, 2, 5, 10, 20, 40), (-40, -10, -2, -0.5, 1, 5, 20)
        signed = maps.stepped_scale(steps, "pressure [kPa]: suction − contact +", ticks, maps.PRESSING)
        norm, label = LogNorm(0.1, 100), "half the 95 % interval [kPa]"
        widths = maps.Scale(norm, colormaps["YlGnBu"], label, (0.1, 1.0, 10.0, 100.0))
        pressures, halves = [], []
        for case in cases:
            pressure, lower, upper, saturated = (case.column(name)[index] for name in self.needs)
            half = np.clip((upper - lower) / 2, 0.05, 200)  # none and infinite: beyond the scale, not missing
            pressures.append(maps.Tile("", pressure, "", saturated != 0, "saturated"))
            halves.append(maps.Tile("", half, "", saturated != 0, "saturated"))
        return [(signed, pressures), (widths, halves)]
