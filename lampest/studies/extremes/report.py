"""The atlas' figures: by cell of the atlas as CSV, every solve as HDF5, and the promise in sentences."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from lampest.report.plots.style import ORANGE, RAISED, SMALL_POINT, TEXT_POINT, new_figure
from lampest.solvers.solution import VERIFIED
from lampest.studies import study
from lampest.studies.extremes.run import REFUSED, Solve, run_atlas
from lampest.studies.extremes.scenes import CASES, GRID, AtlasFile

COLOURS = "YlGnBu"


def _row(own: Sequence[Solve]) -> study.Row:
    """verified : estimates of which the audit says nothing bad; named : a sentence instead; doubtful : estimates that
    the audit does not confirm; crashed : neither; worse : estimates that cost more than the truth. Digits are the
    least, residuals the largest.
    """
    solved = [solve for solve in own if solve.solved]
    statuses = Counter(solve.status for solve in own).most_common()
    return study.Row(
        **{name: getattr(own[0], name) for name in ("case", "decades", "rows", "columns", "noise")},
        method=own[0].method,
        formulation=own[0].formulation,
        solves=len(own),
        verified=sum(solve.verified for solve in own),
        named=sum(not solve.solved and not solve.crashed for solve in own),
        doubtful=sum(solve.doubtful for solve in own),
        crashed=sum(solve.crashed for solve in own),
        worse=sum(solve.excess > VERIFIED for solve in solved),
        forward_digits=_of(min, own, "forward_digits"),
        model_digits=_of(min, solved, "model_digits"),
        residual=_of(max, solved, "residual"),
        audited=_of(max, solved, "audited"),
        iterations=float(np.median([solve.iterations for solve in own])),
        most_iterations=max(solve.iterations for solve in own),
        statuses="; ".join(f"{count} × {status}" for status, count in statuses),
    )


def _of(reduce: Callable[[Any], float], solves: Sequence[Solve], what: str) -> float:
    """The reduction of all numbers; NaN where there is none."""
    known = [value for solve in solves if np.isfinite(value := getattr(solve, what))]
    return float(reduce(known)) if known else float("nan")


atlas_rows = study.rows_by(  # for each cell of the atlas
    lambda one: (one.case, one.decades, one.shape, one.noise, one.method, one.formulation), _row
)
case_rows = study.rows_by(lambda one: (one.case, one.decades), _row)  # all methods, sizes and noises together
SCREEN: study.Screen = {
    "case": "{case}",
    "decades": lambda row: f"{row.decades:g}" if CASES[row.case].contrasted else "",
    "verified": "{verified}/{solves}",
    "named": lambda row: f"{row.named or ''}",
    "doubtful": lambda row: f"{row.doubtful or ''}",
    "crashed": lambda row: f"{row.crashed or ''}",
    "worse than truth": lambda row: f"{row.worse or ''}",
    "digits: forward": "{forward_digits:.1f}",
    "model": "{model_digits:.1f}",
    "worst KKT": "{residual:.0e}",
    "audited": "{audited:.0e}",
    "iterations (most)": "{iterations:.0f} ({most_iterations})",
}


def mild(solve: Solve) -> bool:
    """Whether a verified optimum is promised: noise up to 1 %, and a contrast up to 10⁶ or a single fault."""
    case = CASES[solve.case]
    return ((case.contrasted and solve.decades <= 6) or case.single_fault) and solve.noise <= 0.01


def atlas_remarks(solves: Sequence[Solve]) -> list[str]:
    """The promise in numbers, and how the others ended."""
    named = sum(not solve.crashed and not solve.doubtful for solve in solves)
    tame = [solve for solve in solves if mild(solve)]
    lines = [_share(named, len(solves), "solves end with a verified optimum or a sentence")]
    for title, chosen in (
        ("all", solves),
        ("contrast up to 10⁶ or a single fault, noise up to 1 %", tame),
        *((f"  {case}", own) for case, own in study.grouped(tame, lambda solve: solve.case).items()),
    ):
        lines.append(f"{title}: {_share(sum(solve.verified for solve in chosen), len(chosen), 'verified')}")
    # A refusal without the numbers of its scene.
    kinds = (solve.status.split(":")[0] if solve.status.startswith(REFUSED) else solve.status for solve in solves)
    ended = Counter(kind for kind, solve in zip(kinds, solves, strict=True) if not solve.solved)
    return lines + [f"{count} × {status}" for status, count in ended.most_common()]


def _share(part: int, whole: int, what: str) -> str:
    return f"{part} of {whole} {what} ({f'{100 * part / whole:.2f} %' if whole else 'none tried'})"


def extremes_figure(found: Sequence[Solve]) -> Figure:
    """Cases × formulation and noise, for every method, random panels by size and decades first.

    A number is how many solves have no verified optimum; orange where any of them gives no reason or a wrong estimate.
    White: not tried.
    """
    methods = list(dict.fromkeys(solve.method for solve in found if solve.method))
    titles = list(dict.fromkeys(map(_title, found)))
    columns = sorted(
        {_column(solve) for solve in found if solve.formulation}, key=lambda one: (one[0] != "reduced", one)
    )
    figure = new_figure(0.165 * len(titles) + 1.5)
    grid = figure.subplots(1, len(methods), squeeze=False, sharey=True)[0]
    for axes, method in zip(grid, methods, strict=True):
        cells = study.grouped([one for one in found if one.method == method], lambda one: (_title(one), *_column(one)))
        _fill(axes, [[cells.get((title, *column), []) for column in columns] for title in titles])
        axes.set_xticks(np.arange(len(columns)), [f"{100 * noise:g}" for _, noise in columns])
        axes.set_yticks(np.arange(len(titles)), titles)
        axes.set_xlabel("noise [%]", fontsize=TEXT_POINT)
        axes.set_title(f"{method}\n", fontsize=TEXT_POINT)
        for formulation, places in study.grouped(range(len(columns)), lambda place: columns[place][0]).items():
            axes.text(np.mean(places), -0.7, formulation, fontsize=SMALL_POINT, ha="center", va="bottom")
            axes.axvline(places[0] - 0.5, color="0.3", lw=0.8)
    colours = ScalarMappable(Normalize(0, 100), COLOURS)
    bar = figure.colorbar(colours, ax=grid, location="bottom", aspect=60, shrink=0.6, pad=0.01)
    bar.set_label(
        "share of solves with a verified optimum [%]; numbers: how many without; white: not tried", fontsize=TEXT_POINT
    )
    bar.ax.tick_params(labelsize=SMALL_POINT)
    return figure


def _title(solve: Solve) -> str:
    name = f"{solve.rows} × {solve.columns}" if solve.case == GRID else solve.case
    return f"{name}, 10{f'{solve.decades:g}'.translate(RAISED)}" if CASES[solve.case].contrasted else name


def _column(solve: Solve) -> tuple[str, float]:
    return solve.formulation, solve.noise


def _fill(axes: Axes, table: list[list[list[Solve]]]) -> None:
    """A square for every cell of the table, coloured by its share, with a number where that is not all."""
    share = [[np.mean([one.verified for one in solves]) if solves else np.nan for solves in line] for line in table]
    shown: dict[str, Any] = {"shading": "nearest", "edgecolors": "white", "linewidth": 0.4}
    axes.pcolormesh(np.array(share, dtype=float), cmap=COLOURS, vmin=0, vmax=1, **shown)
    axes.set_ylim(len(table) - 0.5, -0.5)
    look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL_POINT, "fontweight": "bold"}
    for line, column in zip(*np.nonzero(np.array(share) < 1), strict=True):
        solves = table[line][column]
        alarm = any(solve.crashed or solve.doubtful for solve in solves)
        text = str(sum(not solve.verified for solve in solves))
        note = axes.text(column, line, text, color=ORANGE if alarm else "black", **look)
        note.set_path_effects([withStroke(linewidth=2, foreground="white")])
    axes.tick_params(labelsize=SMALL_POINT, length=1.5, pad=1.5)


STUDY: study.Study[AtlasFile, Sequence[Solve]] = study.Study(
    "extremes",
    "scenes",
    "extremes.yaml",
    study.read_settings(AtlasFile),
    run_atlas,
    rows=atlas_rows,
    tables=lambda found: [("", study.screen_table(case_rows(found), SCREEN))],
    form="extremes/2",
    records=lambda found: [study.RecordGroup("solves", found, "solved", attributes={"verified_below": VERIFIED})],
    figures=lambda found: {"extremes": extremes_figure(found)},
    remarks=atlas_remarks,
)
