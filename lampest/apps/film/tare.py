"""Automatic tare: a new zero of pressures where nothing touches the panel.

In each of the last frames every cell must lie where noise, drift and the film's memory may have
brought it. The mean of the first half of these frames is the new zero; the second half ensures that
no load is about to arrive.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lampest.apps.film.memory import CELL_MEMORY_SD, RESTING_SD
from lampest.files.levels import MAD_TO_SIGMA, MAX_MEAN_SQUARE, OUTLIER_THRESHOLD, TWO_SIDED
from lampest.panel.panel import Array

if TYPE_CHECKING:
    from lampest.estimate.estimator import Tare

# ln r/r0 beyond which a cell, and the mean of four neighbours, may be under a load: 0.8 and 0.3
# kPa. The weakest suction of a lamprey, 0.6 kPa, covers more than four cells, while the drift of
# films is independent in each cell.
MAX_CHANGE = 0.15
MAX_CHANGE_OF_FOUR = 0.06


@dataclass(frozen=True, eq=False)
class TareWatch:
    """State of the automatic tare.

    Attributes
    ----------
    tare : Tare
    zeroed : float or None
        Time of the last zero, s; None before the first frame.
    frames : tuple of (array, float)
        The last frames, at most `tare.frames`: ln r/r_zero without the film's memory (rows,
        columns), and time in s.
    """

    tare: "Tare"
    zeroed: float | None = None
    frames: tuple[tuple[Array, float], ...] = ()

    def after(
        self, change: Array, memory: Array, time: float
    ) -> tuple["TareWatch", Array | None, str]:
        """Return the state after a frame, and a new zero if one is due.

        Parameters
        ----------
        change : array, shape (rows, columns)
            ln r/r_zero without the film's memory.
        memory : array, shape (rows, columns)
            The film's memory in ln r.
        time : float
            s.

        Returns
        -------
        watch : TareWatch
            State for the next frame.
        zero : array, shape (rows, columns), or None
            The new zero in ln r/r_zero, if one is due.
        reason : str
            Sentence on the new zero, or ''.
        """
        zeroed = time if self.zeroed is None else self.zeroed
        count = self.tare.frames
        if not np.isfinite(change).any():
            return TareWatch(self.tare, zeroed), None, ""
        watch = TareWatch(self.tare, zeroed, (*self.frames, (change, time))[-count:])
        mean = watch._zero(memory, (time - zeroed) / 60) if len(watch.frames) == count else None
        if mean is None:
            return watch, None, ""
        message = (
            f"nothing touched the panel for {count} frames ({time - watch.frames[0][1]:.3g} s): "
            f"no cell was off by more than {100 * np.expm1(np.nanmax(np.abs(mean))):.2g} %, "
            "as drift and the film's memory allow"
        )
        return TareWatch(self.tare, time), mean, message

    def _zero(self, memory: Array, minutes: float) -> Array | None:
        """Return the mean of the first half of the frames as a new zero; None where none is due.

        No zero is taken where a frame shows a load, and none is needed where the mean is within its
        noise.
        """
        frames = np.stack([change for change, _ in self.frames])
        finite = np.isfinite(frames).all(axis=0)
        noise = sigma_of_frames(frames[:, finite])
        half = len(frames) // 2
        drift = np.hypot(RESTING_SD, self.tare.drift_per_minute * minutes)
        moved = np.hypot(drift, CELL_MEMORY_SD * memory[finite])
        # deviations in units of noise, drift and memory: none beyond OUTLIER_THRESHOLD, mean square
        # near 1 in every frame
        departure = frames[:, finite] / np.hypot(noise, moved)
        mean = frames[:half].mean(axis=0)
        quiet = (
            np.abs(departure).max() < OUTLIER_THRESHOLD
            and (departure**2).mean(axis=1).max() < MAX_MEAN_SQUARE
        )
        significant = np.mean(mean[finite] ** 2) >= TWO_SIDED**2 * np.mean(noise**2) / half
        # A load may show in one cell, or in the mean of four; NaN counts as 0.
        cells = np.pad(np.nan_to_num(frames.mean(axis=0)), 1)
        four = (cells[:-1, :-1] + cells[1:, :-1] + cells[:-1, 1:] + cells[1:, 1:]) / 4
        loaded = np.abs(cells).max() > MAX_CHANGE or np.abs(four).max() > MAX_CHANGE_OF_FOUR
        if loaded or not (quiet and significant):
            return None
        return np.where(finite, mean, np.nan)


def sigma_of_frames(frames: Array) -> Array:
    """Return the noise of one frame (...) from differences of successive frames.

    The frames are (frames, ...); NaN is ignored.
    """
    return np.asarray(
        MAD_TO_SIGMA * np.nanmedian(np.abs(np.diff(frames, axis=0)), axis=0) / np.sqrt(2)
    )
