"""Remaining time of a batch, each estimator by its own speed."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from lampest.runs.config import Case


@dataclass(frozen=True)
class Pace:
    """Time that the cases of a batch have taken so far.

    Attributes
    ----------
    cases : sequence of Case
    done : tuple of int
        Number of finished frames of each case.
    timed : tuple of int
        Number of those of known time: the first ones of a case end with its preparation.
    seconds : tuple of float
        Time of these, s. The time between two counts is shared by the cases that have advanced.
    counted : float
        Clock when a case advanced last, s.
    """

    cases: Sequence[Case]
    done: tuple[int, ...]
    timed: tuple[int, ...]
    seconds: tuple[float, ...]
    counted: float

    @classmethod
    def begun(cls, cases: Sequence[Case], now: float) -> "Pace":
        """Return the pace before the first frame; `now` is the clock in s."""
        none = (0,) * len(cases)
        return cls(cases, none, none, none, now)

    def after(self, done: Sequence[int], now: float) -> "Pace":
        """Return the pace at a count of the finished frames of each case."""
        advanced = [new > old for new, old in zip(done, self.done, strict=True)]
        if not any(advanced):
            return self
        share = (now - self.counted) / sum(advanced)
        timed = list(self.timed)
        seconds = list(self.seconds)
        for number, before in enumerate(self.done):
            if advanced[number] and before:
                timed[number] += done[number] - before
                seconds[number] += share
        return Pace(self.cases, tuple(done), tuple(timed), tuple(seconds), now)

    def left_s(self, workers: int) -> float:
        """Return the remaining time in s.

        A frame takes the measured time of its estimator on panels of this size. Before any is
        measured it takes the expected one, multiplied by the ratio of measured to expected times of
        the other estimators; without those, divided by the number of workers.
        """
        seconds = defaultdict[tuple[str, int], float](float)
        timed = defaultdict[tuple[str, int], int](int)
        expected = 0.0
        for case, frames, spent in zip(self.cases, self.timed, self.seconds, strict=True):
            timed[case.name, case.cells] += frames
            seconds[case.name, case.cells] += spent
            expected += frames * case.frame_seconds
        ratio = sum(seconds.values()) / expected if expected else 1 / workers
        left = 0.0
        for case, frames in zip(self.cases, self.done, strict=True):
            kind = (case.name, case.cells)
            of_frame = seconds[kind] / timed[kind] if timed[kind] else case.frame_seconds * ratio
            left += (case.frames - frames) * of_frame
        return left
