"""IPOPT on the formulations that keep node voltages as decision variables."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from lampest.formulations import Formulation
from lampest.kirchhoff import grounding
from lampest.panel import Array
from lampest.problem import Cost, Data, Evaluation
from lampest.solvers.program import Program
from lampest.solvers.solution import Outcome, Settings, Status

STATUS = {
    "Solve_Succeeded": Status.OPTIMUM,
    "Solved_To_Acceptable_Level": Status.OPTIMUM,
    "Search_Direction_Becomes_Too_Small": Status.OPTIMUM,
    "Maximum_Iterations_Exceeded": Status.ITERATIONS,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Invalid_Option": Status.UNAVAILABLE,
}
OPTIONS = {
    "mu_strategy": "adaptive",
    "bound_relax_factor": 0.0,
    "nlp_scaling_method": "none",
    "print_level": 0,
    "sb": "yes",
}


@dataclass(frozen=True)
class Ipopt:
    """One cost and formulation on one panel shape; the program is built once and kept."""

    cost: Cost
    formulation: Formulation
    settings: Settings

    def prepare(self) -> None:
        """Build the program, so that the first solve is not charged for it."""
        self._solver.name()

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve: the outcome's status says so."""
        solver = self._solver
        scale, cost_scale = data.resistance_scale, start.cost_scale()
        rough, slope = start.rough
        split_scale = max(float(np.max(np.abs(rough), initial=0)), 1e-12)
        ties = np.stack([grounding(measured) * scale for measured in data.measured])
        measured, sigma, previous = self.cost.parameters(data)
        scales = [scale, cost_scale, split_scale]
        result = solver(
            x0=self._start(start, scale, rough / split_scale),
            p=np.concatenate([measured.T.ravel(), sigma.T.ravel(), ties.ravel(), previous, scales]),
            lbg=0,
            ubg=0,
            **self._bounds(data, scale, len(rough)),
        )
        with np.errstate(divide="ignore"):
            cells = scale / np.asarray(result["x"]).ravel()[: data.measured.size]
        multipliers = np.asarray(result["lam_g"]).ravel()
        weights = np.maximum(slope * split_scale / cost_scale, np.finfo(float).tiny)
        dual = multipliers[len(multipliers) - len(rough) :] / weights
        stats = solver.stats()
        status = STATUS.get(stats["return_status"], Status.BREAKDOWN)
        return Outcome(cells.reshape(data.measured.shape), dual, status, int(stats["iter_count"]))

    def _start(self, start: Evaluation, scale: float, rough: Array) -> Array:
        conductance = scale / start.cell_resistance.ravel()
        potentials = [self.formulation.potentials(network) / scale for network in start.networks]
        positive = np.maximum(rough, 0) + 0.01
        return np.concatenate([conductance, *potentials, positive, positive - rough])

    def _bounds(self, data: Data, scale: float, rough: int) -> dict[str, Any]:
        free = int(self._solver.size1_in("x0")) - data.measured.size - 2 * rough
        lower = [scale / data.upper.ravel(), np.full(free, -np.inf), np.zeros(2 * rough)]
        upper = [scale / data.lower.ravel(), np.full(free + 2 * rough, np.inf)]
        return {"lbx": np.concatenate(lower), "ubx": np.concatenate(upper)}

    @cached_property
    def _solver(self) -> casadi.Function:
        program = Program.build(self.cost, self.formulation)
        limits = {"tol": self.settings.tolerance, "max_iter": self.settings.max_iterations}
        options: dict[str, Any] = {"ipopt": OPTIONS | limits, "hess_lag": program.hessian(), "print_time": False}
        return casadi.nlpsol("ipopt", "ipopt", program.nlp, options)
