"""Interface of plots of results files."""

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
    """A kind of plot of a results file.

    Attributes
    ----------
    kind : str
        Name on the command line.
    needs : tuple of str
        Columns that a case must have.
    hint : str
        How to obtain them.
    frame : int or None
        Index into the recording; None for the frame chosen by `strongest_index`.

    Examples
    --------
    >>> issubclass(lampest.ContourPlot, lampest.Plot)
    True
    """

    kind: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    hint: ClassVar[str] = ""
    frame: int | None = None

    @abstractmethod
    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """Draw the cases of a recording that have the needed columns."""

    def drawable(self, cases: Sequence[CaseResult]) -> tuple[CaseResult, ...]:
        """Return the cases that have the needed columns."""
        return tuple(case for case in cases if all(case.column(name) is not None for name in self.needs))

    def shown(self, cases: Sequence[CaseResult]) -> tuple[int, str]:
        """Return the index of the shown frame among those of the cases, and a title.

        Raises InputError if the frame has no results.
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
