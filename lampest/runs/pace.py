"""Remaining time of a batch, each estimator by its own speed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array
from lampest.runs.config import Case


@dataclass(frozen=True)
class Pace:
    """Time that the cases of a batch have taken so far.

    Attributes
    ----------
    cases : sequence of Case
    done : tuple of int
        Number of finished frames of each case.
    timed : array, shape (cases,)
        Number of those of known time: the first ones of a case end with its preparation.
    seconds : array, shape (cases,)
        Time of these, s. The time between two counts is shared by the cases that have advanced.
    counted : float
        Clock when a case advanced last, s.
    """

    cases: Sequence[Case]
    done: tuple[int, ...]
    timed: Array
    seconds: Array
    counted: float

    @classmethod
    def begun(cls, cases: Sequence[Case], now: float) -> "Pace":
        """Return the pace before the first frame; `now` is the clock in s."""
        none = np.zeros(len(cases))
        return cls(cases, (0,) * len(cases), none, none, now)

    def after(self, done: Sequence[int], now: float) -> "Pace":
        """Return the pace at a count of the finished frames of each case."""
        frames = np.maximum(np.subtract(done, self.done), 0)
        if not frames.any():
            return self
        share = (now - self.counted) / np.count_nonzero(frames)
        begun = np.greater(self.done, 0)
        timed = self.timed + frames * begun
        seconds = self.seconds + share * (begun & (frames > 0))
        return Pace(self.cases, tuple(done), timed, seconds, now)

    def left_s(self, workers: int) -> float:
        """Return the remaining time in s.

        A frame takes the measured time of its estimator on panels of this size. Before any is
        measured it takes the expected one, multiplied by the ratio of measured to expected times of
        the other estimators; without those, divided by the number of workers.
        """
        labels = [f"{case.name} {case.cells}" for case in self.cases]
        _, kind = np.unique(labels, return_inverse=True)
        timed, seconds = (np.bincount(kind, part)[kind] for part in (self.timed, self.seconds))
        frame_seconds = np.array([case.frame_seconds for case in self.cases])
        expected = self.timed @ frame_seconds
        ratio = self.seconds.sum() / expected if expected else 1 / workers
        of_frame = np.where(timed > 0, seconds / np.maximum(timed, 1), frame_seconds * ratio)
        return float(np.subtract([case.frames for case in self.cases], self.done) @ of_frame)
