"""The measurement: every frame solved by every solver in turn, A B C A B C, and the times that nothing disturbed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data
from lampest.panel.kirchhoff import laplacian
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.solvers.newton.directions import Factor
from lampest.solvers.newton.newton import Newton
from lampest.solvers.search import best_solution, convex, evaluated
from lampest.solvers.solution import Solution, Solver, check
from lampest.studies.bench.memory import peak_memory
from lampest.studies.bench.problems import first_estimate, frame_data, resting_cells, solver_of
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.trf import Trf

DISTURBED = 1.05
LEAST_S = 2e-3
NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class Timing:
    """One solver with one method on one panel; the first frame is a cold start.

    Relative methods solve it with the baseline, or, beyond the limit for that, go on from the baseline's cells.

    wall, cpu : (frames, repeats) s; NaN where a frame was not repeated: the first is solved once.
    objective, iterations, solved, status : (frames), of the first repeat.
    gap : (frames) (φ − φ_best)/(φ_best + 1e-9·Σ R²) against the best that any solver found for the same data. The last
    part is the cost of missing every reading by 0.003 %: less is nothing.
    """

    shape: tuple[int, int]
    method: str
    solver: str
    wall: Array
    cpu: Array
    objective: Array
    gap: Array
    iterations: NDArray[np.int64]
    solved: NDArray[np.bool_]
    status: tuple[str, ...]

    def times(self) -> Array:
        """(frames) s: median of the wall times; of the processor's where something else has held the processor up."""
        clean = self.wall <= DISTURBED * self.cpu + 1e-4
        return np.asarray(np.nanmedian(np.where(clean, self.wall, self.cpu), axis=1))

    def clean(self) -> float:
        """The share of solves that nothing held up."""
        solves = np.isfinite(self.wall)
        return float(np.mean((self.wall <= DISTURBED * self.cpu + 1e-4)[solves]))


@dataclass(frozen=True, eq=False)
class Bench:
    """timings : of every solver. inverse_s : seconds of one dense inverse by panel. memory_mb : by panel."""

    timings: tuple[Timing, ...]
    inverse_s: dict[tuple[int, int], float]
    memory_mb: dict[tuple[int, int], float]


@dataclass(frozen=True, eq=False)
class _BenchRun:
    """One solve: its outcome, and what the cost is where it ended."""

    solution: Solution
    objective: float
    wall: float
    cpu: float


def run_bench(bench: BenchFile, on_step: Callable[[int, int], None] = lambda done, total: None) -> Bench:
    """Measure everything. on_step is told how many of how many (panel, method) pairs are done."""
    memory = {(side, side): peak_memory(bench, (side, side)) for side in bench.memory}
    total = len(bench.shapes) * len(bench.estimators)
    timings: list[Timing] = []
    inverses: dict[tuple[int, int], float] = {}
    done = 0
    for shape in bench.shapes:
        recording = bench.recording(shape)
        inverse_times: list[float] = []
        for method in bench.estimators:
            timings += _measure(bench, recording, method, inverse_times)
            done += 1
            on_step(done, total)
        inverses[shape] = float(np.median(inverse_times))
    return Bench(tuple(timings), inverses, memory)


def _measure(bench: BenchFile, recording: Recording, method: str, inverse_times: list[float]) -> Iterator[Timing]:
    """One method on one panel by all its solvers; the time of inverses is taken in between and added to the list."""
    shape = recording.scene.panel.shape
    names = bench.solvers(shape)
    runs: dict[str, list[list[_BenchRun]]] = {name: [] for name in names}
    matrix = _tied(recording)
    best = first_estimate(bench, recording, method)
    sizes: list[float] = []
    kept: Factor | None = None
    for frame in range(bench.frames + 1):
        fresh = frame_data(bench, recording, method, frame, best)
        example = fresh()
        solvers = {name: _following(solver_of(bench, method, name, example), kept) for name in names}
        turns: list[list[_BenchRun]] = []
        sizes.append(float(np.sum(example.measured**2)))
        for _ in range(bench.repeats if frame else 1):
            turns.append([_timed(solver, fresh(), None if best is None else best[None]) for solver in solvers.values()])
            inverse_times.append(_inverse_time(matrix))
        for name, row in zip(names, zip(*turns, strict=True), strict=True):
            runs[name].append(list(row))
        solved = [run.solution for row in turns for run in row if run.solution.solved]
        kept = next((solution.factor for solution in solved if solution.factor is not None), None)
        if solved:
            best = min(solved, key=lambda solution: solution.objective).cell_resistance[-1]
        elif best is None and bench.estimator(method, "reduced").relative:
            best = resting_cells(bench, recording, method)
    least = np.nanmin([[row[0].objective for row in rows] for rows in runs.values()], axis=0)
    for name, rows in runs.items():
        yield _timing(shape, method, name, rows, least, NOTHING * np.array(sizes))


def _following(solver: Solver, kept: Factor | None) -> Solver:
    """A solver with what a sequence keeps from the frame before."""
    return solver.following(kept) if isinstance(solver, Newton) else solver


def _timing(
    shape: tuple[int, int], method: str, name: str, rows: list[list[_BenchRun]], least: Array, nothing: Array
) -> Timing:
    objective = np.array([row[0].objective for row in rows])
    wall, cpu = np.full((2, len(rows), max(len(row) for row in rows)), np.nan)
    for frame, row in enumerate(rows):
        wall[frame, : len(row)] = [run.wall for run in row]
        cpu[frame, : len(row)] = [run.cpu for run in row]
    return Timing(
        shape,
        method,
        name,
        wall,
        cpu,
        objective,
        (objective - least) / (least + nothing),
        np.array([row[0].solution.iterations for row in rows], dtype=np.int64),
        np.array([row[0].solution.solved for row in rows]),
        tuple(row[0].solution.status.value for row in rows),
    )


def _timed(solver: Solver, data: Data, previous: Array | None) -> _BenchRun:
    """Solve as a sequence does; scipy's from the cheapest of the same starts."""
    wall, cpu = perf_counter(), process_time()
    if isinstance(solver, Trf):
        plain = all(term.reads_measurement for term in solver.cost.terms)
        starts = [data.uniform_start]
        starts += [convex(data, previous)] if previous is None or plain else []
        starts += [] if previous is None else [previous]
        points = [evaluated(solver.cost, data, start) for start in starts]
        start = min(points, key=lambda point: point.objective)
        outcome = solver.solve(data, start)
        solution = check(start, outcome)
        wall, cpu = perf_counter() - wall, process_time() - cpu
        return _BenchRun(solution, evaluated(solver.cost, data, outcome.cell_resistance).objective, wall, cpu)
    solution = best_solution(solver, data, previous)
    return _BenchRun(solution, solution.objective, perf_counter() - wall, process_time() - cpu)


def _tied(recording: Recording) -> Array:
    """The Laplacian of size M + N − 1 of a network like the recording's."""
    circuit = recording.scene.circuit
    cells = circuit.uniform_start(recording.readings().value[0])
    return (laplacian(1 / cells) + np.diag(circuit.ties(cells)))[1:, 1:]


def _inverse_time(matrix: Array) -> float:
    """Seconds of one dense inverse, from as many as make a measurable time; the least of three tries."""
    count = 1
    times: list[float] = []
    while len(times) < 3:
        begin = perf_counter()
        for _ in range(count):
            np.linalg.inv(matrix)
        spent = perf_counter() - begin
        if spent < LEAST_S and not times:
            count *= 2
        else:
            times.append(spent / count)
    return min(times)
