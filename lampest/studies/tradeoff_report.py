"""Report of a trade-off between speed and accuracy: rows, table, and a figure with Pareto fronts."""

from collections.abc import Sequence
from string import ascii_lowercase
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lampest.report.compare import Table
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, dressed, new_figure
from lampest.studies import study
from lampest.studies.common import MIN_GAP
from lampest.studies.tradeoff import Plan, TradeoffFrame, read_plan, run_tradeoff

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
SCREEN: study.Screen = {
    "panel": "{rows} × {columns}",
    "method": "{method}",
    "formulation": "{formulation}",
    "first [ms]": "{first_ms:.3g}",
    "frame [ms]": "{frame_ms:.3g}",
    "cell error [%]": "{cell_error:.3g}",
    "of changed cells [%]": "{changed_error:.3g}",
    "gap median / worst": "{gap:.0e} / {worst_gap:.0e}",
    "reached [%]": lambda row: f"{100 * row.reached:.0f}",
    "failed": "{failed}/{frames}",
    "memory [MB]": "{memory_mb:.0f}",
    "front": "{front}",
}


def ladder_rows(frames: Sequence[TradeoffFrame], *names: str) -> list[study.Row]:
    """Return a row for each panel size, formulation and further named fields."""
    by = ("shape", "solver", *names)
    return study.rows_by(lambda frame: tuple(getattr(frame, name) for name in by), _row)(frames)


def _row(own: Sequence[TradeoffFrame]) -> study.Row:
    """Return medians over frames. first_ms : with the baseline. reached : share of frames with a gap up to 1e-6."""

    def common(name: str) -> str:
        different = list(dict.fromkeys(getattr(frame, name) for frame in own))
        return different[0] if len(different) == 1 else "all"

    def median(name: str) -> float | None:
        known = [value for frame in own if np.isfinite(value := getattr(frame, name))]
        return float(np.median(known)) if known else None

    gaps = [frame.gap if np.isfinite(frame.gap) else np.inf for frame in own]
    return study.Row(
        **study.named_values(own[0], "rows", "columns"),
        **{name: common(name) for name in ("recording", "method")},
        formulation=own[0].solver,
        first_ms=1e3 * float(np.median([frame.baseline_s + frame.seconds for frame in own if not frame.frame])),
        frame_ms=1e3 * float(np.median([frame.seconds for frame in own if frame.frame])),
        cell_error=median("cell_error"),
        changed_error=median("changed_error"),
        gap=float(np.median(gaps)),
        worst_gap=max(gaps),
        reached=float(np.mean(np.array(gaps) <= 1e-6)),
        frames=len(own),
        failed=sum(not frame.solved for frame in own),
        memory_mb=own[0].memory_mb,
    )


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the Pareto front, smaller being better, ordered by the first coordinate."""
    best, indices = float("inf"), []
    for index in sorted(range(len(points)), key=lambda index: points[index]):
        if points[index][1] < best:
            best = points[index][1]
            indices.append(index)
    return indices


def on_front(rows: Sequence[study.Row]) -> list[str]:
    """Return the formulations on the front of time and cell error, or of time and gap."""
    fastest = set(front([(row.frame_ms, row.gap) for row in rows]))
    errors = [(row.frame_ms, float("inf") if row.changed_error is None else row.changed_error) for row in rows]
    return [rows[index].formulation for index in sorted(fastest | set(front(errors)))]


def tradeoff_table(frames: Sequence[TradeoffFrame]) -> Table:
    """Return the rows of the first method, with marks on those on a front."""
    rows = ladder_rows([frame for frame in frames if frame.method == frames[0].method])
    for own in study.grouped(rows, _shape).values():
        best = on_front(own)
        for row in own:
            row.front = "*" * (row.formulation in best)
    return study.screen_table(rows, SCREEN)


def _shape(row: study.Row) -> tuple[int, int]:
    return row.rows, row.columns


def tradeoff_figure(rows: Sequence[study.Row]) -> Figure:
    """Draw the error of changed cells and the gap over time, for every panel size.

    Numbers are the formulations of the first method, the line is their Pareto front, small dots are further methods.
    Gaps below 1e-12 are drawn there. rows : of all methods, recordings of a size together.
    """
    sizes = study.grouped(rows, _shape)
    methods, rungs = (list(dict.fromkeys(getattr(row, name) for row in rows)) for name in ("method", "formulation"))
    figure = new_figure(2.2 * len(sizes) + 0.8)
    grid = figure.subplots(len(sizes), 2, squeeze=False, sharex="row")
    letters = iter(ascii_lowercase)
    for (shape, own), pair in zip(sizes.items(), grid, strict=True):
        for axes, what in zip(pair, ("changed_error", "gap"), strict=True):
            _draw(axes, own, methods, rungs, what)
            axes.set_title(f"({next(letters)}) {shape[0]} × {shape[1]} cells", fontsize=TEXT_POINT, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("time per frame [ms]", fontsize=TEXT_POINT)
    handles, labels = grid[0, 1].get_legend_handles_labels()
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": len(handles)}
    named = "    ".join(f"{number} {name.replace('_', ' ')}" for number, name in enumerate(rungs, 1))
    figure.legend(handles, labels, title=named, title_fontsize=SMALL_POINT, loc="outside lower center", **look)
    return figure


def _draw(axes: Axes, rows: Sequence[study.Row], methods: list[str], rungs: list[str], what: str) -> None:
    dressed(axes, "", {"gap": "objective gap", "changed_error": "median error of changed cells [%]"}[what])
    axes.set_xscale("log")
    axes.set_yscale("log")
    known = [row for row in rows if getattr(row, what) is not None and np.isfinite(getattr(row, what))]
    places = {(row.method, row.formulation): (row.frame_ms, max(getattr(row, what), MIN_GAP)) for row in known}
    for method, colour in zip(methods[1:], COLOURS, strict=False):
        if points := [place for (own, _), place in places.items() if own == method]:
            axes.plot(*zip(*points, strict=True), "o", label=method, color=colour, ms=2.8, mew=0, alpha=0.75)
    points = [place for (own, _), place in places.items() if own == methods[0]]
    if not points:
        axes.text(0.5, 0.5, "no truth", transform=axes.transAxes, ha="center", fontsize=TEXT_POINT)
        return
    best = [points[index] for index in front(points)]
    axes.step(*zip(*best, strict=True), where="post", color="0.3", lw=0.9, label=f"{methods[0]}: Pareto front")
    for (own, rung), point in places.items():
        if own == methods[0]:
            fill, ink = ("black", "white") if point in best else ("white", "black")
            axes.plot(*point, "o", ms=8, mfc=fill, mec="black", mew=0.8, zorder=3)
            look: dict[str, Any] = {"color": ink, "ha": "center", "va": "center_baseline", "zorder": 4}
            axes.annotate(str(rungs.index(rung) + 1), point, fontsize=SMALL_POINT - 1, **look)
    if min(value for _, value in points) <= MIN_GAP:
        axes.axhline(MIN_GAP, color="0.5", lw=0.6, ls=":")
        axes.set_ylim(bottom=MIN_GAP / 30)
    axes.margins(0.12, 0.14)


STUDY: study.Study[Plan, list[TradeoffFrame]] = study.Study(
    "tradeoff",
    "measurements",
    "tradeoff.yaml",
    read_plan,
    run_tradeoff,
    rows=lambda frames: [
        *ladder_rows(frames),
        *ladder_rows(frames, "method"),
        *ladder_rows(frames, "method", "recording"),
    ],
    tables=lambda frames: [("", tradeoff_table(frames))],
    form="tradeoff/2",
    records=lambda frames: [study.RecordGroup("frames", frames, "seconds")],
    figures=lambda frames: {"tradeoff": tradeoff_figure(ladder_rows(frames, "method"))},
)
