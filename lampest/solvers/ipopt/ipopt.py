"""IPOPT on the formulations that keep node voltages as decision variables."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi
import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.solvers.ipopt.formulations import Formulation
from lampest.solvers.ipopt.program import Program
from lampest.solvers.solution import Outcome, Settings, Status

STATUS = {
    "Solve_Succeeded": Status.OPTIMUM,
    "Solved_To_Acceptable_Level": Status.OPTIMUM,
    "Search_Direction_Becomes_Too_Small": Status.OPTIMUM,
    "Maximum_Iterations_Exceeded": Status.ITERATIONS,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Invalid_Option": Status.UNAVAILABLE,
}
# From a distance the adaptive barrier takes 9 iterations where the monotone one takes 13.
FAR = {"mu_strategy": "adaptive"}
# A start in the right minimum must not be pushed out of it: a low barrier, and no retreat from the bounds.
NEAR = {
    "mu_strategy": "monotone",
    "mu_init": 1e-7,
    "bound_mult_init_method": "mu-based",
    "bound_push": 1e-9,
    "bound_frac": 1e-9,
}
OPTIONS = {
    "bound_relax_factor": 0.0,
    "nlp_scaling_method": "none",
    "print_level": 0,
    "sb": "yes",
}


@dataclass(frozen=True)
class Ipopt:
    """One cost, readout and formulation on one panel shape; the program is built once and kept."""

    cost: Cost
    readout: Readout
    formulation: Formulation
    settings: Settings

    def prepare(self) -> None:
        """Build the program, so that the first solve is not charged for it."""
        self._solver.name()

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve: the outcome's status says so."""
        solver = self._solver
        scale, split = data.resistance_scale, start.of_terms(self.cost.functions.split)
        split_scale = max(float(np.abs(split).max(initial=0)), 1e-12)
        own: dict[str, Any] = {
            "ties": data.ties.ravel() * scale,
            "weights": self.cost.weights,
            "scale": scale,
            "cost_scale": start.cost_scale,
            "split_scale": split_scale,
        }
        values = data.given.flat | own
        result = solver(
            x0=self._start(start, scale, split / split_scale),
            p=np.concatenate([np.atleast_1d(values[name]) for name in self._parameters]),
            lbg=0,
            ubg=0,
            **self._bounds(data, scale, 2 * len(split)),
        )
        with np.errstate(divide="ignore"):
            cells = scale / np.asarray(result["x"]).ravel()[: data.measured.size]
        multipliers = np.asarray(result["lam_g"]).ravel()
        weights = np.maximum(self.cost.slope * split_scale / start.cost_scale, np.finfo(float).tiny)
        dual = multipliers[len(multipliers) - len(weights) :] / weights
        stats = solver.stats()
        status = STATUS.get(stats["return_status"], Status.BREAKDOWN)
        return Outcome(cells.reshape(data.measured.shape), dual, status, int(stats["iter_count"]))

    def _start(self, start: Evaluation, scale: float, split: Array) -> Array:
        conductance = scale / start.cell_resistance.ravel()
        potentials = [self.formulation.potentials(self.readout, network) / scale for network in start.networks]
        blocks = self.cost.functions.split_blocks
        parts = np.split(split, np.cumsum([rows for _, rows in blocks], dtype=int)[:-1])
        sides = [side for (loss, _), part in zip(blocks, parts, strict=False) for side in loss.split_start(part)]
        return np.concatenate([conductance, *potentials, *sides])

    def _bounds(self, data: Data, scale: float, split: int) -> dict[str, Any]:
        """Bounds of all unknowns; no network reads a cell that is smaller than `Readout.nearly_shorted`."""
        free = int(self._solver.size1_in("x0")) - data.measured.size - split
        least = np.minimum(np.maximum(data.lower, data.readout.nearly_shorted(data.measured)), data.upper).ravel()
        lower = [scale / data.upper.ravel(), np.full(free, -np.inf), np.zeros(split)]
        upper = [scale / least, np.full(free + split, np.inf)]
        return {"lbx": np.concatenate(lower), "ubx": np.concatenate(upper)}

    @property
    def _solver(self) -> casadi.Function:
        return self._compiled[0]

    @property
    def _parameters(self) -> tuple[str, ...]:
        return self._compiled[1]

    @cached_property
    def _compiled(self) -> tuple[casadi.Function, tuple[str, ...]]:
        return _compiled(self.cost.unweighted, self.readout, self.formulation, self.settings)


@lru_cache(maxsize=32)
def _compiled(
    cost: Cost, readout: Readout, formulation: Formulation, settings: Settings
) -> tuple[casadi.Function, tuple[str, ...]]:
    """(solver, names of its parameters in their order); one program serves all weights."""
    program = Program.build(cost, readout, formulation)
    limits = {"tol": settings.tolerance, "max_iter": settings.max_iterations}
    several_minima = not readout.unique or any(term.needs_previous for term in cost.terms)
    options: dict[str, Any] = {
        "ipopt": OPTIONS | (NEAR if several_minima else FAR) | limits,
        "hess_lag": program.hessian(),
        "print_time": False,
    }
    return casadi.nlpsol("ipopt", "ipopt", program.nlp, options), tuple(program.parameters)
