"""The trade between speed and accuracy: rows, table, samples, and a figure with the Pareto fronts."""

from collections.abc import Callable, Sequence
from string import ascii_lowercase
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lampest.files import hdf5
from lampest.report.compare import Table
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, dressed, new_figure
from lampest.studies import study
from lampest.studies.timing import NO_GAP
from lampest.studies.tradeoff import Measured, Plan, read_plan, run_tradeoff

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
Group = Sequence[Measured]


def _one(name: Callable[[Measured], str]) -> Callable[[Group], str]:
    """What all have in common; 'all' where they differ."""

    def only(own: Group) -> str:
        different = list(dict.fromkeys(map(name, own)))
        return different[0] if len(different) == 1 else "all"

    return only


def _over(what: str, own: Group) -> Any:
    """A figure of all frames; a failed frame's gap is infinite."""
    values = np.concatenate([getattr(one, what) for one in own])
    return np.nan_to_num(values, nan=np.inf) if what == "gap" else values


def _median(what: str) -> Callable[[Group], float | None]:
    def median(own: Group) -> float | None:
        values = _over(what, own)
        values = values[np.isfinite(values)]
        return float(np.median(values)) if len(values) else None

    return median


FIGURES: study.Figures = {
    "rows": lambda own: own[0].shape[0],
    "columns": lambda own: own[0].shape[1],
    "recording": _one(lambda one: one.subject.recording.name),
    "scene": _one(lambda one: one.subject.scene),
    "noise": _one(lambda one: one.subject.noise),
    "method": _one(lambda one: one.method),
    "formulation": lambda own: own[0].formulation,
    "first_ms": lambda own: 1e3 * float(np.median([one.baseline_s + one.times()[0] for one in own])),  # with baseline
    "frame_ms": lambda own: 1e3 * float(np.median(np.concatenate([one.times()[1:] for one in own]))),
    "cell_error": _median("cell_error"),  # over frames of a frame's median, percent; None without a truth
    "changed_error": _median("changed_error"),  # the same of cells that have changed
    "gap": lambda own: float(np.median(_over("gap", own))),
    "worst_gap": lambda own: float(np.max(_over("gap", own))),
    "reached": lambda own: float(np.mean(_over("gap", own) <= 1e-6)),  # share of the frames
    "frames": lambda own: len(_over("gap", own)),
    "failed": lambda own: int(np.sum(~_over("solved", own))),
    "memory_mb": lambda own: own[0].memory_mb,  # peak of a fresh process, libraries included
}
SCREEN: dict[str, Callable[[study.Row], str]] = {
    "panel": lambda row: f"{row.rows} × {row.columns}",
    "method": lambda row: row.method,
    "formulation": lambda row: row.formulation,
    "first [ms]": lambda row: f"{row.first_ms:.3g}",
    "frame [ms]": lambda row: f"{row.frame_ms:.3g}",
    "cell error [%]": lambda row: study.text_of(row.cell_error),
    "of changed cells [%]": lambda row: study.text_of(row.changed_error),
    "gap median / worst": lambda row: f"{row.gap:.0e} / {row.worst_gap:.0e}",
    "reached [%]": lambda row: f"{100 * row.reached:.0f}",
    "failed": lambda row: f"{row.failed}/{row.frames}",
    "memory [MB]": lambda row: study.text_of(row.memory_mb, ".0f"),
}


def summary_rows(own: Group) -> list[study.Row]:
    """By panel size and rung, all that is given together."""
    groups = study.grouped(own, lambda one: (one.shape, one.formulation))
    shapes = list(study.grouped(own, lambda one: one.shape))
    ordered = sorted(groups, key=lambda both: shapes.index(both[0]))
    return study.rows_of([groups[both] for both in ordered], FIGURES)


def method_rows(found: Group) -> list[study.Row]:
    """By method, panel size and rung, all recordings together; the file's first method first."""
    return [row for own in study.grouped(found, lambda one: one.method).values() for row in summary_rows(own)]


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates, smaller being better, by the first one."""
    best, kept = float("inf"), []
    for index in sorted(range(len(points)), key=lambda index: points[index]):
        if points[index][1] < best:
            best = points[index][1]
            kept.append(index)
    return kept


def on_front(rows: Sequence[study.Row]) -> list[str]:
    """Rungs of one size that no other beats, in time together with cell error, or in time together with the gap."""
    kept = set(front([(row.frame_ms, row.gap) for row in rows]))
    errors = [(row.frame_ms, float("inf") if row.changed_error is None else row.changed_error) for row in rows]
    return [rows[index].formulation for index in sorted(kept | set(front(errors)))]


def tradeoff_table(found: Group) -> Table:
    """The first method's rows, those on a front marked."""
    rows = summary_rows([one for one in found if one.method == found[0].method])
    fronts = {shape: on_front(own) for shape, own in study.grouped(rows, _shape).items()}
    marked = {"front": lambda row: "*" * (row.formulation in fronts[_shape(row)])}
    return study.screen_table(rows, SCREEN | marked)


def _shape(row: study.Row) -> tuple[int, int]:
    return row.rows, row.columns


def tradeoff_figure(rows: Sequence[study.Row]) -> Figure:
    """A row of panels for every size: time against the changed cells' error, and against the gap.

    rows : of all methods, all recordings of a size together. The numbers are the first method's rungs, the line is
    their Pareto front, and small dots are the other methods' rungs. Gaps below 1e-12 are drawn there.
    """
    sizes = study.grouped(rows, _shape)
    methods, rungs = (list(dict.fromkeys(getattr(row, name) for row in rows)) for name in ("method", "formulation"))
    figure = new_figure(2.2 * len(sizes) + 0.8)
    grid = figure.subplots(len(sizes), 2, squeeze=False, sharex="row")
    letters = iter(ascii_lowercase)
    for (shape, own), pair in zip(sizes.items(), grid, strict=True):
        for axes, gap in zip(pair, (False, True), strict=True):
            _draw(axes, own, methods, rungs, gap)
            axes.set_title(f"({next(letters)}) {shape[0]} × {shape[1]} cells", fontsize=TEXT_POINT, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("time per frame [ms]", fontsize=TEXT_POINT)
    handles, labels = grid[0, 1].get_legend_handles_labels()
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": len(handles)}
    named = "    ".join(f"{number} {name.replace('_', ' ')}" for number, name in enumerate(rungs, 1))
    figure.legend(handles, labels, title=named, title_fontsize=SMALL_POINT, loc="outside lower center", **look)
    return figure


def _draw(axes: Axes, rows: Sequence[study.Row], methods: Sequence[str], rungs: Sequence[str], gap: bool) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    dressed(axes, "", "objective gap" if gap else "median error of changed cells [%]")
    places = {(row.method, row.formulation): place for row in rows if (place := _place(row, gap)) is not None}
    for number, method in enumerate(methods[1:]):
        points = [place for (own, _), place in places.items() if own == method]
        if points:
            look: dict[str, Any] = {"color": COLOURS[number % len(COLOURS)], "ms": 2.8, "mew": 0, "alpha": 0.75}
            axes.plot(*zip(*points, strict=True), "o", label=method, **look)
    numbered = {rungs.index(rung) + 1: place for (own, rung), place in places.items() if own == methods[0]}
    if not numbered:
        axes.text(0.5, 0.5, "no truth", transform=axes.transAxes, ha="center", fontsize=TEXT_POINT)
        return
    points = list(numbered.values())
    best = [points[index] for index in front(points)]
    axes.step(*zip(*best, strict=True), where="post", color="0.3", lw=0.9, label=f"{methods[0]}: Pareto front")
    for number, point in numbered.items():
        on = point in best
        axes.plot(*point, "o", ms=8, mfc="black" if on else "white", mec="black", mew=0.8, zorder=3)
        look = {"color": "white" if on else "black", "ha": "center", "va": "center_baseline", "zorder": 4}
        axes.annotate(str(number), point, fontsize=SMALL_POINT - 1, **look)
    if gap and min(value for _, value in points) <= NO_GAP:
        axes.axhline(NO_GAP, color="0.5", lw=0.6, ls=":")
        axes.set_ylim(bottom=NO_GAP / 30)
    axes.margins(0.12, 0.14)


def _place(row: study.Row, gap: bool) -> tuple[float, float] | None:
    """Where a row stands; None without a truth, or where it failed."""
    value = row.gap if gap else row.changed_error
    if value is None or not np.isfinite(value):
        return None
    return row.frame_ms, max(value, NO_GAP) if gap else value


SAMPLES = {
    "wall": "wall time of the estimate",
    "cpu": "processor time from the frame before to this one",
    "objective": "cost with the reference's previous frame",
    "gap": "objective above the best of all rungs, against it and the noise",
}
ERRORS = (
    ("cell_error", "percent", "median error of the cells against the truth"),
    ("changed_error", "percent", "median error of the cells that have changed"),
)


def _write_samples(entry: Any, found: Group) -> None:
    """/entry/<recording>/<method>/<formulation>: times, errors, objectives and gaps of every frame; and memory."""
    for one in found:
        recording = entry.require_group(one.subject.recording.name)
        rows, columns = one.shape
        hdf5.set_attributes(recording, NX_class="NXsubentry", rows=rows, columns=columns)
        hdf5.set_attributes(recording, scene=one.subject.scene, noise=one.subject.noise)
        method = recording.require_group(one.method)
        hdf5.set_attributes(method, NX_class="NXcollection")
        group = method.create_group(one.formulation.replace(" ", "_"))
        one.write(group, SAMPLES, "frame in sequence", formulation=one.formulation, baseline_s=one.baseline_s)
        study.write_columns(group, one, ERRORS, ("frame",))
        if one.memory_mb is not None:
            hdf5.set_attributes(group, peak_memory_mb=one.memory_mb)


STUDY: study.Study[Plan, Group] = study.Study(
    "tradeoff",
    "measurements",
    "tradeoff.yaml",
    read_plan,
    run_tradeoff,
    FIGURES,
    # Summaries, then methods, then each rung with each method on each recording.
    lambda found: [*summary_rows(found), *method_rows(found), *study.rows_of(([one] for one in found), FIGURES)],
    lambda found: [("", tradeoff_table(found))],
    "tradeoff/1",
    _write_samples,
    lambda found: {"tradeoff": tradeoff_figure(method_rows(found))},
)
