"""The atlas of extremes as heat maps: the share of verified optima, with what is missing counted in the cells."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lampest.report.plots.style import RAISED, SMALL_POINT, TEXT_POINT, new_figure
from lampest.studies.extremes.run import Solve
from lampest.studies.extremes.scenes import CASES, GRID
from lampest.studies.study import grouped

COLOURS = colormaps["YlGnBu"].resampled(256)
ALARM = "#D55E00"
CELL_INCH = 0.165  # the side of a square


def extremes_figure(found: Sequence[Solve]) -> Figure:
    """Above: random panels, decades × noise for every method and size. Below: the other cases, a row for each.

    A hatched cell holds the number of solves without a verified optimum; an orange number where any of them gives
    no reason or a wrong estimate. White: not tried.
    """
    grid = [solve for solve in found if solve.sample.case == GRID]
    cases = [solve for solve in found if solve.sample.case != GRID]
    methods = list(dict.fromkeys(solve.method for solve in found if solve.method))
    panels = list(grouped(grid, _panel))
    noises = sorted({solve.sample.noise for solve in grid})
    names = list(grouped(cases, _case))
    high = [len(panels) * (len(noises) * CELL_INCH + 0.32), len(names) * CELL_INCH + 0.2]
    figure = new_figure(sum(high) + 1.3)
    halves: Any = figure.subfigures(2, 1, height_ratios=[max(part, 0.1) for part in high], hspace=0.02)
    above, below = halves
    if grid:
        _draw_grid(above, grid, methods, panels, noises)
    if cases:
        _draw_cases(below, cases, methods, names)
    last = below if cases else above
    bar = last.colorbar(
        ScalarMappable(Normalize(0, 100), COLOURS), ax=last.axes, location="bottom", aspect=60, shrink=0.6, pad=0.01
    )
    bar.set_label(
        "share of solves with a verified optimum [%]; hatched: how many without; white: not tried", fontsize=TEXT_POINT
    )
    bar.ax.tick_params(labelsize=SMALL_POINT)
    return figure


def _panel(solve: Solve) -> tuple[int, int, str]:
    return solve.sample.rows, solve.sample.columns, solve.formulation


def _case(solve: Solve) -> tuple[str, float]:
    return solve.sample.case, solve.sample.decades


def _draw_grid(
    figure: Any, grid: Sequence[Solve], methods: list[str], panels: list[tuple[int, int, str]], noises: list[float]
) -> None:
    decades = sorted({solve.sample.decades for solve in grid})
    axes = figure.subplots(len(panels), len(methods), squeeze=False, sharex=True, sharey=True)
    for line, panel in zip(axes, panels, strict=True):
        for own, method in zip(line, methods, strict=True):
            chosen = [solve for solve in grid if _panel(solve) == panel and solve.method == method]
            cells = grouped(chosen, lambda solve: (solve.sample.noise, solve.sample.decades))
            _fill(own, [[cells.get((noise, decade), []) for decade in decades] for noise in noises])
            own.set_xticks(np.arange(len(decades)), [f"{decade:g}" for decade in decades])
            own.set_yticks(np.arange(len(noises)), [f"{100 * noise:g}" for noise in noises])
            if panel == panels[0]:
                own.set_title(method, fontsize=TEXT_POINT)
            if panel == panels[-1]:
                own.set_xlabel("decades", fontsize=TEXT_POINT)
        line[0].set_ylabel(f"{panel[0]} × {panel[1]}\n{panel[2]}\nnoise [%]", fontsize=SMALL_POINT)


def _draw_cases(figure: Any, cases: Sequence[Solve], methods: list[str], names: list[tuple[str, float]]) -> None:
    formulations = list(dict.fromkeys(solve.formulation for solve in cases if solve.formulation))
    noises = sorted({solve.sample.noise for solve in cases})
    axes = figure.subplots(1, len(methods), squeeze=False, sharey=True)[0]
    columns = [(formulation, noise) for formulation in formulations for noise in noises]
    for own, method in zip(axes, methods, strict=True):
        chosen = [solve for solve in cases if solve.method == method]
        cells = grouped(chosen, lambda solve: (_case(solve), solve.formulation, solve.sample.noise))
        _fill(own, [[cells.get((name, *column), []) for column in columns] for name in names])
        own.set_xticks(np.arange(len(columns)), [f"{100 * noise:g}" for _, noise in columns])
        for number, formulation in enumerate(formulations):
            centre = (number + 0.5) * len(noises) - 0.5
            own.text(centre, -0.7, formulation, fontsize=SMALL_POINT, ha="center", va="bottom")
            if number:
                own.axvline(number * len(noises) - 0.5, color="0.3", lw=0.8)
        own.set_yticks(np.arange(len(names)), [_title(*name) for name in names])
        own.set_xlabel("noise [%]", fontsize=TEXT_POINT)
        own.set_title(f"{method}\n", fontsize=TEXT_POINT)


def _title(case: str, decades: float) -> str:
    return f"{case}, 10{str(int(decades)).translate(RAISED)}" if CASES[case].contrasted else case


def _fill(axes: Axes, table: list[list[list[Solve]]]) -> None:
    """A square for every cell of the table, coloured by its share, hatched and counted where that is not all."""
    for line, cells in enumerate(table):
        for place, solves in enumerate(cells):
            if not solves:
                continue
            missing = sum(not solve.verified for solve in solves)
            share = 1 - missing / len(solves)
            look: dict[str, Any] = {"hatch": "/////", "edgecolor": "0.6"} if missing else {"edgecolor": "white"}
            axes.add_patch(Rectangle((place - 0.5, line - 0.5), 1, 1, facecolor=COLOURS(share), linewidth=0.4, **look))
            if missing:
                alarm = any(solve.crashed or solve.doubtful for solve in solves)
                axes.text(
                    place,
                    line,
                    str(missing),
                    ha="center",
                    va="center",
                    fontsize=SMALL_POINT,
                    fontweight="bold",
                    color=ALARM if alarm else "black",
                    bbox={"boxstyle": "round,pad=0.08", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
                )
    axes.set_xlim(-0.5, max(len(cells) for cells in table) - 0.5)
    axes.set_ylim(len(table) - 0.5, -0.5)
    axes.tick_params(labelsize=SMALL_POINT, length=1.5, pad=1.5)
