"""A trade-off's figures by rung: over everything on a panel, by method, and one by one; its files and its table."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.report.compare import Table
from lampest.studies import study
from lampest.studies.tradeoff.figure import front, tradeoff_figure
from lampest.studies.tradeoff.run import Measured, run_tradeoff
from lampest.studies.tradeoff.settings import Plan, read_plan

REACHED = 1e-6  # the gap of a frame that has reached the optimum
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
    "reached": lambda own: float(np.mean(_over("gap", own) <= REACHED)),  # share of the frames
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
    shapes = study.grouped(own, lambda one: one.shape).values()
    rungs = (study.grouped(here, lambda one: one.formulation).values() for here in shapes)
    return [row for groups in rungs for row in study.rows_of(groups, FIGURES)]


def method_rows(found: Group) -> list[study.Row]:
    """By method, panel size and rung, all recordings together; the file's first method first."""
    return [row for own in study.grouped(found, lambda one: one.method).values() for row in summary_rows(own)]


def all_rows(found: Group) -> list[study.Row]:
    """Summaries, then methods, then each rung with each method on each recording."""
    return [*summary_rows(found), *method_rows(found), *study.rows_of(([one] for one in found), FIGURES)]


def on_front(rows: Sequence[study.Row]) -> list[str]:
    """Rungs of one size that no other beats, in time together with cell error, or in time together with the gap."""
    kept = set(front([(row.frame_ms, row.gap) for row in rows]))
    errors = [(row.frame_ms, float("inf") if row.changed_error is None else row.changed_error) for row in rows]
    return [rows[index].formulation for index in sorted(kept | set(front(errors)))]


def tradeoff_table(found: Group) -> Table:
    """The first method's rows, those on a front marked."""
    rows = summary_rows([one for one in found if one.method == found[0].method])
    fronts = {shape: on_front(own) for shape, own in study.grouped(rows, lambda row: (row.rows, row.columns)).items()}
    marked = {"front": lambda row: "*" * (row.formulation in fronts[row.rows, row.columns])}
    return study.screen_table(rows, SCREEN | marked)


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
    all_rows,
    lambda found: [("", tradeoff_table(found))],
    "tradeoff/1",
    _write_samples,
    lambda found: {"tradeoff": tradeoff_figure(method_rows(found))},
)
