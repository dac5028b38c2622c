"""What every solver is given: the data of a frame, where a sequence begins, and the solvers themselves."""

from collections.abc import Callable
from functools import lru_cache, partial

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
from lampest.solvers.search import best_solution
from lampest.solvers.solution import Settings, Solver
from lampest.studies.bench.lbfgsb import Lbfgsb
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.trf import Trf

# Ours by the formulation that stands for them; others by what builds them.
FORMULATIONS: dict[str, MethodName] = {"reduced": "reduced", "nodal": "nodal"}
YARDSTICKS: dict[str, Callable[[Cost, Settings], Solver]] = {
    "scipy_exact": partial(Trf, jacobian="exact"),
    "scipy_difference": partial(Trf, jacobian="2-point"),
    "scipy_lbfgsb": Lbfgsb,
}


def first_estimate(bench: BenchFile, recording: Recording, method: str) -> Array | None:
    """The cells (rows, columns) ohm that the first frame goes on from; None where it is a cold start."""
    relative = bench.estimator(method, "reduced").relative
    joint = max(recording.scene.panel.shape) <= bench.limits.joint
    return resting_cells(bench, recording, method) if relative and not joint else None


def frame_data(
    bench: BenchFile, recording: Recording, method: str, frame: int, previous: Array | None
) -> Callable[[], Data]:
    """What makes the data of a frame anew for every solve, so that none finds what another has computed.

    A relative method without a previous frame takes the baseline in.
    """
    estimator = bench.estimator(method, "reduced")
    readings = recording.readings()
    resting, measured = resting_readings(recording, readings), readings[recording.measured_frames()[frame]]
    if previous is not None or not estimator.relative:
        background = Background(recording.scene, previous=previous if estimator.relative else None)
        return lambda: estimator.data(measured.alone(), background)
    return lambda: estimator.data(resting.together(measured), Background(recording.scene))


def resting_cells(bench: BenchFile, recording: Recording, method: str) -> Array:
    """The baseline's cells (rows, columns) ohm by the terms that need no previous frame, else a uniform panel's."""
    terms = tuple(term for term in bench.estimators[method].parts if not term.needs_previous) or (Misfit(),)
    estimator = Estimator(terms, "reduced", bench.solver)
    scene = recording.scene
    data = estimator.data(resting_readings(recording, recording.readings()).alone(), Background(scene))
    solution = best_solution(estimator.problem(scene, 1, 1.0, data.partial), data, None)
    cells: Array = solution.cell_resistance[0] if solution.solved else data.uniform_start[0]
    return cells


def solver_of(bench: BenchFile, method: str, name: str, data: Data) -> Solver:
    """A solver by its name for such data, built before anything is timed; kept for the frames to come."""
    frames, *shape = data.measured.shape
    scene = Scene(Panel(*shape))
    if name in FORMULATIONS:
        solver = bench.estimator(method, FORMULATIONS[name]).problem(scene, frames, 1.0, data.partial)
    else:
        solver = _yardstick(name, bench.estimator(method, "reduced").cost(scene, frames, data.partial), bench.solver)
    solver.prepare()
    return solver


@lru_cache(maxsize=8)
def _yardstick(name: str, cost: Cost, settings: Settings) -> Solver:
    return YARDSTICKS[name](cost, settings)


def tied(recording: Recording) -> Array:
    """The Laplacian of size M + N − 1 of a network like the recording's."""
    circuit = recording.scene.circuit
    cells = circuit.uniform_start(recording.readings().value[0])
    return (laplacian(1 / cells) + np.diag(circuit.ties(cells)))[1:, 1:]
