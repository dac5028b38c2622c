"""What a kind of picture is, and which frame it shows."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure as Figure

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.runs.case import CaseResult

STRONG = 0.9  # of the largest change: a load settles after it has set in


@dataclass(frozen=True)
class Plot(ABC):
    """One kind of picture of a results file.

    kind : the word that asks for it. needs : the columns that a case must hold to be drawn.
    apart : whether every estimator has a picture of its own; else all of a recording share one.
    frame : index into the recording of what is shown; None: `strongest_index` chooses.
    """

    kind: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    apart: ClassVar[bool] = False
    frame: int | None = None

    @abstractmethod
    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """The picture of a recording's cases that hold what it needs; of one of them where they are drawn apart."""

    def drawable(self, cases: Sequence[CaseResult]) -> tuple[CaseResult, ...]:
        """The cases that hold what it needs."""
        return tuple(case for case in cases if all(case.column(name) is not None for name in self.needs))


def strongest_index(cases: Sequence[CaseResult]) -> int:
    """Of the frames that most of the cases solved, the one whose cells have moved furthest."""
    solved = np.sum([case.solved for case in cases], axis=0)
    frames = np.flatnonzero(solved == solved.max())
    return int(frames[furthest(cases[0].measured[frames], cases[0].measured_baseline)])


def furthest(value: Array, resting: Array) -> int:
    """The last of some frames (frames, rows, columns) whose rms `likely_change` reaches 90 % of the largest.

    The last one, because a load settles after it has set in.
    """
    change = likely_change(value, resting)
    known = np.isfinite(change)
    square = np.where(known, change**2, 0.0).sum(axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    return int(np.flatnonzero(square >= STRONG**2 * square.max())[-1])


def likely_change(value: Array, resting: Array) -> Array:
    """ln(r/r₀) ≈ K·(x̄/K + a/M + b/N + w/2), x = ln(y/y₀) = x̄ + a + b + w, K = M + N − 1; (frames, rows, columns).

    The inverse of the derivative of a uniform panel's two-point resistances: mean, effects of rows, of columns, and
    what is left of a cell are each mixed in by a factor of their own. Readings alone fall less as suction lets cells
    rise amid others that a rim presses; cells do not, so that suction counts. A measure to choose by, no estimate.
    value : (frames, rows, columns), resting : (rows, columns), in any unit; NaN where a reading is missing.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.log(value / resting)
    moved = np.where(np.isfinite(moved), moved, np.nan)
    rows, columns = value.shape[1:]
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # a line without readings has no mean
        mean = np.nanmean(moved, axis=(1, 2), keepdims=True)
        across = np.nanmean(moved, axis=2, keepdims=True) - mean
        down = np.nanmean(moved, axis=1, keepdims=True) - mean
    own = moved - mean - across - down
    return np.asarray(mean + (rows + columns - 1) * (across / rows + down / columns + own / 2))


def shown_index(cases: Sequence[CaseResult], frame: int | None) -> int:
    """Where a recording's frame stands among those of its cases; None: that of the strongest one.

    Raises InputError where the frame has no results.
    """
    if frame is None:
        return strongest_index(cases)
    frames = cases[0].frame
    indices = np.flatnonzero(frames == frame)
    if indices.size == 0:
        raise InputError(
            f"{cases[0].recording}: frame {frame} has no results; there are frames {frames.min()} to {frames.max()}"
        )
    return int(indices[0])


def frame_title(case: CaseResult, index: int, frame: int | None) -> str:
    """Which frame is shown, and why that one where nobody asked for it."""
    why = ", the last within 10 % of the strongest change" if frame is None else ""
    return f"frame {case.frame[index]} at {case.time[index]:g} s{why}"
