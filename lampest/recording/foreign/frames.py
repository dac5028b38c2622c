"""What every kind of foreign file is turned into before its numbers get a meaning."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array

MOST_BYTES = 500_000_000  # of a file, of what it unpacks to, and of its values in memory

Place = Callable[[int, int, int], str]


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of frames in s; date and time of the first one, ISO 8601, where the file tells it; a sentence on both."""

    seconds: Array
    start: str | None
    sentence: str

    def said(self, where: str) -> "Clock":
        """The same with where the times stand in the file."""
        return replace(self, sentence=f"time: {where}{self.sentence}")


@dataclass(frozen=True, eq=False)
class Frames:
    """Values of a file, and what it says of them.

    values : (frames, rows, columns) in the file's unit; NaN where a reading is missing, infinite where it says so.
    timing : tells when the frames were taken, or raises InputError; None where the file has no times.
    notes : sentences on how it was understood.
    place : how the file names the place of a value: frame, row, column → text.
    words : names of columns or arrays in which the unit may stand.
    """

    values: Array
    timing: Callable[[], Clock] | None
    notes: tuple[str, ...]
    place: Place
    words: tuple[str, ...] = ()


def check_count(where: object, values: int) -> None:
    """Raise InputError where a file claims more values than are imported."""
    if 8 * values > MOST_BYTES:
        raise InputError(f"{where}: {values} values, more than {MOST_BYTES // 8} are not imported")


def refuse_where(bad: NDArray[np.bool_], values: Array, place: Place, why: str) -> None:
    """Raise InputError with the place of the first bad value, the value, and `why`."""
    if np.any(bad):
        frame, row, column = (int(part) for part in np.argwhere(bad)[0])
        raise InputError(f"{place(frame, row, column)}: {values[frame, row, column]:.6g} {why}")
