"""The atlas' figures: by cell of the atlas as CSV, every solve as HDF5, and the promise in sentences."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from lampest.files import hdf5
from lampest.report.compare import Table
from lampest.report.plots.style import ORANGE, RAISED, SMALL_POINT, TEXT_POINT, new_figure
from lampest.solvers.solution import VERIFIED
from lampest.studies import study
from lampest.studies.extremes.run import COLUMNS, REFUSED, Solve, run_atlas
from lampest.studies.extremes.scenes import CASES, GRID, AtlasFile

COLOURS = "YlGnBu"
PLAIN = str.maketrans({"⁶": "^6", "×": "x", "Ω": "ohm"})  # HDF5 text is ASCII


def atlas_rows(solves: Sequence[Solve]) -> list[study.Row]:
    """A row for each cell of the atlas, in its order: a case with a contrast, size, noise, method and formulation."""

    def cell(solve: Solve) -> tuple[Any, ...]:
        own = solve.sample
        return own.case, own.decades, own.rows, own.columns, own.noise, solve.method, solve.formulation

    return study.rows_of(study.grouped(solves, cell).values(), FIGURES)


def _count(what: str) -> Callable[[Sequence[Solve]], int]:
    return lambda own: sum(getattr(solve, what) for solve in own)


def _of(reduce: Callable[[Any], Any], what: str, estimates: bool = True) -> Callable[[Sequence[Solve]], float]:
    """The reduction of all numbers, by default of estimates; NaN where there is none."""

    def reduced(own: Sequence[Solve]) -> float:
        values = [getattr(solve, what) for solve in own if solve.solved or not estimates]
        known = [value for value in values if np.isfinite(value)]
        return float(reduce(known)) if known else float("nan")

    return reduced


def _statuses(own: Sequence[Solve]) -> str:
    counted = Counter(solve.status for solve in own)
    return "; ".join(f"{count} × {status}" for status, count in counted.most_common())


FIGURES: study.Figures = {
    "case": lambda own: own[0].sample.case,
    "decades": lambda own: own[0].sample.decades,
    "rows": lambda own: own[0].sample.rows,
    "columns": lambda own: own[0].sample.columns,
    "noise": lambda own: own[0].sample.noise,
    "method": lambda own: own[0].method,
    "formulation": lambda own: own[0].formulation,
    "solves": len,
    "verified": _count("verified"),  # an estimate of which the audit says nothing bad
    "named": lambda own: sum(not solve.solved and not solve.crashed for solve in own),  # a sentence instead
    "doubtful": _count("doubtful"),  # estimates that the audit does not confirm
    "crashed": _count("crashed"),  # neither
    "worse": lambda own: sum(solve.solved and solve.excess > VERIFIED for solve in own),  # cost more than the truth
    "forward_digits": _of(np.min, "forward_digits", False),
    "model_digits": _of(np.min, "model_digits"),
    "estimate_digits": _of(np.min, "estimate_digits"),
    "median_digits": _of(np.median, "estimate_digits"),
    "residual": _of(np.max, "residual"),
    "audited": _of(np.max, "audited"),
    "iterations": lambda own: float(np.median([solve.iterations for solve in own])),
    "most_iterations": lambda own: max(solve.iterations for solve in own),
    "statuses": _statuses,
}


def _estimate_digits(row: study.Row) -> str:
    least = study.text_of(row.estimate_digits, ".1f")
    return least and f"{least} ({study.text_of(row.median_digits, '.1f')})"


SCREEN: dict[str, Callable[[study.Row], str]] = {
    "case": lambda row: row.case,
    "decades": lambda row: f"{row.decades:g}" if CASES[row.case].contrasted else "",
    "verified": lambda row: f"{row.verified}/{row.solves}",
    "named": lambda row: f"{row.named or ''}",
    "doubtful": lambda row: f"{row.doubtful or ''}",
    "crashed": lambda row: f"{row.crashed or ''}",
    "worse than truth": lambda row: f"{row.worse or ''}",
    "digits: forward": lambda row: study.text_of(row.forward_digits, ".1f"),
    "model": lambda row: study.text_of(row.model_digits, ".1f"),
    "estimate (median)": _estimate_digits,
    "worst KKT": lambda row: study.text_of(row.residual, ".0e"),
    "audited": lambda row: study.text_of(row.audited, ".0e"),
    "iterations (most)": lambda row: f"{row.iterations:.0f} ({row.most_iterations})",
}


def atlas_table(solves: Sequence[Solve]) -> Table:
    """A line for every number of decades of the random panels and for every other case, all methods together."""
    groups = study.grouped(solves, lambda solve: (solve.sample.case, solve.sample.decades))
    return study.screen_table(study.rows_of(groups.values(), FIGURES), SCREEN)


def mild(solve: Solve) -> bool:
    """Whether a verified optimum is promised: noise up to 1 %, and a contrast up to 10⁶ or a single fault."""
    case = CASES[solve.sample.case]
    contrast = case.contrasted and solve.sample.decades <= 6
    return (contrast or case.single_fault) and solve.sample.noise <= 0.01


def atlas_remarks(solves: Sequence[Solve]) -> list[str]:
    """The promise in numbers, and how the others ended."""
    named = sum(not solve.crashed and not solve.doubtful for solve in solves)
    tame = [solve for solve in solves if mild(solve)]
    share = _share(named, len(solves))
    lines = [f"{named} of {len(solves)} solves end with a verified optimum or a sentence ({share})"]
    for title, chosen in (
        ("all", list(solves)),
        ("contrast up to 10⁶ or a single fault, noise up to 1 %", tame),
        *((f"  {case}", own) for case, own in study.grouped(tame, lambda solve: solve.sample.case).items()),
    ):
        good = sum(solve.verified for solve in chosen)
        lines.append(f"{title}: {good} of {len(chosen)} verified ({_share(good, len(chosen))})")
    ended = Counter(_kind(solve.status) for solve in solves if not solve.solved)
    lines += [f"{count} × {status}" for status, count in ended.most_common()]
    return lines


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f} %" if whole else "none tried"


def _kind(status: str) -> str:
    """A refusal without the numbers of its scene."""
    return status.split(":")[0] + ": the input" if status.startswith(REFUSED) else status


def extremes_figure(found: Sequence[Solve]) -> Figure:
    """Above: random panels, decades × noise for every method and size. Below: the other cases, a row for each.

    A number is how many solves have no verified optimum; orange where any of them gives no reason or a wrong estimate.
    White: not tried.
    """
    side = 0.165  # of a square, inch
    grid = [solve for solve in found if solve.sample.case == GRID]
    cases = [solve for solve in found if solve.sample.case != GRID]
    methods = list(dict.fromkeys(solve.method for solve in found if solve.method))
    panels = list(study.grouped(grid, _panel))
    noises = sorted({solve.sample.noise for solve in grid})
    names = list(study.grouped(cases, _case))
    high = [len(panels) * (len(noises) * side + 0.32), len(names) * side + 0.2]
    figure = new_figure(sum(high) + 1.3)
    halves: Any = figure.subfigures(2, 1, height_ratios=[max(part, 0.1) for part in high], hspace=0.02)
    above, below = halves
    if grid:
        _draw_grid(above, grid, methods, panels, noises)
    if cases:
        _draw_cases(below, cases, methods, names)
    last = below if cases else above
    colours = ScalarMappable(Normalize(0, 100), COLOURS)
    bar = last.colorbar(colours, ax=last.axes, location="bottom", aspect=60, shrink=0.6, pad=0.01)
    bar.set_label(
        "share of solves with a verified optimum [%]; numbers: how many without; white: not tried", fontsize=TEXT_POINT
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
            cells = study.grouped(chosen, lambda solve: (solve.sample.noise, solve.sample.decades))
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
        cells = study.grouped(chosen, lambda solve: (_case(solve), solve.formulation, solve.sample.noise))
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
    """A square for every cell of the table, coloured by its share, with a number where that is not all."""
    share = [[np.mean([one.verified for one in solves]) if solves else np.nan for solves in line] for line in table]
    shown: dict[str, Any] = {"shading": "nearest", "edgecolors": "white", "linewidth": 0.4}
    axes.pcolormesh(np.array(share, dtype=float), cmap=COLOURS, vmin=0, vmax=1, **shown)
    axes.set_ylim(len(table) - 0.5, -0.5)
    look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL_POINT, "fontweight": "bold"}
    for line, column in zip(*np.nonzero(np.array(share) < 1), strict=True):
        solves = table[line][column]
        text = str(sum(not solve.verified for solve in solves))
        alarm = any(solve.crashed or solve.doubtful for solve in solves)
        note = axes.text(column, line, text, color=ORANGE if alarm else "black", **look)
        note.set_path_effects([withStroke(linewidth=2, foreground="white")])
    axes.tick_params(labelsize=SMALL_POINT, length=1.5, pad=1.5)


def _write_solves(entry: Any, found: Sequence[Solve]) -> None:
    """/entry/solves: every solve, in the order of the atlas."""
    axis = ("solve", "solve, in the order of the atlas")
    plain = [replace(one, sample=replace(one.sample, case=one.sample.case.translate(PLAIN))) for one in found]
    hdf5.set_attributes(entry, verified_below=VERIFIED)
    study.write_sequence(entry, "solves", "verified", axis, plain, COLUMNS)


STUDY: study.Study[AtlasFile, Sequence[Solve]] = study.Study(
    "extremes",
    "scenes",
    "extremes.yaml",
    study.read_settings(AtlasFile),
    run_atlas,
    FIGURES,
    atlas_rows,
    lambda found: [("", atlas_table(found))],
    "extremes/1",
    _write_solves,
    lambda found: {"extremes": extremes_figure(found)},
    remarks=atlas_remarks,
)
