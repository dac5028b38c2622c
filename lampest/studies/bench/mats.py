"""Random mats of as many readings as cells, solved without bounds or penalties by our solver and by published ones."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lampest.cost.given import Background
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Bounds, Estimator
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.two_point.floating import FloatingNetwork, grounding
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.solution import Settings
from lampest.studies.bench.problems import other_solver, timed
from lampest.studies.bench.settings import Mats
from lampest.studies.study import Figures, Row, grouped, published_code, rows_of
from lampest.studies.timing import clocked, inverse_time, undisturbed

LEAST_S, MOST_S = 2e-5, 2e-2  # conductances of the published test
OURS = ("reduced", "scipy_exact")


@dataclass(frozen=True, eq=False)
class MatAnswer:
    """conductance : (rows, columns) siemens. evaluations : how often a network was solved. converged : so it says."""

    conductance: Array
    iterations: int
    evaluations: int
    converged: bool


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
    published: dict[str, Callable[[Array], MatAnswer]] = published_code("published_solvers").PUBLISHED
    for name in (*OURS, *published):
        if name in OURS:
            answer, wall, cpu = _ours(name, measured, settings)
        else:
            answer, wall, cpu = clocked(partial(published[name], measured))
        seconds = wall if undisturbed(np.array(wall), np.array(cpu)) else cpu
        counted = None if name in OURS else answer.evaluations
        yield name, seconds, inverse_s, answer.iterations, counted, answer.converged, *_errors(answer, truth, measured)


def _ours(name: str, measured: Array, settings: Settings) -> tuple[MatAnswer, float, float]:
    """Plain least squares without bounds, begun as always."""
    estimator = Estimator((Misfit(),), "reduced", settings, Bounds("none", "none"))
    scene = Scene(Panel(*measured.shape))
    data = estimator.data(Readings.of(scene, measured).alone(), Background(scene))
    reduced = name == "reduced"
    solver = estimator.problem(scene, 1, 1.0) if reduced else other_solver(name, estimator.cost(scene, 1), settings)
    solver.prepare()
    solve = timed(name, solver, data, None)
    solution = solve.solution
    return MatAnswer(1 / solution.cell_resistance[-1], solution.iterations, 0, solution.solved), solve.wall, solve.cpu


def _errors(answer: MatAnswer, truth: Array, measured: Array) -> tuple[float, float, float, int]:
    if not np.all(np.isfinite(answer.conductance)):
        return np.inf, np.inf, np.inf, 0
    reading = 100 * np.abs(network_readings(answer.conductance) / measured - 1)
    cells = 100 * np.abs(answer.conductance / truth - 1)
    return float(reading.max()), float(np.median(cells)), float(cells.max()), int(np.sum(answer.conductance < 0))


def _median(value: Callable[[MatSolve], float]) -> Callable[[Sequence[MatSolve]], float]:
    return lambda own: float(np.median([value(solve) for solve in own]))


MAT_FIGURES: Figures = {
    "side": lambda own: own[0].side,
    "noise_percent": lambda own: own[0].noise_percent,
    "solver": lambda own: own[0].solver,
    "ms": _median(lambda solve: 1e3 * solve.seconds),
    "inverses": _median(lambda solve: solve.seconds / solve.inverse_s),  # ms in dense inverses of the mat's lines
    "iterations": _median(lambda solve: solve.iterations),
    "evaluations": lambda own: None if own[0].evaluations is None else _median(lambda one: one.evaluations or 0)(own),
    "reading_error": lambda own: max(solve.reading_error for solve in own),
    "cell_error": _median(lambda solve: solve.cell_error),  # of the mats' medians, percent
    "worst_cell_error": lambda own: max(solve.worst_cell_error for solve in own),
    "negative": lambda own: sum(solve.negative for solve in own),
    "converged": lambda own: sum(solve.converged for solve in own),
    "count": len,
}


def mat_rows(solves: Sequence[MatSolve]) -> list[Row]:
    """By side, noise and solver: each on all mats."""
    return rows_of(grouped(solves, lambda one: (one.side, one.noise_percent, one.solver)).values(), MAT_FIGURES)
