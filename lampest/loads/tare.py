"""Zero taken anew by itself, where nothing touches the panel: drift is taken off, a load never.

Every cell must lie where noise, drift and the film's memory may have brought it, in each of the last frames. The mean
of their first half is the new zero; the other half is a guard against a load that begins to come.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lampest.files.typed import Validated, check_range
from lampest.loads.film import SETTLED
from lampest.panel.panel import Array

OWN = 0.4  # the part of a cell's memory that may be wrong
FAR, FAR_MEAN = 6.0, 4.5  # standard deviations of a cell in one frame, and in the mean of all
TOGETHER = 1.4  # mean square over the cells, in the same units
# ln r/r0 beyond which a cell, and the mean of four neighbours, may be under a load: 0.8 and 0.3 kPa. The weakest
# suction of a lamprey, 0.6 kPa, covers more cells than four; films drift cell by cell.
MOST, MOST_OF_FOUR = 0.15, 0.06
FADES = 0.01  # ln r/r0
WORTH = 2.0  # standard errors by which cells must have moved, in the root mean square, for a new zero to be worth it
OF_DIFFERENCES = 1.4826 / np.sqrt(2)  # median of |differences of two| → standard deviation of one


@dataclass(frozen=True)
class Tare(Validated):
    """Take zero anew where nothing has touched the panel for so many frames in a row.

    frames : how many; from fewer than five, noise cannot be told from a load.
    drift_per_minute : standard deviation of ln r of a cell at rest for each minute since the last zero.

    >>> lampest.Tare().frames
    20
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    frames: int = 20
    drift_per_minute: float = 0.02

    def __post_init__(self) -> None:
        check_range("drift_per_minute", self.drift_per_minute, 0, 1)
        check_range("frames", self.frames, 5, 100_000)


@dataclass(frozen=True, eq=False)
class TareWatch:
    """The frames since the last one that was not at rest.

    zeroed : s, of the last zero; None before the first frame. frames : at most as many as `tare` asks for: (rows,
    columns) ln r/r_zero without the film's memory, (rows, columns) that memory, and s.
    """

    tare: Tare
    zeroed: float | None = None
    frames: tuple[tuple[Array, Array, float], ...] = ()

    def after(self, left: Array, memory: Array, time: float) -> tuple["TareWatch", Array | None, str]:
        """(watch, new zero or None, why or ''); left : ln r/r_zero (rows, columns) without the film's memory."""
        zeroed, count = time if self.zeroed is None else self.zeroed, self.tare.frames
        if not np.isfinite(left).any():
            return TareWatch(self.tare, zeroed), None, ""
        watch = TareWatch(self.tare, zeroed, (*self.frames, (left, memory, time))[-count:])
        _, first_memory, first_time = watch.frames[0]
        steady = len(watch.frames) == count and np.abs(first_memory - memory).max() < FADES
        mean = watch._zero(memory, (time - zeroed) / 60) if steady else None
        if mean is None:
            return watch, None, ""
        said = (
            f"nothing touched the panel for {count} frames ({time - first_time:.3g} s): no cell was off by more than "
            f"{100 * np.expm1(np.nanmax(np.abs(mean))):.2g} %, as drift and the film's memory allow"
        )
        return TareWatch(self.tare, time), mean, said

    def _zero(self, memory: Array, minutes: float) -> Array | None:
        """Return the mean of the first half.

        None where something stands out in any frame, or where it is not worth a new zero.
        """
        frames = np.stack([left for left, _, _ in self.frames])
        known = np.isfinite(frames).all(axis=0)
        noise = OF_DIFFERENCES * np.median(np.abs(np.diff(frames[:, known], axis=0)), axis=0)
        moved = np.sqrt(SETTLED**2 + (self.tare.drift_per_minute * minutes) ** 2 + (OWN * memory[known]) ** 2)
        half = len(frames) // 2
        mean, error = frames[:half].mean(axis=0), noise / np.sqrt(half)
        each, all_in_all = frames[:, known] / np.hypot(noise, moved), mean[known] / np.hypot(2 * error, moved)
        quiet = np.abs(each).max() < FAR and (each**2).mean(axis=1).max() < TOGETHER
        worth = np.mean(mean[known] ** 2) >= WORTH**2 * np.mean(error**2)
        if not (quiet and worth and np.abs(all_in_all).max() < FAR_MEAN) or _stands_out(frames.mean(axis=0)):
            return None
        return np.where(known, mean, np.nan)


def _stands_out(change: Array) -> bool:
    """Whether ln r/r0 (rows, columns) may be under a load, in a cell or in four neighbours; unknown cells are not."""
    cells = np.pad(np.nan_to_num(change), 1)
    four = (cells[:-1, :-1] + cells[1:, :-1] + cells[:-1, 1:] + cells[1:, 1:]) / 4
    return bool(np.abs(cells).max() > MOST or np.abs(four).max() > MOST_OF_FOUR)
