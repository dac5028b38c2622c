"""A trade-off's figures by rung: over everything on a panel, by method, and one by one."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lampest.report.compare import Table
from lampest.studies.study import Figures, Row, grouped, rows_of, screen_table, text_of
from lampest.studies.tradeoff.run import Measured

ALL = "all"  # methods, recordings, scenes or noise taken together
REACHED = 1e-6  # the gap of a frame that has reached the optimum


def _one(name: Callable[[Measured], str]) -> Callable[[Sequence[Measured]], str]:
    def only(own: Sequence[Measured]) -> str:
        different = list(dict.fromkeys(map(name, own)))
        return different[0] if len(different) == 1 else ALL

    return only


def _all(what: str, own: Sequence[Measured]) -> Any:
    return np.concatenate([getattr(one, what) for one in own])


def _gap(own: Sequence[Measured]) -> Any:
    """A failed frame's is infinite."""
    return np.nan_to_num(_all("gap", own), nan=np.inf)


def _median(what: str) -> Callable[[Sequence[Measured]], float | None]:
    def median(own: Sequence[Measured]) -> float | None:
        values = _all(what, own)
        values = values[np.isfinite(values)]
        return float(np.median(values)) if len(values) else None

    return median


FIGURES: Figures = {
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
    "gap": lambda own: float(np.median(_gap(own))),
    "worst_gap": lambda own: float(np.max(_gap(own))),
    "reached": lambda own: float(np.mean(_gap(own) <= REACHED)),  # share of the frames
    "frames": lambda own: len(_gap(own)),
    "failed": lambda own: int(np.sum(~_all("solved", own))),
    "memory_mb": lambda own: own[0].memory_mb,  # peak of a fresh process, libraries included
}
SCREEN: dict[str, Callable[[Row], str]] = {
    "panel": lambda row: f"{row.rows} × {row.columns}",
    "method": lambda row: row.method,
    "formulation": lambda row: row.formulation,
    "first [ms]": lambda row: f"{row.first_ms:.3g}",
    "frame [ms]": lambda row: f"{row.frame_ms:.3g}",
    "cell error [%]": lambda row: text_of(row.cell_error),
    "of changed cells [%]": lambda row: text_of(row.changed_error),
    "gap median / worst": lambda row: f"{row.gap:.0e} / {row.worst_gap:.0e}",
    "reached [%]": lambda row: f"{100 * row.reached:.0f}",
    "failed": lambda row: f"{row.failed}/{row.frames}",
    "memory [MB]": lambda row: text_of(row.memory_mb, ".0f"),
}


def detailed_rows(found: Sequence[Measured]) -> list[Row]:
    """One row for each rung with each method on each recording."""
    return rows_of(([one] for one in found), FIGURES)


def summary_rows(found: Sequence[Measured]) -> list[Row]:
    """By panel size and rung, all methods and recordings together."""
    return _by_rung(found)


def method_rows(found: Sequence[Measured]) -> list[Row]:
    """By method, panel size and rung, all recordings together."""
    return [row for own in grouped(found, lambda one: one.method).values() for row in _by_rung(own)]


def _by_rung(own: Sequence[Measured]) -> list[Row]:
    shapes = grouped(own, lambda one: one.shape).values()
    return [row for here in shapes for row in rows_of(grouped(here, lambda one: one.formulation).values(), FIGURES)]


def first_method(found: Sequence[Measured]) -> list[Row]:
    """The rows of the file's first method, by panel size and rung, all recordings together."""
    return [row for row in method_rows(found) if row.method == found[0].method]


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates, smaller being better, by the first one."""
    order = sorted(range(len(points)), key=lambda index: points[index])
    best, kept = float("inf"), []
    for index in order:
        if points[index][1] < best:
            best = points[index][1]
            kept.append(index)
    return kept


def on_front(rows: Sequence[Row]) -> list[str]:
    """Rungs of one size that no other beats, in time together with cell error, or in time together with the gap."""
    kept = set(front([(row.frame_ms, row.gap) for row in rows]))
    errors = [(row.frame_ms, float("inf") if row.changed_error is None else row.changed_error) for row in rows]
    return [rows[index].formulation for index in sorted(kept | set(front(errors)))]


def tradeoff_table(found: Sequence[Measured]) -> Table:
    """The first method's rows, those on a front marked."""
    rows = first_method(found)
    fronts = {shape: on_front(here) for shape, here in grouped(rows, lambda row: (row.rows, row.columns)).items()}
    return screen_table(rows, SCREEN | {"front": lambda row: "*" * (row.formulation in fronts[row.rows, row.columns])})
