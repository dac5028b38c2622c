"""The measurement: every frame solved by every solver in turn, panel by panel, for as long as there is time."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.estimate.sequence import resting_readings
from lampest.panel.kirchhoff import laplacian
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.solvers.multistart import best_solution, convex, evaluated
from lampest.solvers.preconditioners import Preconditioner
from lampest.solvers.solution import STRICT, Settings, Solution, Solver, check
from lampest.studies.bench.settings import BenchFile
from lampest.studies.methods import Shape
from lampest.studies.study import published_code
from lampest.studies.timing import TimedFrames, clocked, inverse_time, peak_memory, undisturbed

OURS: dict[str, MethodName] = {"reduced": "reduced", "nodal": "nodal"}
LONG_S = 1.0  # solves of a frame that take so long together are not repeated: disturbances are small beside them
STARTED_S = 3.0  # what a fresh process takes to begin


@dataclass(frozen=True, eq=False)
class TimedSolve:
    """One solve: its outcome, and what the cost is where it ended; s."""

    solution: Solution
    objective: float
    wall: float
    cpu: float


def solver_of(bench: BenchFile, method: str, name: str, data: Data) -> Solver:
    """A solver by its name for such data, built before anything is timed; kept for the frames to come."""
    frames, *shape = data.measured.shape
    scene = Scene(Panel(*shape))
    if name in OURS:
        solver = bench.estimator(method, OURS[name]).problem(scene, frames, 1.0, data.partial)
    else:
        solver = other_solver(name, bench.estimator(method).cost(scene, frames, data.partial), bench.solver)
    solver.prepare()
    return solver


@lru_cache(maxsize=8)
def other_solver(name: str, cost: Cost, settings: Settings) -> Solver:
    """One of scipy's."""
    solver: Solver = published_code("published_solvers").SOLVERS[name](cost, settings)
    return solver


def timed(
    name: str, solver: Solver, data: Data, previous: Array | None, kept: Preconditioner | None = None
) -> TimedSolve:
    """Solve as a sequence does; scipy's from the cheapest of the same starts, checked as ours are."""
    if name in OURS:
        solution, wall, cpu = clocked(lambda: best_solution(solver, data, previous, kept))
        return TimedSolve(solution, solution.objective, wall, cpu)

    def judged() -> tuple[Solution, Array]:
        plain = all(term.reads_measurement for term in solver.cost.terms)
        starts = [data.uniform_start]
        starts += [convex(data, previous)] if previous is None or plain else []
        starts += [] if previous is None else [previous]
        start = min((evaluated(solver.cost, data, start) for start in starts), key=lambda point: point.objective)
        outcome = solver.solve(data, start)
        return check(start, outcome), outcome.cell_resistance

    (solution, cells), wall, cpu = clocked(judged)
    return TimedSolve(solution, evaluated(solver.cost, data, cells).objective, wall, cpu)


def first_estimate(bench: BenchFile, recording: Recording, method: str) -> Array | None:
    """The cells (rows, columns) ohm that the first frame goes on from; None where it is a cold start."""
    joint = max(recording.scene.panel.shape) <= bench.limits.joint
    return resting_cells(bench, recording, method) if bench.estimator(method).relative and not joint else None


def frame_data(
    bench: BenchFile, recording: Recording, method: str, frame: int, previous: Array | None
) -> Callable[[], Data]:
    """What makes the data of a frame anew for every solve, so that none finds what another has computed.

    A relative method without a previous frame takes the baseline in.
    """
    estimator, readings = bench.estimator(method), recording.readings()
    resting, measured = resting_readings(recording, readings), readings[recording.measured_frames()[frame]]
    if previous is not None or not estimator.relative:
        background = Background(recording.scene, previous=previous if estimator.relative else None)
        return lambda: estimator.data(measured.alone(), background)
    return lambda: estimator.data(resting.together(measured), Background(recording.scene))


def resting_cells(bench: BenchFile, recording: Recording, method: str) -> Array:
    """The baseline's cells (rows, columns) ohm by the terms that need no previous frame, else a uniform panel's."""
    terms = tuple(term for term in bench.estimators[method].parts if not term.needs_previous) or (Misfit(),)
    estimator, scene = Estimator(terms, "reduced", bench.solver), recording.scene
    data = estimator.data(resting_readings(recording, recording.readings()).alone(), Background(scene))
    solution = best_solution(estimator.problem(scene, 1, 1.0, data.partial), data, None)
    cells: Array = solution.cell_resistance[0] if solution.solved else data.uniform_start[0]
    return cells


def grounded_laplacian(recording: Recording) -> Array:
    """The Laplacian of size M + N − 1 of a network like the recording's."""
    circuit = recording.scene.circuit
    cells = circuit.uniform_start(recording.readings().value[0])
    return (laplacian(1 / cells) + np.diag(circuit.ties(cells)))[1:, 1:]


def solve_two_frames(task: tuple[BenchFile, tuple[int, int], str, str]) -> None:
    """A first frame and the next, for the memory that they take. Beyond its limit no pair is solved jointly."""
    bench, shape, method, name = task
    recording = bench.recording(shape)
    previous = first_estimate(bench, recording, method)
    for frame in range(2):
        data = frame_data(bench, recording, method, frame, previous)()
        solver = solver_of(bench, method, name, data)
        solution = timed(name, solver, data, None if previous is None else previous[None]).solution
        previous = solution.cell_resistance[-1] if solution.solved else previous


@dataclass(frozen=True, eq=False)
class Timing(TimedFrames):
    """One solver with one method on one recording of a panel; the first frame is a cold start and not repeated.

    recording : its number. inverse_s : seconds of a dense inverse of the panel's lines at that time.
    pair : whether the first frame was solved jointly with the baseline.
    gap : (φ − φ_best)/(φ_best + 1e-9·Σ R²) against the best that any solver found for the same data; NaN where there
    was no other. The last part is the cost of missing every reading by 0.003 %: less is nothing.
    """

    shape: Shape
    method: str
    solver: str
    recording: int
    pair: bool
    inverse_s: float

    def times(self) -> Array:
        """(frames) s: median of a frame's wall times; the processor's where something else disturbed it."""
        return np.asarray(np.nanmedian(np.where(undisturbed(self.wall, self.cpu), self.wall, self.cpu), axis=1))

    def clean(self) -> float:
        """The share of undisturbed solves."""
        return float(np.mean(undisturbed(self.wall, self.cpu)[np.isfinite(self.wall)]))

    def verified(self) -> NDArray[np.bool_]:
        """(frames) whether the optimum was verified."""
        return np.array([status in {strict.value for strict in STRICT} for status in self.status])


@dataclass(frozen=True)
class LeftOut:
    """A method on a panel for which there was no time; what of it."""

    shape: Shape
    method: str
    what: str


@dataclass(frozen=True)
class BenchPart:
    """A method on one recording of a panel."""

    recording: int
    shape: Shape
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
        return float(sum(spent.values())) / recordings * (lines / nearest) ** 3


@dataclass(frozen=True, eq=False)
class Bench:
    """timings : of every solver. memory_mb : by panel, method and solver, 10⁶ bytes; NaN where the process died.

    left_out : for want of time.
    """

    settings: BenchFile
    timings: tuple[Timing, ...]
    memory_mb: dict[tuple[Shape, str, str], float]
    left_out: tuple[LeftOut, ...] = ()

    def inverse_s(self, shape: Shape) -> float:
        """Seconds of one dense inverse of a panel's lines."""
        return float(np.median([timing.inverse_s for timing in self.timings if timing.shape == shape]))


def run_bench(bench: BenchFile, on_step: Callable[[int, int, str], None] = lambda done, total, what: None) -> Bench:
    """Measure everything, as far as the budget goes; on_step is called with how many of how many parts are done, and
    what is next.

    All panels' first recordings come first, smallest panels before larger ones, with the memory that they take:
    there is no time for other recordings, if for anything.
    """
    end = perf_counter() + bench.budget_s
    parts = [
        BenchPart(number, shape, name)
        for number in range(bench.recordings)
        for shape in bench.shapes
        for name in bench.estimators
    ]
    timings: list[Timing] = []
    peaks: dict[tuple[Shape, str, str], float] = {}
    missed: list[LeftOut] = []
    simulated = lru_cache(maxsize=1)(bench.recording)
    for number, part in enumerate(parts):
        on_step(number, len(parts), str(part))
        if part.expected_s(bench, timings) > end - perf_counter():
            missed.append(part.left_out())
            continue
        found = list(_timings(bench, simulated(part.shape, part.recording), part, end))
        timings += found
        if len(found[0].wall) <= bench.frames:
            missed.append(part.left_out(f" after {len(found[0].wall)} of {bench.frames + 1} frames"))
        if part.recording or part.shape not in {(side, side) for side in bench.memory}:
            continue
        for one in found:
            about = one.shape, one.method, one.solver
            if STARTED_S + float(np.sum(one.times()[:2])) > end - perf_counter():
                missed.append(LeftOut(one.shape, one.method, f"memory of {one.solver}"))
            else:
                peaks[about] = peak_memory(solve_two_frames, (bench, *about))
    return Bench(bench, tuple(timings), peaks, tuple(missed))


def _timings(bench: BenchFile, recording: Recording, part: BenchPart, end: float) -> Iterator[Timing]:
    """The timings of all solvers; later frames are left out once there is less time than the last one took."""
    names, method = bench.solvers(part.shape), part.method
    relative, matrix = bench.estimator(method).relative, grounded_laplacian(recording)
    best = begun = first_estimate(bench, recording, method)
    frames: list[list[list[TimedSolve]]] = []  # by frame, by turn, by solver
    inverses: list[float] = []
    sizes: list[float] = []
    kept: dict[str, Preconditioner | None] = {}
    for number in range(bench.frames + 1):
        if frames and sum(solve.wall for turn in frames[-1] for solve in turn) > end - perf_counter():
            break
        fresh = frame_data(bench, recording, method, number, best)
        solvers = {name: solver_of(bench, method, name, fresh()) for name in names}
        previous = None if best is None else best[None]
        turns: list[list[TimedSolve]] = []
        while len(turns) < (bench.repeats if number else 1):
            turns.append(
                [
                    timed(name, solver, replace(fresh(), first=not number), previous, kept.get(name))
                    for name, solver in solvers.items()
                ]
            )
            inverses.append(inverse_time(matrix))
            if sum(solve.wall for solve in turns[-1]) > LONG_S:
                break
        kept = {name: solve.solution.kept for name, solve in zip(solvers, turns[-1], strict=True)}
        frames.append(turns)
        sizes.append(float(np.sum(fresh().measured ** 2)))
        solved: list[Solution] = [solve.solution for turn in turns for solve in turn if solve.solution.solved]
        if solved:
            best = min(solved, key=lambda solution: solution.objective).cell_resistance[-1]
        elif best is None and relative:
            best = resting_cells(bench, recording, method)
    gaps = _gaps(frames, np.array(sizes))
    about: dict[str, Any] = {"shape": part.shape, "method": method, "recording": part.recording}
    about |= {"pair": relative and begun is None, "inverse_s": float(np.median(inverses))}
    for column, name in enumerate(names):
        own = [[turn[column] for turn in turns] for turns in frames]
        yield _timing(own, gap=gaps[:, column], solver=name, **about)


def _gaps(frames: list[list[list[TimedSolve]]], sizes: Array) -> Array:
    """(φ − φ_best)/(φ_best + nothing), (frames, solvers); NaN where a solver is alone, infinite where it left none."""
    reached = np.array([[solve.objective for solve in turns[0]] for turns in frames])
    if reached.shape[1] == 1:
        return np.full(reached.shape, np.nan)
    reached = np.nan_to_num(reached, nan=np.inf)
    least = reached.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        gaps = (reached - least) / (least + 1e-9 * sizes[:, None])
    return np.where(np.isnan(gaps), np.inf, gaps)


def _timing(frames: list[list[TimedSolve]], **about: Any) -> Timing:
    """frames : of one solver, every repeat of each."""
    wall, cpu = np.full((2, len(frames), max(map(len, frames))), np.nan)
    for frame, solves in enumerate(frames):
        wall[frame, : len(solves)] = [solve.wall for solve in solves]
        cpu[frame, : len(solves)] = [solve.cpu for solve in solves]
    first = [solves[0] for solves in frames]
    objective = np.array([solve.objective for solve in first])
    ends = TimedFrames.ends([solve.solution for solve in first])
    return Timing(wall=wall, cpu=cpu, objective=objective, **ends, **about)
