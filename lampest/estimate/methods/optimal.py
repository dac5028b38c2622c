"""Verified optima: the same cost, with node voltages as unknowns or eliminated."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.estimate.methods.method import Method
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.solvers.ipopt.formulations import FORMULATIONS
from lampest.solvers.ipopt.ipopt import Ipopt
from lampest.solvers.newton.newton import Newton
from lampest.solvers.search import best_solution
from lampest.solvers.solution import Settings, Solution, Solver

NODAL_CELLS, NODAL_PERIOD = 144, 0.5  # up to so many cells, and from so many seconds a frame, IPOPT keeps pace


@dataclass(frozen=True)
class OptimalMethod(Method):
    """argmin Σ weight·loss(residual) within the bounds, checked outside the solver that found it."""

    optimum: ClassVar[bool] = True
    joint: ClassVar[bool] = True
    kind: Literal["per_pixel", "nodal", "reduced", "auto"] = "nodal"

    def check_readout(self, readout: Readout) -> None:
        """Raise InputError where the formulation cannot say what the readout reads."""
        if self.kind in FORMULATIONS:
            FORMULATIONS[self.kind].check(readout)

    def solver(self, cost: Cost, readout: Readout, settings: Settings, period: float) -> Solver:
        """per_pixel, nodal : IPOPT with node voltages as unknowns. reduced : Newton with potentials eliminated.

        auto : nodal on panels of up to 144 cells with at most two frames a second, else reduced.
        """
        kind = self.kind
        if kind == "auto":
            kind = "nodal" if cost.panel.cells <= NODAL_CELLS and period >= NODAL_PERIOD else "reduced"
        return _solver(cost, readout, kind, settings)

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """The best optimum of all starts that a frame deserves."""
        return best_solution(solver, data, previous)


@lru_cache(maxsize=32)
def _solver(cost: Cost, readout: Readout, kind: str, settings: Settings) -> Solver:
    if kind in FORMULATIONS:
        return Ipopt(cost, readout, FORMULATIONS[kind], settings)
    return Newton(cost, settings)
