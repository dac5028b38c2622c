"""scipy.optimize.least_squares (trf) on the same problem: the dense, general solver to compare with."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import casadi
import numpy as np
from scipy import sparse
from scipy.optimize import least_squares

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.compiled import Compiled
from lampest.panel.panel import Array
from lampest.solvers.solution import Outcome, Settings, Status

STALLED = 1e-14


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
        _ = self._derivative.pattern

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
    def _stacked(self) -> casadi.SX:
        pairs = self.cost.residuals(self.cost.symbols)
        return casadi.SX(casadi.vertcat(*(np.sqrt(self.cost.weights[number]) * part for number, part in pairs)))

    @cached_property
    def _residual(self) -> Compiled:
        return self.cost.symbols.compiled("residual", casadi.densify(self._stacked))

    @cached_property
    def _derivative(self) -> Compiled:
        symbols = self.cost.symbols
        return symbols.compiled("derivative", casadi.jacobian(self._stacked, symbols.unknown))


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
        return self.scale * self._at(position).of_terms(self.solver._residual)

    def jacobian(self, position: Array) -> Array:
        """∂f/∂u = ∂f/∂r·diag(r) + ∂f/∂y·∂y/∂u, dense."""
        at = self._at(position)
        cells, function = at.cell_resistance, self.solver._derivative
        size, count = cells[0].size, cells.size
        shape = (self.solver._residual.function.nnz_out(0), 2 * count)
        partial = sparse.csc_array((self.scale * at.of_terms(function), function.pattern), shape=shape)
        blocks = [
            partial[:, count + frame * size : count + (frame + 1) * size] @ network.sensitivity()
            for frame, network in enumerate(at.networks)
        ]
        matrix: Array = np.hstack(blocks) + (partial[:, :count] @ sparse.diags_array(cells.ravel())).toarray()
        return matrix
