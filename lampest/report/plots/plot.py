"""What a kind of picture is, and which frame it shows."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure as Figure

from lampest.files.errors import InputError
from lampest.files.typed import Validated
from lampest.report.strongest import strongest_index
from lampest.runs.case import CaseResult


@dataclass(frozen=True)
class Plot(Validated):
    """One kind of picture of a results file.

    kind : the word that asks for it. needs : the columns that a case must hold to be drawn.
    apart : whether every estimator has a picture of its own; else all of a recording share one.
    frame : index into the recording of what is shown; None: `strongest_index` chooses.

    >>> issubclass(lampest.ContourPlot, lampest.Plot)
    True
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
