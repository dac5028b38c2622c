"""The benchmark with SciPy's solvers on the same problem beside lampest's own.

Run it with: python -m docs.studies.bench [CONFIG] [--out DIR] [--set PATH=VALUE]
The file is one of `lampest study bench`; its `limits` know SciPy's solvers too.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, ClassVar, Literal

import casadi
import numpy as np
from scipy import sparse
from scipy.optimize import least_squares, minimize

from docs.studies import script
from lampest.apps.studies import bench
from lampest.apps.studies.bench import BenchFile, BenchLimits
from lampest.apps.studies.study import read_settings
from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.weights import Objective
from lampest.panel.compiled import Compiled, guarded
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.solvers.check import check
from lampest.solvers.multistart import evaluable, starts
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, Status

# scipy's own tests of a step and of a gain shall not end a solve before the gradient does
STALLED = 1e-14
# Iterations of L-BFGS-B for each one that a method with second derivatives may take: one is an
# evaluation, no matrix.
CHEAPER = 10


@dataclass(frozen=True)
class Trf(Solver):
    """½ Σ f² = φ/s over u = log r within the bounds.

    f = √(2·weight/s)·residual, s = the start's `cost_scale`.

    Stops where the scaled gradient falls below the settings' tolerance, as the reduced solver does,
    or where neither
    cost nor point moves any more. jacobian : 'exact', from closed forms, or '2-point', scipy's own
        finite differences.
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
            results = least_squares(
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
        status = Status.OPTIMUM if results.status > 0 else Status.ITERATIONS
        return Outcome(
            np.exp(results.x).reshape(data.measured.shape), np.zeros(0), status, int(results.njev)
        )

    @cached_property
    @guarded
    def _functions(self) -> tuple[Compiled, Compiled]:
        """(residuals, their derivatives)."""
        symbols = self.cost.symbols()
        pairs = self.cost.residuals(symbols)
        stacked = casadi.vertcat(
            *(np.sqrt(self.cost.weights[number]) * part for number, part in pairs)
        )
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
        return self.scale * self._at(position).call(self.solver._functions[0])

    def jacobian(self, position: Array) -> Array:
        """∂f/∂u = ∂f/∂r·diag(r) + ∂f/∂y·∂y/∂u, dense."""
        at = self._at(position)
        cells = at.cell_resistance
        function = self.solver._functions[1]
        size = cells[0].size
        count = cells.size
        partial = sparse.csc_array(
            (self.scale * at.call(function), function.pattern), shape=function.structure.shape
        )
        blocks = [
            partial[:, count + frame * size : count + (frame + 1) * size] @ network.sensitivity()
            for frame, network in enumerate(at.networks)
        ]
        matrix: Array = (
            np.hstack(blocks) + (partial[:, :count] @ sparse.diags_array(cells.ravel())).toarray()
        )
        return matrix


@dataclass(frozen=True)
class Lbfgsb(Solver):
    """φ/s over u = log r within the bounds, with the closed-form gradient.

    s = the start's `cost_scale`.

    Stops where the projected gradient falls below the settings' tolerance, as the reduced solver
    does, or where the cost does not fall any more, or after ten times the settings' iterations.
    """

    cost: Cost
    settings: Settings

    def prepare(self) -> None:
        """Compile the cost."""
        _ = self.cost.functions

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve."""
        shape = data.measured.shape
        scale = start.cost_scale
        nothing = np.zeros(0)

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
                options={
                    "ftol": STALLED,
                    "gtol": self.settings.tolerance,
                    "maxiter": most,
                    "maxfun": 2 * most,
                },
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


@dataclass(frozen=True)
class ScipyMethod(Method):
    """One of scipy's solvers, from the cheapest of a frame's starts, checked as ours are.

    scipy_exact, scipy_difference : trf with the closed-form Jacobian, and with finite differences.
    scipy_lbfgsb : L-BFGS-B with the closed-form gradient.
    """

    optimum: ClassVar[bool] = True
    kind: Literal["scipy_exact", "scipy_difference", "scipy_lbfgsb"]
    joint: bool = False

    def joint_start(self, objective: Objective) -> bool:
        """Start the first frame together with the baseline, as our optimal methods do."""
        return OptimalMethod(joint=self.joint).joint_start(objective)

    def solver(self, cost: Cost, scene: Scene, settings: Settings, period: float) -> Solver:
        """Kept for costs that come again."""
        return _scipy(self.kind, cost, settings)

    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """The minimum next to that start."""
        places = starts(solver.cost, data, previous)
        start = min(evaluable(solver.cost, data, places), key=lambda point: point.objective)
        return check(start, solver.solve(data, start))


@lru_cache(maxsize=8)
def _scipy(name: str, cost: Cost, settings: Settings) -> Solver:
    solver: Solver = SOLVERS[name](cost, settings)
    return solver


@dataclass(frozen=True)
class SolverLimits(BenchLimits):
    """The largest side at which each solver is run, SciPy's included."""

    scipy_exact: int = 16
    scipy_difference: int = 10
    scipy_lbfgsb: int = 32


@dataclass(frozen=True)
class SolversFile(BenchFile):
    """A benchmark's file whose limits know SciPy's solvers."""

    limits: SolverLimits = SolverLimits()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(
            term.loss.squared for method in self.estimators.values() for term in method.parts
        ):
            raise ValueError("only squared losses can be compared with a least-squares solver")

    def formulation(self, solver: Any, *, joint: bool) -> Method:
        """Return the formulation of a solver's name, SciPy's included."""
        return (
            ScipyMethod(kind=solver, joint=joint)
            if solver in SOLVERS
            else super().formulation(solver, joint=joint)
        )


STUDY = replace(bench.STUDY, read=read_settings(SolversFile))

if __name__ == "__main__":
    script.main(lambda options: STUDY, script.parser_of(__doc__))
