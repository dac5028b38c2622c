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
    hint : how a case gets them.
    frame : index into the recording of what is shown; None: `strongest_index` chooses.

    >>> issubclass(lampest.ContourPlot, lampest.Plot)
    True
    """

    kind: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    hint: ClassVar[str] = ""
    frame: int | None = None

    @abstractmethod
    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """The picture of a recording's cases that hold what it needs."""

    def drawable(self, cases: Sequence[CaseResult]) -> tuple[CaseResult, ...]:
        """The cases that hold what it needs."""
        return tuple(case for case in cases if all(case.column(name) is not None for name in self.needs))

    def shown(self, cases: Sequence[CaseResult]) -> tuple[int, str]:
        """Where the shown frame stands among those of the cases, and a title: the recording and its frame.

        Raises InputError where the frame has no results.
        """
        first = cases[0]
        if self.frame is None:
            index = strongest_index(cases)
        elif self.frame in first.frame:
            index = int(np.argmax(first.frame == self.frame))
        else:
            known = f"there are frames {first.frame.min()} to {first.frame.max()}"
            raise InputError(f"{first.recording}: frame {self.frame} has no results; {known}")
        return index, f"{first.recording}: frame {first.frame[index]} at {first.time[index]:.4g} s"
