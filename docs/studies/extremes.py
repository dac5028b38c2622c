"""Heat map of extreme scenes, beside the table of `lampest study extremes`.

python -m docs.studies.extremes [configs/extremes.yaml] --out results/extremes
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from docs.studies import script
from lampest.apps.studies.extreme_scenes import CASES, GRID
from lampest.apps.studies.extremes import STUDY, Solve
from lampest.report.compare import grouped
from lampest.report.plots.style import ORANGE, RAISED, SMALL_POINT, TEXT_POINT, new_figure

COLOURS = "YlGnBu"


def extremes_figure(solves: Sequence[Solve]) -> Figure:
    """Draw cases × formulation and noise for every method.

    Numbers count solves without a verified optimum, orange with a crash or a doubtful estimate.
    White: not tried.
    """
    methods = list(dict.fromkeys(solve.method for solve in solves if solve.method))
    titles = list(dict.fromkeys(map(_title, solves)))
    columns = sorted(
        {_column(solve) for solve in solves if solve.formulation},
        key=lambda solve: (solve[0] != "reduced", solve),
    )
    figure = new_figure(0.165 * len(titles) + 1.5)
    grid = figure.subplots(1, len(methods), squeeze=False, sharey=True)[0]
    for axes, method in zip(grid, methods, strict=True):
        own = [solve for solve in solves if solve.method == method]
        cells = grouped(own, lambda solve: (_title(solve), *_column(solve)))
        _fill(axes, [[cells.get((title, *column), []) for column in columns] for title in titles])
        axes.set_xticks(np.arange(len(columns)), [f"{100 * noise:g}" for _, noise in columns])
        axes.set_yticks(np.arange(len(titles)), titles)
        axes.set_xlabel("noise [%]", fontsize=TEXT_POINT)
        axes.set_title(f"{method}\n", fontsize=TEXT_POINT)
        for formulation, places in grouped(
            range(len(columns)), lambda place: columns[place][0]
        ).items():
            axes.text(
                np.mean(places), -0.7, formulation, fontsize=SMALL_POINT, ha="center", va="bottom"
            )
            axes.axvline(places[0] - 0.5, color="0.3", lw=0.8)
    colours = ScalarMappable(Normalize(0, 100), COLOURS)
    bar = figure.colorbar(colours, ax=grid, location="bottom", aspect=60, shrink=0.6, pad=0.01)
    bar.set_label(
        "share of solves with a verified optimum [%]; numbers: how many without; white: not tried",
        fontsize=TEXT_POINT,
    )
    bar.ax.tick_params(labelsize=SMALL_POINT)
    return figure


def _title(solve: Solve) -> str:
    name = f"{solve.rows} × {solve.columns}" if solve.case == GRID else solve.case
    return (
        f"{name}, 10{f'{solve.decades:g}'.translate(RAISED)}"
        if CASES[solve.case].contrasted
        else name
    )


def _column(solve: Solve) -> tuple[str, float]:
    return solve.formulation, solve.noise


def _fill(axes: Axes, table: list[list[list[Solve]]]) -> None:
    """Draw a square with its number of failures for every cell of the table.

    A square's colour is the share of verified solves.
    """
    share = [
        [np.mean([solve.verified for solve in solves]) if solves else np.nan for solves in line]
        for line in table
    ]
    shown: dict[str, Any] = {"shading": "nearest", "edgecolors": "white", "linewidth": 0.4}
    axes.pcolormesh(np.array(share, dtype=float), cmap=COLOURS, vmin=0, vmax=1, **shown)
    axes.set_ylim(len(table) - 0.5, -0.5)
    look: dict[str, Any] = {
        "ha": "center",
        "va": "center",
        "fontsize": SMALL_POINT,
        "fontweight": "bold",
    }
    for line, place in zip(*np.nonzero(np.array(share) < 1), strict=True):
        solves = table[line][place]
        alarm = any(solve.crashed or solve.doubtful for solve in solves)
        text = str(sum(not solve.verified for solve in solves))
        note = axes.text(place, line, text, color=ORANGE if alarm else "black", **look)
        note.set_path_effects([withStroke(linewidth=2, foreground="white")])
    axes.tick_params(labelsize=SMALL_POINT, length=1.5, pad=1.5)


if __name__ == "__main__":
    script.main(
        lambda options: replace(
            STUDY, figures=lambda solves: {"extremes": extremes_figure(solves)}
        ),
        script.parser_of(__doc__),
    )
