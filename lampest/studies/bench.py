"""The benchmark: every frame of simulated recordings, solved by every solver in turn for as long as there is time."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from time import perf_counter
from typing import Any, Literal

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.estimate.sequence import resting_readings
from lampest.files.typed import Configuration, check_range, check_ranges
from lampest.loads.shapes import AnyShape, Rod
from lampest.panel.kirchhoff import laplacian
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.pressure import Course
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.solvers.multistart import best_solution, convex, evaluated
from lampest.solvers.preconditioners import Preconditioner
from lampest.solvers.solution import Settings, Solution, Solver, check
from lampest.studies.methods import (
    BREATHING,
    LARGEST_SIDE,
    SERIES_OHM,
    Shape,
    Sizes,
    SquaredMethod,
    check_sides,
    lamprey_mouth,
    paper_methods,
    shapes_of,
)
from lampest.studies.study import published_code
from lampest.studies.timing import TimedFrames, Timing, clocked, inverse_time, peak_memory

OURS: dict[str, MethodName] = {"reduced": "reduced", "nodal": "nodal"}
SOLVERS = (*OURS, "scipy_exact", "scipy_difference", "scipy_lbfgsb")


def loads(number: int, shape: Shape) -> tuple[tuple[AnyShape, ...], Course]:
    """What touches the panel in recording `number`, and when; recordings 0, 1, 2 differ, then they come again.

    0 : a mouth over a third of the shorter side, sucking ever harder, breathing. 1 : three rods that stand. 2 : a mouth
    of 35 mm that presses ever harder, then sucks, beside a rod.
    """
    pitch = Panel(*shape).pitch_mm
    height, width = (pitch * (side - 1) for side in shape)
    places = ((0.3, 0.3, 680.0), (0.7, 0.35, 300.0), (0.4, 0.75, 1200.0))  # shares of width and height, mass in g
    rods = tuple(
        Rod(kind="rod", centre_mm=(right * width, down * height), diameter_mm=40, mass_g=mass)
        for right, down, mass in places
    )
    third = lamprey_mouth((0.49 * width, 0.51 * height), 0.35 * pitch * min(shape))
    growing = replace(BREATHING, start_s=-0.4, approach_s=2)
    beside = (lamprey_mouth((0.6 * width, 0.55 * height)), rods[0])
    return (((third,), BREATHING), (rods, Course()), (beside, growing))[number % 3]


@dataclass(frozen=True)
class BenchLimits(Configuration):
    """The largest side, max(rows, columns), at which a solver is run; 0: not at all.

    scipy_exact, scipy_difference : scipy's trf with the closed-form Jacobian, and with finite differences.
    scipy_lbfgsb : scipy's L-BFGS-B with the closed-form gradient.
    joint : no solver, but the first pair of relative methods: on larger panels their first frame starts from a baseline
    that was solved alone.
    """

    reduced: int = LARGEST_SIDE
    nodal: int = 16
    scipy_exact: int = 16
    scipy_difference: int = 10
    scipy_lbfgsb: int = 10
    joint: int = 10


@dataclass(frozen=True)
class BenchFile(Configuration):
    """What is compared.

    Parameters
    ----------
    sizes : sides of square panels, or [rows, columns].
    estimators : methods by name, their terms as in a run's file; the paper's five by default.
    recordings : simulated recordings of every panel, each with loads and noise of its own.
    frames, repeats : frames after the first, solved in sequence, and how often each is solved by every solver.
    budget_s : no solve is begun that would probably not end within so many seconds; what is left out is named.
    seed, readout, unmodelled : of the simulated recordings, as in a simulation's file.
    lines : of their scenes; nodal does not know wire and is left out then.
    solver : tolerance and iterations, the same for all.
    limits : the largest side for each solver.
    memory : sides of panels on which the peak memory of a fresh process is measured.

    Raises ValueError where a number is out of range.
    """

    schema: Literal[1]
    sizes: Sizes
    estimators: dict[str, SquaredMethod] = field(default_factory=lambda: paper_methods(SquaredMethod))
    recordings: int = 1
    frames: int = 4
    repeats: int = 3
    budget_s: float = 3600.0
    seed: int = 1
    readout: TwoPointReadout = TwoPointReadout(noise_lsb=0.7)
    unmodelled: Unmodelled = field(default_factory=Unmodelled)
    lines: Lines | None = None
    solver: Settings = Settings()
    limits: BenchLimits = BenchLimits()
    memory: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.sizes or not self.estimators:
            raise ValueError("sizes and estimators must hold at least one")
        check_sides(self.shapes, 2, LARGEST_SIDE)
        check_range("a panel's side", self.memory, 2, LARGEST_SIDE)
        for rows, columns in self.shapes:
            if not self.solvers((rows, columns)):
                raise ValueError(f"limits leave no solver for {rows} × {columns}")
        check_ranges(self, 1, 1000, "recordings", "frames", "repeats")
        check_ranges(self, 1e-3, 30 * 86400, "budget_s")

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """(rows, columns) of every panel."""
        return shapes_of(self.sizes)

    def solvers(self, shape: Shape) -> tuple[str, ...]:
        """The names of the solvers that run on a panel."""
        wired = self.lines is not None and self.lines.resist
        known = (name for name in SOLVERS if not (wired and name == "nodal"))
        return tuple(name for name in known if max(shape) <= getattr(self.limits, name))

    def estimator(self, name: str, formulation: MethodName = "reduced") -> Estimator:
        """A method in a formulation."""
        return Estimator(self.estimators[name].parts, formulation, self.solver)

    def recording(self, shape: Shape, number: int = 0) -> Recording:
        """One of the recordings of a panel, its loads those of `loads`; 3 unloaded frames."""
        touching, course = loads(number, shape)
        scene = Scene(Panel(*shape), self.readout, SERIES_OHM, lines=self.lines)
        about: dict[str, Any] = {"frames": self.frames + 1, "loads": touching, "unmodelled": self.unmodelled}
        simulation = Simulation(1, self.seed + number, scene, course=course, **about)
        return simulate(simulation, f"{shape[0]}x{shape[1]}")


@dataclass(frozen=True, eq=False)
class TimedSolve:
    """One solve: its outcome, and the cost where it ended; wall, cpu : s."""

    solution: Solution
    objective: float
    wall: float
    cpu: float


def solver_of(bench: BenchFile, method: str, name: str, data: Data) -> Solver:
    """A solver by its name for such data, built before anything is timed."""
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
    """Makes the data of a frame anew for every solve, so that none finds what another has computed.

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


def solve_two_frames(task: tuple[BenchFile, Shape, str, str]) -> None:
    """A first frame and the next, for the memory that they take. Beyond its limit no pair is solved jointly."""
    bench, shape, method, name = task
    recording = bench.recording(shape)
    previous = first_estimate(bench, recording, method)
    for frame in range(2):
        data = frame_data(bench, recording, method, frame, previous)()
        solver = solver_of(bench, method, name, data)
        solution = timed(name, solver, data, None if previous is None else previous[None]).solution
        previous = solution.cell_resistance[-1] if solution.solved else previous


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

    def expected_s(self, bench: BenchFile, done: Sequence[Timing]) -> float:
        """As on another recording of the panel; else as on the largest one that is smaller, growing as (M + N)³."""
        solvers, lines = bench.solvers(self.shape), sum(self.shape)
        alike = [one for one in done if one.method == self.method and one.solver in solvers and sum(one.shape) <= lines]
        nearest = max((sum(one.shape) for one in alike), default=0)
        alike = [one for one in alike if sum(one.shape) == nearest]
        if not alike:
            return 0.0
        recordings = len({(one.shape, one.recording) for one in alike})
        return float(sum(np.nansum(one.wall) for one in alike)) / recordings * (lines / nearest) ** 3


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

    All panels' first recordings come first, smallest panels before larger ones, with the memory that they take.
    """
    end = perf_counter() + bench.budget_s
    numbers = range(bench.recordings)
    parts = [
        BenchPart(number, shape, name) for number in numbers for shape in bench.shapes for name in bench.estimators
    ]
    timings: list[Timing] = []
    peaks: dict[tuple[Shape, str, str], float] = {}
    missed: list[LeftOut] = []
    simulated = lru_cache(maxsize=1)(bench.recording)
    for number, part in enumerate(parts):
        on_step(number, len(parts), str(part))
        name = f"recording {part.recording + 1}"
        if part.expected_s(bench, timings) > end - perf_counter():
            missed.append(LeftOut(part.shape, part.method, name))
            continue
        found = list(_timings(bench, simulated(part.shape, part.recording), part, end))
        timings += found
        if (frames := len(found[0].wall)) <= bench.frames:
            missed.append(LeftOut(part.shape, part.method, f"{name} after {frames} of {bench.frames + 1} frames"))
        measured = not part.recording and part.shape in {(side, side) for side in bench.memory}
        for one in found if measured else ():
            about = one.shape, one.method, one.solver
            if 3.0 + float(np.sum(one.times()[:2])) > end - perf_counter():  # s that a fresh process takes to begin
                missed.append(LeftOut(one.shape, one.method, f"memory of {one.solver}"))
            else:
                peaks[about] = peak_memory(solve_two_frames, (bench, *about))
    return Bench(bench, tuple(timings), peaks, tuple(missed))


def _timings(bench: BenchFile, recording: Recording, part: BenchPart, end: float) -> Iterator[Timing]:
    """The timings of all solvers; later frames are left out once there is less time than the last one took."""
    names, method = bench.solvers(part.shape), part.method
    relative, matrix = bench.estimator(method).relative, laplacian(np.ones(part.shape))[1:, 1:]
    best = begun = first_estimate(bench, recording, method)
    wall, cpu = np.full((2, len(names), bench.frames + 1, bench.repeats), np.nan)
    first: list[list[TimedSolve]] = []  # turn of every frame
    inverses: list[float] = []
    sizes: list[float] = []
    kept: dict[str, Preconditioner | None] = {}
    for number in range(bench.frames + 1):
        if number and np.nansum(wall[:, number - 1]) > end - perf_counter():
            break
        fresh = frame_data(bench, recording, method, number, best)
        solvers = {name: solver_of(bench, method, name, fresh()) for name in names}
        previous = None if best is None else best[None]
        solved: list[Solution] = []
        for turn in range(bench.repeats if number else 1):
            solves = [
                timed(name, solver, replace(fresh(), first=not number), previous, kept.get(name))
                for name, solver in solvers.items()
            ]
            wall[:, number, turn], cpu[:, number, turn] = np.transpose([(one.wall, one.cpu) for one in solves])
            solved += [one.solution for one in solves if one.solution.solved]
            first += [] if turn else [solves]
            inverses.append(inverse_time(matrix))
            if sum(one.wall for one in solves) > 1.0:  # disturbances are small beside so many s
                break
        kept = {name: one.solution.kept for name, one in zip(names, solves, strict=True)}
        sizes.append(float(np.sum(fresh().measured ** 2)))
        if solved:
            best = min(solved, key=lambda solution: solution.objective).cell_resistance[-1]
        elif best is None and relative:
            best = resting_cells(bench, recording, method)
    objective = np.array([[one.objective for one in solves] for solves in first])
    reached = np.nan_to_num(objective, nan=np.inf)
    least = reached.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        gaps = (reached - least) / (least + 1e-9 * np.array(sizes)[:, None])
    gaps = np.where(np.isnan(gaps), np.inf, gaps) if len(names) > 1 else np.full(gaps.shape, np.nan)
    turns = np.isfinite(wall).any(axis=(0, 1))
    for own, name in enumerate(names):
        yield Timing(
            wall=wall[own][: len(first), turns],
            cpu=cpu[own][: len(first), turns],
            objective=objective[:, own],
            gap=gaps[:, own],
            **TimedFrames.ends([solves[own].solution for solves in first]),
            shape=part.shape,
            method=method,
            solver=name,
            recording=part.recording,
            pair=relative and begun is None,
            inverse_s=float(np.median(inverses)),
        )
