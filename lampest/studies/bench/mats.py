"""Random mats of as many readings as cells, solved without bounds or penalties by our solver and by published ones."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from lampest.cost.given import Background
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Bounds, Estimator
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.two_point.floating import FloatingNetwork, grounding
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.runs.terms import FORBID
from lampest.solvers.solution import Settings, Solver
from lampest.studies.bench.mat_solvers import PUBLISHED, MatAnswer
from lampest.studies.bench.timing import clocked, inverse_time, timed, undisturbed
from lampest.studies.bench.trf import Trf

LEAST_S, MOST_S = 2e-5, 2e-2  # conductances of the published test
OURS = ("reduced", "scipy_exact")
LARGEST_MAT, MOST_DRAWS = 64, 1000


@dataclass(frozen=True)
class Mats:
    """Cells whose conductances are uniform between 20 µS and 20 mS, read as R·(1 + noise·z), z standard normal.

    sides : of square mats. draws : mats of each side and noise. noise_percent : 0 as in the published test.
    Source: J. A. Medrano-Sánchez et al., IEEE Sensors J., 2019, doi 10.1109/JSEN.2019.2918592, and his programs.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = FORBID
    sides: tuple[int, ...] = (16,)
    draws: int = 5
    noise_percent: tuple[float, ...] = (0.0, 1.0)

    def __post_init__(self) -> None:
        if not all(2 <= side <= LARGEST_MAT for side in self.sides):
            raise ValueError(f"a mat's side must lie between 2 and {LARGEST_MAT}")
        if not all(0 <= noise <= 10 for noise in self.noise_percent):
            raise ValueError("noise_percent must lie between 0 and 10")
        if not 1 <= self.draws <= MOST_DRAWS:
            raise ValueError(f"draws must lie between 1 and {MOST_DRAWS}")


@dataclass(frozen=True)
class MatSolve:
    """One solver on one mat.

    seconds : of the solve, undisturbed. inverse_s : of one dense inverse of the mat's lines. evaluations : networks
    solved; None where nobody counts. converged : by the solver's own word, ours by the check outside it.
    reading_error, cell_error, worst_cell_error : largest of the readings, median and largest of the conductances, in
    percent; infinite where there is no answer. negative : cells with a conductance below zero.
    """

    side: int
    noise_percent: float
    draw: int
    solver: str
    seconds: float
    inverse_s: float
    iterations: int
    evaluations: int | None
    converged: bool
    reading_error: float
    cell_error: float
    worst_cell_error: float
    negative: int


def solved_mats(mats: Mats, seed: int, settings: Settings) -> Iterator[MatSolve]:
    """Every mat by every solver in turn."""
    for side in mats.sides:
        for noise in mats.noise_percent:
            for draw in range(mats.draws):
                generator = np.random.default_rng((seed, side, draw))
                conductance = generator.uniform(LEAST_S, MOST_S, (side, side))
                measured = network_readings(conductance) * (1 + noise / 100 * generator.standard_normal((side, side)))
                for solve in _solves(conductance, measured, settings):
                    yield MatSolve(side, noise, draw, *solve)


def network_readings(conductance: Array) -> Array:
    """R (rows, columns) ohm of conductances of any sign."""
    return FloatingNetwork.solve(conductance, grounding(1 / np.abs(conductance))).reading()


def _solves(truth: Array, measured: Array, settings: Settings) -> Iterator[tuple[Any, ...]]:
    inverse_s = inverse_time(np.linalg.inv(np.eye(sum(measured.shape) - 1) + 0.1))
    for name in (*OURS, *PUBLISHED):
        if name in OURS:
            answer, wall, cpu = _ours(name, measured, settings)
        else:
            answer, wall, cpu = clocked(partial(PUBLISHED[name], measured))
        seconds = float(undisturbed(np.array(wall), np.array(cpu)))
        counted = None if name in OURS else answer.evaluations
        yield name, seconds, inverse_s, answer.iterations, counted, answer.converged, *_errors(answer, truth, measured)


def _ours(name: str, measured: Array, settings: Settings) -> tuple[MatAnswer, float, float]:
    """Plain least squares without bounds, begun as always."""
    estimator = Estimator((Misfit(),), "reduced", settings, Bounds("none", "none"))
    scene = Scene(Panel(*measured.shape))
    data = estimator.data(Readings.of(scene, measured).alone(), Background(scene))
    solver: Solver = estimator.problem(scene, 1, 1.0)
    if name != "reduced":
        solver = Trf(estimator.cost(scene, 1), settings, "exact")
    solver.prepare()
    solve = timed(solver, data, None)
    solution = solve.solution
    return MatAnswer(1 / solution.cell_resistance[-1], solution.iterations, 0, solution.solved), solve.wall, solve.cpu


def _errors(answer: MatAnswer, truth: Array, measured: Array) -> tuple[float, float, float, int]:
    if not np.all(np.isfinite(answer.conductance)):
        return np.inf, np.inf, np.inf, 0
    reading = 100 * np.abs(network_readings(answer.conductance) / measured - 1)
    cells = 100 * np.abs(answer.conductance / truth - 1)
    return float(reading.max()), float(np.median(cells)), float(cells.max()), int(np.sum(answer.conductance < 0))
