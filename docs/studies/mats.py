"""Random mats with as many readings as cells, solved by our solver and by published ones.

The solvers have neither bounds nor penalties.

Run it with: python -m docs.studies.mats [--sides 16] [--draws 2] [--noise 0 1]; prints the table of
the page.

Conductances g with G(g) = G_m, as many readings as cells. G = 1/R are the conductances that are
read between every row and every column. Equations and settings are those of J. A. Medrano-Sánchez
et al., IEEE Sensors J., 2019, doi 10.1109/JSEN.2019.2918592, and of the programs that C. Medrano
published with them. They tolerate 6 µS in every G, of cells between 20 µS and 20 mS; `krylov_fine`
and `fixed_point` go to 10⁻¹² S instead, so that accuracy and time can be seen apart.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

import numpy as np
from scipy.optimize import NoConvergence, least_squares, newton_krylov

from docs.studies.bench import ScipyMethod
from lampest.apps.studies.common import clocked, inverse_time
from lampest.apps.studies.study import markdown
from lampest.cost.given import Background
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.panel.network import SolvedNetwork
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.floating import grounding
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.report.compare import grouped, screen_table
from lampest.report.words import text_of
from lampest.solvers.posed import Bounds
from lampest.solvers.solution import Settings

# conductances of the published test
MIN_S = 2e-5
MAX_S = 2e-2
OURS = ("reduced", "scipy_exact")
# the published test's step, iterations, what replaces g < 0, siemens
BETA = 0.1
MAX_STEPS = 1000
SMALLEST_S = 1e-18
FINE_S = 1e-12  # the published test's tolerance of the fixed point
COARSE_S = 6e-6  # what newton_krylov tolerates where it is told nothing
STEP_TOLERANCE = 1e-8  # the published test's xtol of least squares


@dataclass(frozen=True)
class Mats:
    """Random square mats with conductances that are uniform between 20 µS and 20 mS.

    Readings are R·(1 + noise·z), z standard normal.

    Attributes
    ----------
    sides : tuple of int
        Lines on each side of the mats.
    draws : int
        Mats of each side and noise.
    noise_percent : tuple of float
        Standard deviations of the relative noise.
    """

    sides: tuple[int, ...] = (16,)
    draws: int = 2
    noise_percent: tuple[float, ...] = (0.0, 1.0)


@dataclass(frozen=True, eq=False)
class MatAnswer:
    """conductance : (rows, columns) siemens.

    evaluations : how often a network was solved. converged : so it says.
    """

    conductance: Array
    iterations: int
    evaluations: int
    converged: bool


class CountedNetwork:
    """G(g) of a network, and the number of its evaluations.

    The readings (rows, columns) in ohm choose the ground.
    """

    def __init__(self, measured: Array) -> None:
        self.wanted = 1 / measured
        self._tie = grounding(measured)
        self._calls = count()

    def __call__(self, conductance: Array) -> Array:
        """(rows, columns) siemens."""
        next(self._calls)
        return 1 / SolvedNetwork.floating(conductance, self._tie).reading()

    def misfit(self, conductance: Array) -> Array:
        """G(g) − G_m."""
        return self(conductance.reshape(self.wanted.shape)) - self.wanted

    def evaluations(self) -> int:
        """So often until now."""
        return next(self._calls)


def fixed_point(measured: Array) -> MatAnswer:
    """Iterate g ← max(g − β(G(g) − G_m), 0) from g = G_m, β = 0.1.

    The iteration ends at |G(g) − G_m| < 10⁻¹² S or after 1,000 steps.
    """
    network = CountedNetwork(measured)
    conductance = network.wanted
    for step in range(MAX_STEPS):
        misfit = network.misfit(conductance)
        if np.abs(misfit).max() < FINE_S:
            return MatAnswer(conductance, step, network.evaluations(), True)
        moved = conductance - BETA * misfit
        conductance = np.where(moved < 0, SMALLEST_S, moved)
    return MatAnswer(conductance, MAX_STEPS, network.evaluations(), False)


def newton_krylov_coarse(measured: Array) -> MatAnswer:
    """G(g) = G_m from g = G_m by scipy's Newton–Krylov, to 6 µS as published."""
    return _krylov(measured, COARSE_S)


def newton_krylov_fine(measured: Array) -> MatAnswer:
    """The same, to 10⁻¹² S."""
    return _krylov(measured, FINE_S)


def _krylov(measured: Array, tolerance: float) -> MatAnswer:
    network = CountedNetwork(measured)
    steps = count()
    try:
        conductance = newton_krylov(
            network.misfit,
            network.wanted,
            f_tol=tolerance,
            maxiter=MAX_STEPS,
            callback=lambda *_: next(steps),
        )
        converged = True
    except (NoConvergence, ValueError, np.linalg.LinAlgError) as error:
        converged = False
        conductance = error.args[0] if isinstance(error, NoConvergence) else network.wanted * np.nan
    return MatAnswer(
        np.reshape(conductance, measured.shape), next(steps), network.evaluations(), converged
    )


def bounded_least_squares(measured: Array) -> MatAnswer:
    """min Σ (G(g) − G_m)² over g ≥ 0 from g = G_m by scipy's trf with finite differences."""
    network = CountedNetwork(measured)
    solution = least_squares(
        lambda position: network.misfit(position).ravel(),
        network.wanted.ravel(),
        bounds=(0.0, np.inf),
        xtol=STEP_TOLERANCE,
    )
    return MatAnswer(
        solution.x.reshape(measured.shape),
        int(solution.njev),
        network.evaluations(),
        solution.status > 0,
    )


PUBLISHED: dict[str, Callable[[Array], MatAnswer]] = {
    "fixed_point": fixed_point,
    "krylov": newton_krylov_coarse,
    "krylov_fine": newton_krylov_fine,
    "least_squares": bounded_least_squares,
}


@dataclass(frozen=True)
class MatSolve:
    """One solver on one mat.

    seconds : of the solve, undisturbed. inverse_s : of one dense inverse of the mat's lines.
    evaluations : networks solved; None where they are not counted. converged : by the solver's own
    word, ours by the check outside it. reading_error, cell_error, worst_cell_error : largest of the
    readings, median and largest of the conductances, in percent; infinite where there is no answer.
    negative : cells with a conductance below zero.
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
                conductance = generator.uniform(MIN_S, MAX_S, (side, side))
                measured = network_readings(conductance) * (
                    1 + noise / 100 * generator.standard_normal((side, side))
                )
                for solve in _solves(conductance, measured, settings):
                    yield MatSolve(side, noise, draw, *solve)


def network_readings(conductance: Array) -> Array:
    """R (rows, columns) ohm of conductances of any sign."""
    return SolvedNetwork.floating(conductance, grounding(1 / np.abs(conductance))).reading()


def _solves(truth: Array, measured: Array, settings: Settings) -> Iterator[tuple[Any, ...]]:
    inverse_s = inverse_time(np.linalg.inv(np.eye(sum(measured.shape) - 1) + 0.1))
    for name in (*OURS, *PUBLISHED):
        if name in OURS:
            answer, seconds = _ours(name, measured, settings)
        else:
            answer, seconds = clocked(partial(PUBLISHED[name], measured))
        counted = None if name in OURS else answer.evaluations
        yield (
            name,
            seconds,
            inverse_s,
            answer.iterations,
            counted,
            answer.converged,
            *_errors(answer, truth, measured),
        )


def _ours(name: str, measured: Array, settings: Settings) -> tuple[MatAnswer, float]:
    """Plain least squares without bounds, begun as always."""
    method = "reduced" if name == "reduced" else ScipyMethod(kind=name)
    estimator = Estimator((Misfit(),), method, solver=settings, bounds=Bounds("none", "none"))
    scene = Scene(Panel(*measured.shape))
    data = estimator.data(Readings.of(scene, measured).alone(), Background(scene))
    solver = estimator.problem(scene, 1, 1.0)
    solver.prepare()
    solution, seconds = clocked(lambda: estimator.method.solution(solver, data, None, None))
    return MatAnswer(
        1 / solution.cell_resistance[-1], solution.iterations, 0, solution.solved
    ), seconds


def _errors(answer: MatAnswer, truth: Array, measured: Array) -> tuple[float, float, float, int]:
    if not np.all(np.isfinite(answer.conductance)):
        return np.inf, np.inf, np.inf, 0
    reading = 100 * np.abs(network_readings(answer.conductance) / measured - 1)
    cells = 100 * np.abs(answer.conductance / truth - 1)
    return (
        float(reading.max()),
        float(np.median(cells)),
        float(cells.max()),
        int(np.sum(answer.conductance < 0)),
    )


COLUMNS: dict[str, Callable[[Any], str]] = {
    "mat": lambda own: f"{own[0].side} × {own[0].side}",
    "noise": lambda own: f"{own[0].noise_percent:g} %",
    "solver": lambda own: own[0].solver,
    "ms": lambda own: text_of(np.median([1e3 * record.seconds for record in own])),
    "networks": lambda own: (
        ""
        if own[0].evaluations is None
        else text_of(np.median([record.evaluations for record in own]))
    ),
    "misfit %": lambda own: _percent(max(record.reading_error for record in own)),
    "cell %": lambda own: _percent(np.median([record.cell_error for record in own])),
    "worst %": lambda own: _percent(max(record.worst_cell_error for record in own)),
    "g < 0": lambda own: str(sum(record.negative for record in own)),
    "ended": lambda own: f"{sum(record.converged for record in own)}/{len(own)}",
}


def _percent(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "none"


def table(solves: Sequence[MatSolve]) -> str:
    """By side, noise and solver: each on all mats."""
    groups = grouped(solves, lambda record: (record.side, record.noise_percent, record.solver))
    return markdown(screen_table(groups.values(), COLUMNS))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sides", type=int, nargs="+", default=[16])
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--noise", type=float, nargs="+", default=[0, 1], help="percent")
    chosen = parser.parse_args()
    mats = Mats(tuple(chosen.sides), chosen.draws, tuple(chosen.noise))
    print(table(list(solved_mats(mats, 1, Settings(max_iterations=300)))), end="")
