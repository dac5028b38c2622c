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

    Every panel and method is measured on one recording first, then its memory, then on the other recordings.
    """
    budget = Budget(bench.budget_s, perf_counter())
    shapes, methods = bench.shapes, bench.estimators
    parts = [BenchPart(number, s, name) for number in range(bench.recordings) for s in shapes for name in methods]
    once = len(shapes) * len(methods)
    mats: tuple[MatSolve, ...] = ()
    if bench.mats is not None:
        on_step(0, len(parts), "random mats")
        mats = tuple(solved_mats(bench.mats, bench.seed, bench.solver))
    timings, missed = _solved(bench, parts[:once], (), budget, lambda done, what: on_step(done, len(parts), what))
    if bench.memory:
        on_step(once, len(parts), "memory")
    memory, unknown = _peaks(bench, timings, budget)
    more, missed_too = _solved(
        bench, parts[once:], timings, budget, lambda done, what: on_step(once + done, len(parts), what)
    )
    return Bench((*timings, *more), memory, (*missed, *unknown, *missed_too), mats)


def _solved(
    bench: BenchFile,
    parts: Sequence[BenchPart],
    before: Sequence[Timing],
    budget: Budget,
    on_part: Callable[[int, str], None],
) -> tuple[list[Timing], list[LeftOut]]:
    """The timings of these parts after those before, and what there was no time for."""
    timings: list[Timing] = []
    missed: list[LeftOut] = []
    simulated = lru_cache(maxsize=1)(bench.recording)
    for number, part in enumerate(parts):
        on_part(number, str(part))
        if part.expected_s(bench, (*before, *timings)) > budget.left_s():
            missed.append(part.left_out())
            continue
        measured = list(timings_of(bench, simulated(part.shape, part.recording), part, budget))
        timings += measured
        if len(measured[0].wall) <= bench.frames:
            missed.append(part.left_out(f" after {len(measured[0].wall)} of {bench.frames + 1} frames"))
    return timings, missed


def _peaks(bench: BenchFile, timings: Sequence[Timing], budget: Budget) -> tuple[Peaks, list[LeftOut]]:
    """The peaks of panels that are asked for, and those for which there is no time."""
    peaks: Peaks = {}
    unknown: list[LeftOut] = []
    for timing in timings:
        rows, columns = timing.shape
        if rows != columns or rows not in bench.memory:
            continue
        if memory_expected_s(timing) > budget.left_s():
            unknown.append(LeftOut(timing.shape, timing.method, f"memory of {timing.solver}"))
        else:
            about = timing.shape, timing.method, timing.solver
            peaks[about] = peak_memory(bench, *about)
    return peaks, unknown
