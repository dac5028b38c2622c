"""A trade-off's figures by rung: over everything on a panel, by method, and one by one."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array
from lampest.studies.tradeoff.run import Measured, Tradeoff

ALL = "all"
REACHED = 1e-6  # the gap of a frame that has reached the optimum


@dataclass(frozen=True)
class TradeoffRow:
    """One rung on panels of one size; `all` where methods, recordings, scenes or noise are taken together.

    Parameters
    ----------
    rows, columns, recording, scene, noise, method, formulation : what was measured.
    first_ms : median time until the first estimate, baseline included. frame_ms : median of the frames after it.
    cell_error, changed_error : median over the frames of a frame's median error in percent, of all cells and of those
        that have changed; None without a truth.
    gap, worst_gap : median and largest `Measured.gap`; a failed frame's is infinite.
    reached : share of the frames whose gap is at most 1e-6.
    frames, failed : number of frames; those without an estimate.
    memory_mb : peak of a fresh process, libraries included; None where it was not measured.
    """

    rows: int
    columns: int
    recording: str
    scene: str
    noise: str
    method: str
    formulation: str
    first_ms: float
    frame_ms: float
    cell_error: float | None
    changed_error: float | None
    gap: float
    worst_gap: float
    reached: float
    frames: int
    failed: int
    memory_mb: float | None


def detailed_rows(found: Tradeoff) -> list[TradeoffRow]:
    """One row for each rung with each method on each recording."""
    return [_row(found, [one]) for one in found.measured]


def summary_rows(found: Tradeoff) -> list[TradeoffRow]:
    """By panel size and rung, all methods and recordings together."""
    return list(_grouped(found, found.measured))


def method_rows(found: Tradeoff) -> list[TradeoffRow]:
    """By panel size, method and rung, all recordings together."""
    methods = dict.fromkeys(one.method for one in found.measured)
    return [row for method in methods for row in _grouped(found, [o for o in found.measured if o.method == method])]


def _grouped(found: Tradeoff, chosen: Sequence[Measured]) -> Iterable[TradeoffRow]:
    for shape in dict.fromkeys(one.shape for one in chosen):
        here = [one for one in chosen if one.shape == shape]
        for formulation in dict.fromkeys(one.formulation for one in here):
            yield _row(found, [one for one in here if one.formulation == formulation])


def _row(found: Tradeoff, parts: Sequence[Measured]) -> TradeoffRow:
    gap = np.nan_to_num(np.concatenate([part.gap for part in parts]), nan=np.inf)
    solved = np.concatenate([part.solved for part in parts])
    shape, formulation = parts[0].shape, parts[0].formulation
    return TradeoffRow(
        *shape,
        _one(part.subject.recording.name for part in parts),
        _one(part.subject.scene for part in parts),
        _one(part.subject.noise for part in parts),
        _one(part.method for part in parts),
        formulation,
        first_ms=1e3 * float(np.median([part.baseline_s + part.times()[0] for part in parts])),
        frame_ms=1e3 * float(np.median(np.concatenate([part.times()[1:] for part in parts]))),
        cell_error=_median([part.cell_error for part in parts]),
        changed_error=_median([part.changed_error for part in parts]),
        gap=float(np.median(gap)),
        worst_gap=float(np.max(gap)),
        reached=float(np.mean(gap <= REACHED)),
        frames=len(gap),
        failed=int(np.sum(~solved)),
        memory_mb=found.memory_mb.get((shape, formulation)),
    )


def _one(names: Iterable[str]) -> str:
    different = list(dict.fromkeys(names))
    return different[0] if len(different) == 1 else ALL


def _median(parts: Sequence[Array]) -> float | None:
    values = np.concatenate(parts)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else None


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates, smaller being better, by the first one."""
    order = sorted(range(len(points)), key=lambda index: points[index])
    best, kept = float("inf"), []
    for index in order:
        if points[index][1] < best:
            best = points[index][1]
            kept.append(index)
    return kept


def on_front(rows: Sequence[TradeoffRow]) -> list[str]:
    """Rungs of one size that no other beats, in time together with cell error, or in time together with the gap."""
    kept = set(front([(row.frame_ms, row.gap) for row in rows]))
    measured = [(row.frame_ms, float("inf") if row.changed_error is None else row.changed_error) for row in rows]
    return [rows[index].formulation for index in sorted(kept | set(front(measured)))]


def first_method(found: Tradeoff) -> list[TradeoffRow]:
    """The rows of the file's first method, by panel size and rung, all recordings together."""
    name = found.measured[0].method
    return [row for row in method_rows(found) if row.method == name]
