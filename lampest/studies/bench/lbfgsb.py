"""scipy's L-BFGS-B on the same problem: first derivatives alone, no matrix."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.solvers.solution import Outcome, Settings, Status
from lampest.studies.bench.trf import STALLED

# Iterations for each one that a method with second derivatives may take; each costs one evaluation and no matrix.
CHEAPER = 10


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
