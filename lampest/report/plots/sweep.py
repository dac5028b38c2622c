"""Errors over the values of a sweep."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from lampest.report.compare import LEAST, figures_of
from lampest.report.plots import style
from lampest.report.plots.contours import Plot
from lampest.runs.case import CaseResult

QUANTITIES = {  # figure of a case → label of its axis
    "cell error median [%]": "cell error, median [%]",
    "data error mean [%]": "data error, mean [%]",
}
DECADE = 10.0  # ratio of swept values from which their axis is logarithmic


@dataclass(frozen=True)
class SweepPlot(Plot):
    """Errors of cells (where the truth is known) and of readings over each swept number, a line for each estimator.

    An estimator that was swept over further keys has a line for each of their values. Dashed: estimators without
    swept numbers. Errors below 0.001 % are drawn there. Of all solved frames.

    >>> lampest.SweepPlot().kind
    'sweep'
    """

    kind: ClassVar[str] = "sweep"

    def drawable(self, cases: Sequence[CaseResult]) -> tuple[CaseResult, ...]:
        """Return all cases, if a number was swept in any of them."""
        return tuple(cases) if swept_numbers(cases) else ()

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """Draw a column for each swept key and a row for each quantity."""
        keys, figures = swept_numbers(cases), [figures_of(case, case.solved) for case in cases]
        quantities = [name for name in QUANTITIES if any(figure[name] is not None for figure in figures)]
        figure = style.new_figure(0.7 + 2.1 * len(quantities))
        grid = figure.subplots(len(quantities), len(keys), squeeze=False, sharex="col", sharey="row")
        for axes_row, name in zip(grid, quantities, strict=True):
            for axes, key in zip(axes_row, keys, strict=True):
                _draw_lines(axes, key, cases, [each[name] for each in figures])
                style.dressed(axes, "", QUANTITIES[name] if axes is axes_row[0] else "")
        for axes, key in zip(grid[-1], keys, strict=True):
            style.dressed(axes, key, "")
        style.shared_legend(figure, grid, "lower center", ncols=3)
        return style.labelled(figure, "", "", cases[0].recording)


def swept_numbers(cases: Sequence[CaseResult]) -> tuple[str, ...]:
    """Return the keys of which several numbers were swept."""
    numbers: dict[str, set[float]] = {}
    for case in cases:
        for key, value in case.swept.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                numbers.setdefault(key, set()).add(value)
    return tuple(key for key, values in numbers.items() if len(values) > 1)


def _draw_lines(axes: Axes, key: str, cases: Sequence[CaseResult], errors: Sequence[float | None]) -> None:
    """Draw the errors of cases over the values of a key; a dashed line for an estimator without swept numbers."""
    estimators, keys = list(dict.fromkeys(case.unswept_name for case in cases)), swept_numbers(cases)
    lines: dict[tuple[str, ...], list[tuple[Any, float]]] = {}
    for case, error in zip(cases, errors, strict=True):
        if error is not None and (key in case.swept or case.swept.keys().isdisjoint(keys)):
            further = (f"{swept} {value}" for swept, value in case.swept.items() if swept != key)
            lines.setdefault((case.unswept_name, *further), []).append((case.swept.get(key), max(error, LEAST)))
    for name, points in lines.items():
        look: dict[str, Any] = {"color": f"C{estimators.index(name[0]) % 10}", "lw": 1, "label": ", ".join(name)}
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
        axis.set_major_formatter(FuncFormatter(style.plain_number))
        axis.set_minor_formatter("")
