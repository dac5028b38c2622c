"""The measurement: panel by panel and method by method, for as long as there is time."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter

import numpy as np

from lampest.studies.bench.mats import MatSolve, solved_mats
from lampest.studies.bench.memory import peak_memory
from lampest.studies.bench.sequence import timings_of
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.timing import Timing

STARTED_S = 3.0  # what a fresh process takes to begin
GROWTH = 3  # time ∝ (M + N)³, by which a panel's is guessed from the next smaller one's

Shape = tuple[int, int]
Step = Callable[[int, int, str], None]


@dataclass(frozen=True)
class LeftOut:
    """A method on a panel for which there was no time; what of it."""

    shape: Shape
    method: str
    what: str


@dataclass(frozen=True, eq=False)
class Bench:
    """timings : of every solver. memory_mb : by panel, method and solver, 10⁶ bytes; NaN where the process died.

    left_out : for want of time. mats : published solvers on random mats.
    """

    timings: tuple[Timing, ...]
    memory_mb: dict[tuple[Shape, str, str], float]
    left_out: tuple[LeftOut, ...] = ()
    mats: tuple[MatSolve, ...] = ()

    def inverse_s(self, shape: Shape) -> float:
        """Seconds of one dense inverse of a panel's lines."""
        return float(np.median([timing.inverse_s for timing in self.timings if timing.shape == shape]))


@dataclass(frozen=True)
class _Budget:
    """seconds : from `begun` on."""

    seconds: float
    begun: float

    def left(self) -> float:
        """Seconds."""
        return self.begun + self.seconds - perf_counter()


@dataclass(frozen=True)
class _Task:
    """A method on one recording of a panel."""

    recording: int
    shape: Shape
    method: str

    def left_out(self, what: str = "") -> LeftOut:
        """That this, or something of it, was left out."""
        return LeftOut(self.shape, self.method, f"recording {self.recording + 1}{what}")

    def expected_s(self, bench: BenchFile, done: Sequence[Timing]) -> float:
        """As on another recording of the panel; else as on the largest one that is smaller, growing as (M + N)³."""
        solvers = bench.solvers(self.shape)
        alike = [
            timing
            for timing in done
            if timing.method == self.method and timing.solver in solvers and sum(timing.shape) <= sum(self.shape)
        ]
        lines = max((sum(timing.shape) for timing in alike), default=0)
        nearest = [timing for timing in alike if sum(timing.shape) == lines]
        spent = float(np.sum([np.nansum(timing.wall) for timing in nearest]))
        return (
            spent
            / max(1, len({(one.shape, one.recording) for one in nearest}))
            * (sum(self.shape) / max(1, lines)) ** GROWTH
        )


def run_bench(bench: BenchFile, on_step: Step = lambda done, total, what: None) -> Bench:
    """Measure everything, as far as the budget goes; on_step is told how many of how many parts are done, and what is
    next.

    Every panel and method is measured on one recording first, then its memory, then on the other recordings.
    """
    budget = _Budget(bench.budget_s, perf_counter())
    tasks = [
        _Task(number, shape, method)
        for number in range(bench.recordings)
        for shape in bench.shapes
        for method in bench.estimators
    ]
    once = len(tasks) // bench.recordings
    mats: tuple[MatSolve, ...] = ()
    if bench.mats is not None:
        on_step(0, len(tasks), "random mats")
        mats = tuple(solved_mats(bench.mats, bench.seed, bench.solver))
    timings: list[Timing] = []
    memory: dict[tuple[Shape, str, str], float] = {}
    left_out: list[LeftOut] = []
    simulated = lru_cache(maxsize=1)(bench.recording)
    for number, task in enumerate(tasks):
        if number == once:
            left_out += _memory(bench, timings, budget, memory)
        on_step(number, len(tasks), f"{task.shape[0]} × {task.shape[1]} {task.method}, recording {task.recording + 1}")
        if task.expected_s(bench, timings) > budget.left():
            left_out.append(task.left_out())
            continue
        found = tuple(
            timings_of(bench, simulated(task.shape, task.recording), task.method, task.recording, budget.left)
        )
        if len(found[0].wall) <= bench.frames:
            left_out.append(task.left_out(f" after {len(found[0].wall)} of {bench.frames + 1} frames"))
        timings += found
    if bench.recordings == 1:
        left_out += _memory(bench, timings, budget, memory)
    return Bench(tuple(timings), memory, tuple(left_out), mats)


def _memory(
    bench: BenchFile, timings: Sequence[Timing], budget: _Budget, memory: dict[tuple[Shape, str, str], float]
) -> Iterator[LeftOut]:
    """Fill in the peaks of panels that are asked for, and yield those for which there is no time."""
    for timing in timings:
        if timing.shape[0] != timing.shape[1] or timing.shape[0] not in bench.memory:
            continue
        if STARTED_S + float(np.sum(timing.times()[:2])) > budget.left():
            yield LeftOut(timing.shape, timing.method, f"memory of {timing.solver}")
        else:
            memory[timing.shape, timing.method, timing.solver] = peak_memory(
                bench, timing.shape, timing.method, timing.solver
            )
