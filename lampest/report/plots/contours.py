"""Maps of one frame side by side by every estimator, and errors over the values of a sweep."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, repeat
from typing import Any, ClassVar

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes as Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure as Figure
from matplotlib.ticker import LogLocator

from lampest.files.errors import InputError
from lampest.files.typed import Validated
from lampest.panel.panel import Array, Mask
from lampest.report.compare import MIN_DIFFERENCE, figures_of, weighted_residual
from lampest.report.plots.maps import (
    ACROSS_LABEL,
    DOWN_LABEL,
    PRESSING,
    MapPainter,
    Scale,
    Tile,
    change_scale,
    limited,
    log_scale,
    maps_figure,
    signed_scale,
    stepped_scale,
    values_of,
)
from lampest.report.plots.style import (
    PLAIN_NUMBER,
    SMALL_POINT,
    change_text,
    dressed,
    labelled,
    new_figure,
    shared_legend,
)
from lampest.report.strongest import apparent_change, as_recorded, percent_change, strongest_index
from lampest.report.words import digits
from lampest.runs.case import CaseResult, Cases

CHANGED = 10.0  # percent: cells within the line about the load
Maps = tuple[list[Scale], list[Tile]]
MAX_ACROSS = 7  # estimators in a row of maps, an inch each


@dataclass(frozen=True)
class Plot(Validated):
    """A kind of plot of a results file.

    Attributes
    ----------
    kind : str
        Name on the command line.
    needs : tuple of str
        Columns that a case must have.
    hint : str
        How to obtain them.
    frame : int or None
        Index into the recording; None for the frame chosen by `strongest_index`.
    vmin, vmax : float or None
        Ends of the colour scale, or of the vertical axis, in its unit; None for those of the
        values.

    Examples
    --------
    >>> issubclass(lampest.ContourPlot, lampest.Plot)
    True
    """

    kind: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    hint: ClassVar[str] = ""
    frame: int | None = None
    vmin: float | None = None
    vmax: float | None = None

    @abstractmethod
    def draw(self, cases: Cases) -> Figure:
        """Draw the cases of a recording that have the needed columns."""

    def draw_on(self, axes: Axes, cases: Cases) -> None:
        """Draw the first case into given axes.

        Raises InputError if the plot has no single picture.
        """
        raise InputError(f"the plot {self.kind} has no picture for single axes")

    def drawable(self, cases: Cases) -> tuple[CaseResult, ...]:
        """Return the cases that have the needed columns."""
        return tuple(
            case for case in cases if all(case.column(name) is not None for name in self.needs)
        )

    def shown(self, cases: Cases) -> tuple[int, str]:
        """Return the frame of the cases that is shown, and its title.

        Raises InputError if the frame has no results.

        Returns
        -------
        index : int
            Index of the frame among those of the cases.
        title : str
        """
        first = cases[0]
        if self.frame is None:
            index = strongest_index(cases)
        elif self.frame in first.frame:
            index = int(np.argmax(first.frame == self.frame))
        else:
            known = f"there are frames {first.frame.min()} to {first.frame.max()}"
            raise InputError(f"{first.recording}: frame {self.frame} has no results; {known}")
        return index, f"{first.recording}: frame {first.frame[index]} at {first.time[index]:.4g} s"


@dataclass(frozen=True)
class MapsPlot(Plot):
    """Maps of one frame: the measurement, each estimator, the truth.

    Some plots show rows of quantities of each estimator instead.
    """

    @abstractmethod
    def maps(self, cases: Cases, index: int) -> Maps:
        """Return the maps of the cases' frame at an index, and their scales.

        Returns
        -------
        scales : list of Scale
            One scale for all maps, one for each row, or one for each map.
        tiles : list of Tile
            The maps, row by row.
        """

    contoured: ClassVar[bool] = False
    about: ClassVar[str] = ""
    main: ClassVar[int] = 0  # the map of the first case, which is drawn into given axes

    def _limited(self, cases: Cases) -> tuple[str, Scale, Maps]:
        """Return the title of the maps, the main scale between vmin and vmax, and the maps with it.

        Raises InputError if the frame has no results.
        """
        index, title = self.shown(cases)
        scales, tiles = self.maps(cases, index)
        place = min(self.main, len(scales) - 1)
        scales[place] = limited(scales[place], self.vmin, self.vmax)
        return title, scales[place], (scales, tiles)

    def draw_on(self, axes: Axes, cases: Cases) -> None:
        """Draw the map of the first case, with its colour bar.

        Raises InputError if the frame has no results.
        """
        _, scale, (_, tiles) = self._limited(cases[:1])
        tile = tiles[self.main]
        painter = MapPainter(cases[0].scene.panel, scale, self.contoured)
        note = "\n".join(filter(None, (tile.note, misfit_text(cases[:1]))))
        painter.draw(axes, replace(tile, note=note))
        painter.bar(axes.figure, axes, "right")
        axes.set_xlabel(ACROSS_LABEL)
        axes.set_ylabel(DOWN_LABEL)

    def draw(self, cases: Cases) -> Figure:
        """Draw all estimators. Raises InputError if the frame has no results."""
        title, _, (scales, tiles) = self._limited(cases)
        title = "\n".join(filter(None, (title, misfit_text(cases))))
        panel = cases[0].scene.panel
        return maps_figure(tiles, panel, scales, title, contoured=self.contoured, about=self.about)


def misfit_text(cases: Cases) -> str:
    """Return a sentence on estimators whose circuit does not explain the readings, or ''."""
    names = [case.estimator for case in cases if case.model_mark == "no"]
    if not names:
        return ""
    whose = "" if len(names) == len(cases) else f" of {', '.join(names)}"
    return f"wrong circuit: it does not explain the readings{whose}; see lampest info"


@dataclass(frozen=True)
class ChangePlot(MapsPlot):
    """Maps of the change against the unloaded panel, or the first measured frame, in percent.

    The maps show measured readings, each estimator's cells, and the truth. Readings in volt are
    shown as the resistance that each cell would have alone. All maps have one scale, on which
    halves and doubles are equally strong. Each cell is a square. Where the truth is known, a line
    surrounds the cells that changed, and each map names its error in ln(r/r_unloaded) as a part of
    the true change: 100 % is that of a map without any change.

    >>> lampest.ChangePlot(frame=2).kind
    'change'
    """

    kind = "change"
    main = 1

    def maps(self, cases: Cases, index: int) -> Maps:
        """Return maps of the relative change.

        Returns
        -------
        scales : list of Scale
            Change of resistance in percent, for all maps.
        tiles : list of Tile
            Maps of the measurement, of each case, and of the truth if it is known.
        """
        first = cases[0]
        truth = None
        if first.truth is not None and first.truth_baseline is not None:
            truth = percent_change(first.truth[index], first.truth_baseline)

        def tile(name: str, change: Array | None, crosses: Mask | None = None) -> Tile:
            note = ""
            if change is not None:
                note = _range(change)
                if truth is not None and change is not truth:
                    note = _error(change, truth)
            outlined = None if truth is None else np.abs(truth) > CHANGED
            return Tile(name, change, note, crosses, outlined=outlined)

        measured = apparent_change(first.measured[index], first.measured_baseline, first.scene)
        alone = "" if first.scene.circuit.unit == "ohm" else ": each cell as if alone"
        tiles = [tile(f"measured{alone}", measured)]
        for case in cases:
            change = case.relative_change[index] if case.solved[index] else None
            tiles.append(tile(estimated(case, cases), change, case.open_cell[index] != 0))
        if truth is not None:
            tiles.append(tile("truth", truth))
        return [change_scale(values_of(tiles), "change of resistance [%]")], tiles


@dataclass(frozen=True)
class ContourPlot(ChangePlot):
    """The maps of `ChangePlot` with contours that interpolate between the cells.

    Source: paper, figure 8.

    >>> lampest.ContourPlot(frame=2).kind
    'contours'
    """

    kind = "contours"
    contoured = True
    about = "bands interpolate between the cells"


def estimated(case: CaseResult, cases: Cases) -> str:
    """Return the title of an estimator's map; a single estimator is marked as an estimate."""
    return case.estimator if len(cases) > 1 else f"estimated: {case.estimator}"


def _range(change: Array) -> str:
    """Return the smallest and largest value in words, such as '−82 … +9.5 %'."""
    known = change[np.isfinite(change)]
    if not known.size:
        return "no number"
    low, high = (change_text(float(end), 10.0) for end in (known.min(), known.max()))
    return f"{low} … {high} %"


def _error(change: Array, truth: Array) -> str:
    """Return ‖x − x_true‖/‖x_true‖ of x = ln(r/r_unloaded) over the cells in words.

    An example is 'error 7.2 %'.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logs, true = (np.log1p(percent / 100) for percent in (change, truth))
        known = np.isfinite(logs) & np.isfinite(true)
        error = 100 * np.linalg.norm((logs - true)[known]) / np.linalg.norm(true[known])
    return f"error {digits(float(error), 2)} %"


@dataclass(frozen=True)
class ResistancePlot(MapsPlot):
    """Maps of the resistance: measured readings, each estimator's cells, the truth.

    Low resistances are bright. The plot serves recordings without unloaded frames. Each map has its
    own scale, since crosstalk lowers all readings.

    >>> lampest.ResistancePlot().kind
    'resistance'
    """

    kind = "resistance"
    main = 1
    about = "bright: low resistance, loaded"

    def maps(self, cases: Cases, index: int) -> Maps:
        """Return maps of readings and resistances.

        Returns
        -------
        scales : list of Scale
            One scale for each map.
        tiles : list of Tile
            Maps of the measurement, of each case, and of the truth if it is known.
        """
        first = cases[0]
        named = [("measured", as_recorded(first.measured[index], first.scene))]
        named += [(estimated(case, cases), case.cell_resistance[index]) for case in cases]
        if first.truth is not None:
            named.append(("truth", first.truth[index]))
        relative = getattr(first.scene.readout, "reference_ohm", None) == 1
        unit = "in reference resistors" if relative else f"[{first.scene.circuit.unit}]"
        tiles = [
            Tile(name, values if np.isfinite(values).any() else None) for name, values in named
        ]
        scales: list[Scale] = []
        for tile in tiles:
            label = f"resistance {unit.replace('volt', 'ohm')}" if scales else f"reading {unit}"
            values = values_of([tile])
            scales.append(log_scale(values, label, (1e-3, 1e12), "viridis_r"))
        return scales, tiles


@dataclass(frozen=True)
class ResidualPlot(MapsPlot):
    """Maps of the residuals, in standard deviations.

    Residuals are the readings of each estimator's cells less the measured ones. In percent of the
    reading where the noise is unknown. Cells that explain the readings leave noise of about 1. A
    pattern names a model that is wrong, or a penalty that is too strong.

    >>> lampest.ResidualPlot().kind
    'residuals'
    """

    kind = "residuals"
    about = "grey: no value was read"

    def maps(self, cases: Cases, index: int) -> Maps:
        """Return maps of the residuals.

        Returns
        -------
        scales : list of Scale
            Residual in standard deviations, or in percent if a case has no noise; for all maps.
        tiles : list of Tile
            One map for each case.
        """
        unit = "σ"
        label = "(model − measured) / noise σ"
        least = 3.0
        residuals = list(map(weighted_residual, cases))
        if any(case.sigma is None for case in cases):
            unit = "%"
            label = "(model − measured) / measured [%]"
            least = 0.1
            residuals = [percent_change(case.reading_model, case.measured) for case in cases]
        tiles = []
        for case, residual in zip(cases, residuals, strict=True):
            tile = Tile(case.estimator, None)
            if case.solved[index]:
                rms = float(np.sqrt(np.nanmean(residual[index] ** 2)))
                size = f"< {MIN_DIFFERENCE}" if rms < MIN_DIFFERENCE else digits(rms, 2)
                tile = Tile(case.estimator, residual[index], f"rms {size} {unit}")
            tiles.append(tile)
        return [signed_scale(values_of(tiles), label, least)], tiles


@dataclass(frozen=True)
class CertaintyPlot(MapsPlot):
    """Maps of standard deviation [%] and resolution of every estimator with error bars.

    If the truth is known, the error in units of the standard deviation is drawn, too.

    >>> lampest.CertaintyPlot().needs
    ('cell_resistance_errors', 'resolution')
    """

    kind = "certainty"
    needs = ("cell_resistance_errors", "resolution")
    about = "grey: no number (failed frame or open cell); 95 % intervals reach 1.96 sd"

    def maps(self, cases: Cases, index: int) -> Maps:
        """Return rows of standard deviations, resolutions, and errors.

        Returns
        -------
        scales : list of Scale
            One scale for each row; errors if the truth is known.
        tiles : list of Tile
            The maps, one for each case in each row.
        """
        cases = cases[:MAX_ACROSS]
        cells = np.stack([case.cell_resistance[index] for case in cases])
        errors, resolutions = (
            np.stack([case.column(name)[index] for case in cases]) for name in self.needs
        )
        deviations = 100 * errors / cells
        values = [deviations, resolutions]
        scales = [
            log_scale([deviations], "standard deviation [%]"),
            Scale(Normalize(0, 1), colormaps["YlGnBu"], "resolution"),
        ]
        truth = cases[0].truth
        if truth is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                values.append(100 * np.log(cells / truth[index]) / deviations)
            scales.append(signed_scale(values[2:], "error / standard deviation", 3.0, 5.0))
        titles = chain((case.estimator for case in cases), repeat(""))
        return scales, list(map(Tile, titles, chain.from_iterable(values)))


@dataclass(frozen=True)
class PressurePlot(MapsPlot):
    """Maps of pressure and of half its 95 % interval of every estimator.

    Crosses mark cells whose pressure the response cannot determine. The scales are the same for all
    recordings.

    >>> lampest.PressurePlot().kind
    'pressure'
    """

    kind = "pressure"
    needs = ("pressure", "pressure_lower", "pressure_upper", "saturated")
    hint = (
        "add the film's response to the scene, such as response: {kind: published}, and run again"
    )
    about = "grey: no number"

    def maps(self, cases: Cases, index: int) -> Maps:
        """Return rows of pressures and half widths of their intervals.

        Returns
        -------
        scales : list of Scale
            One scale for each row, in kPa.
        tiles : list of Tile
            The maps, one for each case in each row.
        """
        steps = (0.5, 1, 2, 5, 10, 20, 40)
        ticks = (-40, -10, -2, -0.5, 1, 5, 20)
        signed = stepped_scale(steps, "pressure [kPa]: suction − contact +", ticks, PRESSING)
        label = "half the 95 % interval [kPa]"
        decades = (0.1, 1.0, 10.0, 100.0)
        widths = Scale(LogNorm(0.1, 100), colormaps["YlGnBu"], label, decades)
        pressures = []
        halves = []
        for case in cases[:MAX_ACROSS]:
            pressure, lower, upper, saturated = (case.column(name)[index] for name in self.needs)
            # None and infinite: beyond the scale, not missing.
            half = np.clip((upper - lower) / 2, 0.05, 200)
            pressures.append(Tile(case.estimator, pressure, "", saturated != 0, "saturated"))
            halves.append(replace(pressures[-1], title="", values=half))
        return [signed, widths], pressures + halves


QUANTITIES = {  # figure of a case → label of its axis
    "cell error median [%]": "cell error, median [%]",
    "data error mean [%]": "data error, mean [%]",
}
DECADE = 10.0  # ratio of swept values from which their axis is logarithmic


@dataclass(frozen=True)
class SweepPlot(Plot):
    """Errors of cells and of readings over each swept number, a line for each estimator.

    Errors are those of all solved frames. Errors of cells are drawn where the truth is known. An
    estimator that was swept over further keys has a line for each of their values. Lines of
    estimators without swept numbers are dashed. Errors below 0.001 % are drawn at 0.001 %.

    >>> lampest.SweepPlot().kind
    'sweep'
    """

    kind = "sweep"

    def drawable(self, cases: Cases) -> tuple[CaseResult, ...]:
        """Return all cases, if a number was swept in any of them."""
        return tuple(cases) if swept_numbers(cases) else ()

    def draw(self, cases: Cases) -> Figure:
        """Draw a column for each swept key and a row for each quantity."""
        keys = swept_numbers(cases)
        quantities = _swept_errors(cases)
        figure = new_figure(0.7 + 2.1 * len(quantities))
        grid = figure.subplots(
            len(quantities), len(keys), squeeze=False, sharex="col", sharey="row"
        )
        for axes_row, (name, errors) in zip(grid, quantities.items(), strict=True):
            for axes, key in zip(axes_row, keys, strict=True):
                self._draw_lines(axes, key, cases, errors)
                below = key if name == [*quantities][-1] else ""
                dressed(axes, below, QUANTITIES[name] if key == keys[0] else "")
        shared_legend(figure, grid, "lower center", ncols=3)
        return labelled(figure, "", "", cases[0].recording)

    def draw_on(self, axes: Axes, cases: Cases) -> None:
        """Draw the first quantity over the first swept key."""
        name, errors = next(iter(_swept_errors(cases).items()))
        key = swept_numbers(cases)[0]
        self._draw_lines(axes, key, cases, errors)
        dressed(axes, key, QUANTITIES[name])
        axes.legend(fontsize=SMALL_POINT)

    def _draw_lines(
        self, axes: Axes, key: str, cases: Cases, errors: Sequence[float | None]
    ) -> None:
        """Draw the errors of cases over the values of a key.

        An estimator without swept numbers has a dashed line.
        """
        estimators = list(dict.fromkeys(case.unswept_name for case in cases))
        keys = swept_numbers(cases)
        lines: dict[tuple[str, ...], list[tuple[Any, float]]] = {}
        for case, error in zip(cases, errors, strict=True):
            if error is not None and (key in case.swept or case.swept.keys().isdisjoint(keys)):
                further = (
                    f"{swept} {value}" for swept, value in case.swept.items() if swept != key
                )
                point = case.swept.get(key), max(error, MIN_DIFFERENCE)
                lines.setdefault((case.unswept_name, *further), []).append(point)
        for name, points in lines.items():
            look: dict[str, Any] = {
                "color": f"C{estimators.index(name[0]) % 10}",
                "lw": 1,
                "label": ", ".join(name),
            }
            if points[0][0] is None:
                axes.axhline(points[0][1], ls="--", **look)
            else:
                axes.plot(*zip(*sorted(points), strict=True), "o-", ms=3, **look)
        values = [case.swept[key] for case in cases if key in case.swept]
        if 0 < DECADE * min(values) <= max(values):
            axes.set_xscale("log")
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(PLAIN_NUMBER)
            axis.set_minor_formatter("")
        axes.set_ylim(self.vmin, self.vmax)


def _swept_errors(cases: Cases) -> dict[str, list[float | None]]:
    """Return the errors of cases by the names of QUANTITIES, without those that no case has."""
    figures = [figures_of(case, case.solved) for case in cases]
    errors = {name: [figure[name] for figure in figures] for name in QUANTITIES}
    return {name: known for name, known in errors.items() if {*known} != {None}}


def swept_numbers(cases: Cases) -> tuple[str, ...]:
    """Return the keys for which several numbers were swept."""
    numbers: dict[str, set[float]] = {}
    for case in cases:
        for key, value in case.swept.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                numbers.setdefault(key, set()).add(value)
    return tuple(key for key, values in numbers.items() if len(values) > 1)
