"""The measurement: panel by panel and method by method, for as long as there is time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter

import numpy as np

from lampest.studies.bench.budget import BenchPart, Budget, LeftOut, memory_expected_s
from lampest.studies.bench.mats import MatSolve, solved_mats
from lampest.studies.bench.memory import peak_memory
from lampest.studies.bench.sequence import timings_of
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.timing import Timing

Step = Callable[[int, int, str], None]
Peaks = dict[tuple[tuple[int, int], str, str], float]


@dataclass(frozen=True, eq=False)
class Bench:
    """timings : of every solver. memory_mb : by panel, method and solver, 10⁶ bytes; NaN where the process died.

    left_out : for want of time. mats : published solvers on random mats.
    """

    timings: tuple[Timing, ...]
    memory_mb: Peaks
    left_out: tuple[LeftOut, ...] = ()
    mats: tuple[MatSolve, ...] = ()

    def inverse_s(self, shape: tuple[int, int]) -> float:
        """Seconds of one dense inverse of a panel's lines."""
        return float(np.median([timing.inverse_s for timing in self.timings if timing.shape == shape]))


def run_bench(bench: BenchFile, on_step: Step = lambda done, total, what: None) -> Bench:
    """Measure everything, as far as the budget goes; on_step is told how many of how many parts are done, and what is
    next.

    Panel by panel, each on all recordings, with the memory it takes on the first: there is no time for other recordings
    of the last panels, if for anything.
    """
    budget = Budget(bench.budget_s, perf_counter())
    shapes, methods = bench.shapes, bench.estimators
    parts = [BenchPart(number, s, name) for s in shapes for number in range(bench.recordings) for name in methods]
    mats: tuple[MatSolve, ...] = ()
    if bench.mats is not None:
        on_step(0, len(parts), "random mats")
        mats = tuple(solved_mats(bench.mats, bench.seed, bench.solver))
    timings: list[Timing] = []
    peaks: Peaks = {}
    missed: list[LeftOut] = []
    simulated = lru_cache(maxsize=1)(bench.recording)
    for number, part in enumerate(parts):
        on_step(number, len(parts), str(part))
        if part.expected_s(bench, timings) > budget.left_s():
            missed.append(part.left_out())
            continue
        measured = list(timings_of(bench, simulated(part.shape, part.recording), part, budget))
        timings += measured
        if len(measured[0].wall) <= bench.frames:
            missed.append(part.left_out(f" after {len(measured[0].wall)} of {bench.frames + 1} frames"))
        found, unknown = _peaks(bench, measured, budget)
        peaks |= found
        missed += unknown
    return Bench(tuple(timings), peaks, tuple(missed), mats)


def _peaks(bench: BenchFile, timings: Sequence[Timing], budget: Budget) -> tuple[Peaks, list[LeftOut]]:
    """The peaks of first recordings of panels for which they are asked, and those for which there is no time."""
    peaks: Peaks = {}
    unknown: list[LeftOut] = []
    for timing in timings:
        rows, columns = timing.shape
        if timing.recording or rows != columns or rows not in bench.memory:
            continue
        if memory_expected_s(timing) > budget.left_s():
            unknown.append(LeftOut(timing.shape, timing.method, f"memory of {timing.solver}"))
        else:
            about = timing.shape, timing.method, timing.solver
            peaks[about] = peak_memory(bench, *about)
    return peaks, unknown
