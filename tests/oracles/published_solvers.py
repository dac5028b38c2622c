"""Solvers of others on the same problem, with which `lampest study bench` compares: scipy's."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import casadi
import numpy as np
from scipy import sparse
from scipy.optimize import least_squares, minimize

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.compiled import Compiled, guarded
from lampest.panel.panel import Array
from lampest.solvers.solution import Outcome, Settings, Solver, Status

STALLED = 1e-14  # scipy's own tests of a step and of a gain shall not end a solve before the gradient does
# Iterations of L-BFGS-B for each one that a method with second derivatives may take: one is an evaluation, no matrix.
CHEAPER = 10


@dataclass(frozen=True)
class Trf:
    """½ Σ f² = φ/s over u = log r within the bounds, f = √(2·weight/s)·residual, s = the start's `cost_scale`.

    Stops where the scaled gradient falls below the settings' tolerance, as the reduced solver does, or where neither
    cost nor point moves any more. jacobian : 'exact', from closed forms, or '2-point', scipy's own finite differences.
    """

    cost: Cost
    settings: Settings
    jacobian: Literal["exact", "2-point"]

    def prepare(self) -> None:
        """Compile residuals and their derivatives."""
        _ = self._functions[1].pattern

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve."""
        point = _Point(self, data, np.sqrt(2 / start.cost_scale))
        lower, upper = (bound.ravel() for bound in data.log_bounds)
        try:
            found = least_squares(
                point.residuals,
                np.clip(np.log(start.cell_resistance).ravel(), lower, upper),
                point.jacobian if self.jacobian == "exact" else "2-point",
                (lower, upper),
                ftol=STALLED,
                xtol=STALLED,
                gtol=self.settings.tolerance,
                max_nfev=self.settings.max_iterations,
            )
        except (ValueError, np.linalg.LinAlgError):
            return Outcome(start.cell_resistance, np.zeros(0), Status.BREAKDOWN, 0)
        status = Status.OPTIMUM if found.status > 0 else Status.ITERATIONS
        return Outcome(np.exp(found.x).reshape(data.measured.shape), np.zeros(0), status, int(found.njev))

    @cached_property
    @guarded
    def _functions(self) -> tuple[Compiled, Compiled]:
        """(residuals, their derivatives)."""
        symbols = self.cost.symbols()
        pairs = self.cost.residuals(symbols)
        stacked = casadi.vertcat(*(np.sqrt(self.cost.weights[number]) * part for number, part in pairs))
        residual = symbols.compiled("residual", casadi.densify(stacked))
        return residual, symbols.compiled("derivative", casadi.jacobian(stacked, symbols.unknown))


@dataclass(frozen=True, eq=False)
class _Point:
    """Residuals and Jacobian for scipy; `scale` multiplies both."""

    solver: Trf
    data: Data
    scale: float

    def _at(self, position: Array) -> Evaluation:
        cells = np.exp(position).reshape(self.data.measured.shape)
        return Evaluation.at(self.solver.cost, self.data, cells)

    def residuals(self, position: Array) -> Array:
        """f(u)."""
        return self.scale * self._at(position).of_terms(self.solver._functions[0])

    def jacobian(self, position: Array) -> Array:
        """∂f/∂u = ∂f/∂r·diag(r) + ∂f/∂y·∂y/∂u, dense."""
        at = self._at(position)
        cells, function = at.cell_resistance, self.solver._functions[1]
        size, count = cells[0].size, cells.size
        partial = sparse.csc_array((self.scale * at.of_terms(function), function.pattern), shape=function.shape)
        blocks = [
            partial[:, count + frame * size : count + (frame + 1) * size] @ network.sensitivity()
            for frame, network in enumerate(at.networks)
        ]
        matrix: Array = np.hstack(blocks) + (partial[:, :count] @ sparse.diags_array(cells.ravel())).toarray()
        return matrix


@dataclass(frozen=True)
class Lbfgsb:
    """φ/s over u = log r within the bounds, s = the start's `cost_scale`, with the closed-form gradient.

    Stops where the projected gradient falls below the settings' tolerance, as the reduced solver does, or where the
    cost does not fall any more, or after ten times the settings' iterations.
    """

    cost: Cost
    settings: Settings

    def prepare(self) -> None:
        """Compile the cost."""
        _ = self.cost.functions

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve."""
        shape, scale, nothing = data.measured.shape, start.cost_scale, np.zeros(0)

        def value(position: Array) -> tuple[float, Array]:
            at = Evaluation.at(self.cost, data, np.exp(position).reshape(shape))
            return at.objective / scale, at.log_gradient(nothing).ravel() / scale

        most = CHEAPER * self.settings.max_iterations
        lower, upper = (bound.ravel() for bound in data.log_bounds)
        try:
            reached = minimize(
                value,
                np.clip(start.position.ravel(), lower, upper),
                jac=True,
                method="L-BFGS-B",
                bounds=np.column_stack((lower, upper)),
                options={"ftol": STALLED, "gtol": self.settings.tolerance, "maxiter": most, "maxfun": 2 * most},
            )
        except (ValueError, np.linalg.LinAlgError):
            return Outcome(start.cell_resistance, nothing, Status.BREAKDOWN, 0)
        status = Status.OPTIMUM if reached.success else Status.ITERATIONS
        return Outcome(np.exp(reached.x).reshape(shape), nothing, status, int(reached.nit))


SOLVERS: dict[str, Callable[[Cost, Settings], Solver]] = {
    "scipy_exact": partial(Trf, jacobian="exact"),
    "scipy_difference": partial(Trf, jacobian="2-point"),
    "scipy_lbfgsb": Lbfgsb,
}
