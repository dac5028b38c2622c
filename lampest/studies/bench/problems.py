"""What every solver is given: the data of a frame, where a sequence begins, and the solvers themselves."""

from collections.abc import Callable
from functools import lru_cache
from typing import Literal

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.cost.terms.misfit import Misfit
from lampest.estimate.estimator import Estimator
from lampest.panel.network import uniform_factor
from lampest.panel.panel import Array, Panel
from lampest.recording.readings import plain
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.solvers.search import best_solution
from lampest.solvers.solution import Settings, Solver
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.trf import Trf


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
    chosen = np.flatnonzero(recording.role == MEASURED)[frame]
    network, sigma = recording.network_resistance()[chosen], _sigma(recording)[chosen]
    if previous is not None or not estimator.relative:
        known = previous if estimator.relative else None
        return lambda: estimator.data(plain(network, sigma).alone(), known)
    resting, resting_sigma = _baseline(recording)
    return lambda: estimator.data(plain(resting, resting_sigma).together(plain(network, sigma)))


def _sigma(recording: Recording) -> Array:
    """(frames, rows, columns) ohm; a benchmark's scenes have a readout."""
    sigma = recording.sigma_or_none()
    return np.ones_like(recording.resistance) if sigma is None else sigma


def _baseline(recording: Recording) -> tuple[Array, Array]:
    """Mean of the unloaded readings and its σ, (rows, columns) ohm."""
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    noise = np.sqrt(np.sum(_sigma(recording)[unloaded] ** 2, axis=0)) / len(unloaded)
    return recording.network_resistance()[unloaded].mean(axis=0), noise


def resting_cells(bench: BenchFile, recording: Recording, method: str) -> Array:
    """The baseline's cells (rows, columns) ohm by the terms that need no previous frame, else a uniform panel's."""
    terms = tuple(term for term in bench.estimators[method].parts if not term.needs_previous) or (Misfit(),)
    estimator = Estimator(terms, "reduced", bench.solver)
    resting, noise = _baseline(recording)
    solver = estimator.problem(recording.scene.panel, 1, 1.0)
    solution = best_solution(solver, estimator.data(plain(resting, noise).alone()), None)
    cells: Array = solution.cell_resistance[0] if solution.solved else resting / uniform_factor(*resting.shape)
    return cells


def solver_of(bench: BenchFile, method: str, name: str, panel: Panel, frames: int) -> Solver:
    """A solver by its name, built before anything is timed; kept, like those of a run, for the frames to come."""
    solver: Solver
    if name in ("reduced", "nodal"):
        solver = bench.estimator(method, "reduced" if name == "reduced" else "nodal").problem(panel, frames, 1.0)
    else:
        cost = Cost(Panel(*panel.shape), bench.estimators[method].parts, frames)
        solver = _trf(cost, bench.solver, "exact" if name == "scipy_exact" else "2-point")
    solver.prepare()
    return solver


@lru_cache(maxsize=8)
def _trf(cost: Cost, settings: Settings, jacobian: Literal["exact", "2-point"]) -> Trf:
    return Trf(cost, settings, jacobian)
