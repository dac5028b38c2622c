"""scipy.optimize.least_squares (trf) on the same problem: the dense, general solver to compare with."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import casadi
import numpy as np
from scipy import sparse
from scipy.optimize import least_squares

from lampest.cost.cost import Compiled, Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.solvers.solution import Outcome, Settings, Status

STALLED = 1e-14


@dataclass(frozen=True)
class Trf:
    """½ Σ f² = φ/s over u = log r within the bounds, f = √(2·weight/s)·residual, s = the start's `cost_scale`.

    Stops where the scaled gradient falls below the settings' tolerance, as the reduced solver does, or where neither
    cost nor point moves any more. jacobian : 'exact', from closed forms, or '2-point', scipy's own finite differences.
    """

    easy: ClassVar[int] = 0
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
    def _parts(self) -> tuple[list[Any], Any, Any]:
        symbols = self.cost.symbols()
        pairs = self.cost.residuals(*symbols)
        residual = casadi.vertcat(*(np.sqrt(self.cost.weights[number]) * part for number, part in pairs))
        unknown = casadi.vertcat(casadi.vec(symbols[0]), casadi.vec(symbols[1]))
        return [casadi.vec(symbol) for symbol in symbols], residual, casadi.jacobian(residual, unknown)

    @cached_property
    def _residual(self) -> Compiled:
        symbols, residual, _ = self._parts
        return Compiled(casadi.Function("residual", symbols, [casadi.densify(residual)]))

    @cached_property
    def _derivative(self) -> Compiled:
        symbols, _, derivative = self._parts
        return Compiled(casadi.Function("derivative", symbols, [derivative]))


@dataclass(frozen=True, eq=False)
class _Point:
    """Residuals and Jacobian for scipy; `scale` multiplies both."""

    solver: Trf
    data: Data
    scale: float

    def _networks(self, position: Array) -> tuple[Array, list[Network]]:
        cells = np.exp(position).reshape(self.data.measured.shape)
        return cells, [Network.solve(1 / frame, tie) for frame, tie in zip(cells, self.data.ties, strict=True)]

    def _call(self, function: Compiled, cells: Array, networks: list[Network]) -> Array:
        two_point = np.stack([network.two_point_resistance() for network in networks])
        return self.scale * function(cells.ravel(), two_point.ravel(), *self.data.parameters)

    def residuals(self, position: Array) -> Array:
        """f(u)."""
        return self._call(self.solver._residual, *self._networks(position))

    def jacobian(self, position: Array) -> Array:
        """∂f/∂u = ∂f/∂r·diag(r) + ∂f/∂R·(D∘D)·diag(1/r), dense."""
        cells, networks = self._networks(position)
        function, count = self.solver._derivative, cells.size
        shape = (self.solver._residual.function.nnz_out(0), 2 * count)
        partial = sparse.csc_array((self._call(function, cells, networks), function.pattern), shape=shape)
        size = cells[0].size
        blocks = [
            partial[:, count + frame * size : count + (frame + 1) * size]
            @ (network.transfer() ** 2 / cells[frame].ravel())
            for frame, network in enumerate(networks)
        ]
        matrix: Array = np.hstack(blocks) + (partial[:, :count] @ sparse.diags_array(cells.ravel())).toarray()
        return matrix
