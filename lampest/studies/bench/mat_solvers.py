"""Solvers published for mats without bounds or penalties: conductances g with G(g) = G_m, as many readings as cells.

G = 1/R are the conductances that are read between every row and every column. The equations and settings are those of
J. A. Medrano-Sánchez et al., IEEE Sensors J., 2019, doi 10.1109/JSEN.2019.2918592, and of the programs that C. Medrano
published with them. They tolerate 6 µS in every G, of cells between 20 µS and 20 mS; `krylov_fine` and
`fixed_point` go to 10⁻¹² S instead, so that accuracy and time can be seen apart.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.optimize import NoConvergence, least_squares, newton_krylov

from lampest.panel.panel import Array
from lampest.panel.readouts.two_point.floating import FloatingNetwork, grounding

BETA, MOST_STEPS, LEAST_S = 0.1, 1000, 1e-18  # the published test's step, iterations, and what replaces g < 0, siemens
FINE_S = 1e-12  # the published test's tolerance of the fixed point
COARSE_S = 6e-6  # what newton_krylov tolerates where it is told nothing
STEP_TOLERANCE = 1e-8  # the published test's xtol of least squares


@dataclass(frozen=True, eq=False)
class MatAnswer:
    """conductance : (rows, columns) siemens. evaluations : how often a network was solved. converged : so it says."""

    conductance: Array
    iterations: int
    evaluations: int
    converged: bool


class CountedNetwork:
    """G(g) of a network whose ground is chosen by the readings (rows, columns) ohm; counts how often it is asked."""

    def __init__(self, measured: Array) -> None:
        self.wanted = 1 / measured
        self._tie = grounding(measured)
        self._calls = count()

    def __call__(self, conductance: Array) -> Array:
        """(rows, columns) siemens."""
        next(self._calls)
        return 1 / FloatingNetwork.solve(conductance, self._tie).reading()

    def misfit(self, conductance: Array) -> Array:
        """G(g) − G_m."""
        return self(conductance.reshape(self.wanted.shape)) - self.wanted

    def evaluations(self) -> int:
        """So often until now."""
        return next(self._calls)


def fixed_point(measured: Array) -> MatAnswer:
    """g ← max(g − β(G(g) − G_m), 0) from g = G_m, β = 0.1, until |G(g) − G_m| < 10⁻¹² S or 1,000 times."""
    network = CountedNetwork(measured)
    conductance = network.wanted
    for step in range(MOST_STEPS):
        misfit = network.misfit(conductance)
        if np.abs(misfit).max() < FINE_S:
            return MatAnswer(conductance, step, network.evaluations(), True)
        moved = conductance - BETA * misfit
        conductance = np.where(moved < 0, LEAST_S, moved)
    return MatAnswer(conductance, MOST_STEPS, network.evaluations(), False)


def newton_krylov_coarse(measured: Array) -> MatAnswer:
    """G(g) = G_m from g = G_m by scipy's Newton–Krylov, to 6 µS as published."""
    return _krylov(measured, COARSE_S)


def newton_krylov_fine(measured: Array) -> MatAnswer:
    """The same, to 10⁻¹² S."""
    return _krylov(measured, FINE_S)


def _krylov(measured: Array, tolerance: float) -> MatAnswer:
    network, steps = CountedNetwork(measured), count()
    try:
        found = newton_krylov(
            network.misfit, network.wanted, f_tol=tolerance, maxiter=MOST_STEPS, callback=lambda *_: next(steps)
        )
        converged = True
    except (NoConvergence, ValueError, np.linalg.LinAlgError) as error:
        converged, found = False, error.args[0] if isinstance(error, NoConvergence) else network.wanted * np.nan
    return MatAnswer(np.reshape(found, measured.shape), next(steps), network.evaluations(), converged)


def bounded_least_squares(measured: Array) -> MatAnswer:
    """min Σ (G(g) − G_m)² over g ≥ 0 from g = G_m by scipy's trf with finite differences."""
    network = CountedNetwork(measured)
    found = least_squares(
        lambda position: network.misfit(position).ravel(),
        network.wanted.ravel(),
        bounds=(0.0, np.inf),
        xtol=STEP_TOLERANCE,
    )
    return MatAnswer(found.x.reshape(measured.shape), int(found.njev), network.evaluations(), found.status > 0)


PUBLISHED: dict[str, Callable[[Array], MatAnswer]] = {
    "fixed_point": fixed_point,
    "krylov": newton_krylov_coarse,
    "krylov_fine": newton_krylov_fine,
    "least_squares": bounded_least_squares,
}
