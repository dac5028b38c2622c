"""What a benchmark has time for, judged by what it has measured already."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.timing import Timing

STARTED_S = 3.0  # what a fresh process takes to begin
GROWTH = 3  # time ∝ (M + N)³, by which a panel's is guessed from the next smaller one's


@dataclass(frozen=True)
class Budget:
    """seconds : wall time from `begun` on, a reading of `perf_counter`."""

    seconds: float
    begun: float

    def left_s(self) -> float:
        """How many are left."""
        return self.begun + self.seconds - perf_counter()


@dataclass(frozen=True)
class LeftOut:
    """A method on a panel for which there was no time; what of it."""

    shape: tuple[int, int]
    method: str
    what: str


@dataclass(frozen=True)
class BenchPart:
    """A method on one recording of a panel."""

    recording: int
    shape: tuple[int, int]
    method: str

    def __str__(self) -> str:
        return f"{self.shape[0]} × {self.shape[1]} {self.method}, recording {self.recording + 1}"

    def left_out(self, what: str = "") -> LeftOut:
        """That this, or something of it, was left out."""
        return LeftOut(self.shape, self.method, f"recording {self.recording + 1}{what}")

    def expected_s(self, bench: BenchFile, done: Sequence[Timing]) -> float:
        """As on another recording of the panel; else as on the largest one that is smaller, growing as (M + N)³."""
        solvers, lines = bench.solvers(self.shape), sum(self.shape)
        alike = [one for one in done if one.method == self.method and one.solver in solvers and sum(one.shape) <= lines]
        if not alike:
            return 0.0
        nearest = max(sum(one.shape) for one in alike)
        spent = {
            (one.shape, one.recording, one.solver): np.nansum(one.wall) for one in alike if sum(one.shape) == nearest
        }
        recordings = len({(shape, recording) for shape, recording, _ in spent})
        return float(sum(spent.values())) / recordings * (lines / nearest) ** GROWTH


def memory_expected_s(timing: Timing) -> float:
    """What a fresh process takes for its first frame and the next."""
    return STARTED_S + float(np.sum(timing.times()[:2]))
