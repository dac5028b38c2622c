"""What every solver is given: data, solvers by name, one solve of a frame. All calls of the solvers stand here."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

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
from lampest.solvers.solution import Settings, Solution, Solver, check
from lampest.studies.bench.settings import BenchFile
from lampest.studies.study import published_code
from lampest.studies.timing import clocked

OURS: dict[str, MethodName] = {"reduced": "reduced", "nodal": "nodal"}


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
