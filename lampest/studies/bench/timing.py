"""How long a solve takes, and the times that nothing disturbed."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data
from lampest.panel.panel import Array
from lampest.solvers.newton.directions import Factor
from lampest.solvers.search import best_solution
from lampest.solvers.solution import STRICT, Solution, Solver, check
from lampest.solvers.starts import convex, evaluated
from lampest.studies.bench.lbfgsb import Lbfgsb
from lampest.studies.bench.trf import Trf

Result = TypeVar("Result")
# A wall time is disturbed that exceeds the processor's by more than this share and a tenth of a millisecond.
DISTURBED, CLOCK_S = 1.05, 1e-4
LEAST_S = 2e-3  # a measurable time


@dataclass(frozen=True, eq=False)
class Timing:
    """One solver with one method on one recording of a panel; the first frame is a cold start.

    recording : its number. inverse_s : seconds of a dense inverse of the panel's lines at that time.
    pair : whether the first frame was solved jointly with the baseline.
    wall, cpu : (frames, repeats) s; NaN where a frame was not repeated, as the first is not, nor those that take long.
    objective, iterations, solved, status : (frames), of the first repeat.
    gap : (frames) (φ − φ_best)/(φ_best + 1e-9·Σ R²) against the best that any solver found for the same data; NaN where
    there was no other. The last part is the cost of missing every reading by 0.003 %: less is nothing.
    """

    shape: tuple[int, int]
    method: str
    solver: str
    recording: int
    pair: bool
    inverse_s: float
    wall: Array
    cpu: Array
    objective: Array
    gap: Array
    iterations: NDArray[np.int64]
    solved: NDArray[np.bool_]
    status: tuple[str, ...]

    def times(self) -> Array:
        """(frames) s: median of the undisturbed times of a frame."""
        return np.asarray(np.nanmedian(undisturbed(self.wall, self.cpu), axis=1))

    def clean(self) -> float:
        """The share of solves that nothing held up."""
        solves = np.isfinite(self.wall)
        return float(np.mean(_clean(self.wall, self.cpu)[solves]))

    def verified(self) -> NDArray[np.bool_]:
        """(frames) whether the optimum was verified."""
        return np.array([status in {strict.value for strict in STRICT} for status in self.status])


@dataclass(frozen=True, eq=False)
class TimedSolve:
    """One solve: its outcome, and what the cost is where it ended; s."""

    solution: Solution
    objective: float
    wall: float
    cpu: float


def undisturbed(wall: Array, cpu: Array) -> Array:
    """Wall times; the processor's where something else has held the processor up."""
    return np.where(_clean(wall, cpu), wall, cpu)


def _clean(wall: Array, cpu: Array) -> NDArray[np.bool_]:
    return np.asarray(wall <= DISTURBED * cpu + CLOCK_S)


def clocked(call: Callable[[], Result]) -> tuple[Result, float, float]:
    """What a call returns, its wall time and the processor's, s."""
    wall, cpu = perf_counter(), process_time()
    result = call()
    return result, perf_counter() - wall, process_time() - cpu


def timed(solver: Solver, data: Data, previous: Array | None, kept: Factor | None = None) -> TimedSolve:
    """Solve as a sequence does, which keeps a factor; scipy's from the cheapest of the same starts."""
    if isinstance(solver, Trf | Lbfgsb):
        (solution, cells), wall, cpu = clocked(lambda: _judged(solver, data, previous))
        return TimedSolve(solution, evaluated(solver.cost, data, cells).objective, wall, cpu)
    solution, wall, cpu = clocked(lambda: best_solution(solver, data, previous, kept))
    return TimedSolve(solution, solution.objective, wall, cpu)


def _judged(solver: Trf | Lbfgsb, data: Data, previous: Array | None) -> tuple[Solution, Array]:
    """The checked solution, and the cells where the solver ended."""
    plain = all(term.reads_measurement for term in solver.cost.terms)
    starts = [data.uniform_start]
    starts += [convex(data, previous)] if previous is None or plain else []
    starts += [] if previous is None else [previous]
    points = [evaluated(solver.cost, data, start) for start in starts]
    start = min(points, key=lambda point: point.objective)
    outcome = solver.solve(data, start)
    return check(start, outcome), outcome.cell_resistance


def inverse_time(matrix: Array) -> float:
    """Seconds of one dense inverse, from as many as make a measurable time; the least of three tries."""
    count = 1
    while (spent := _inverses_time(matrix, count)) < LEAST_S:
        count *= 2
    return min(spent, *(_inverses_time(matrix, count) for _ in range(2))) / count


def _inverses_time(matrix: Array, count: int) -> float:
    """Seconds of so many inverses."""
    begin = perf_counter()
    for _ in range(count):
        np.linalg.inv(matrix)
    return perf_counter() - begin
