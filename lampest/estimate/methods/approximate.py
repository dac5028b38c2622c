"""Methods that end at no optimum: a few Newton steps, and cells read off the readings."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.methods.method import Method
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.solvers.multistart import evaluated
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, Status, approximation


@dataclass(frozen=True)
class TruncatedMethod(Method):
    """The first `steps` Newton steps of the reduced formulation from the previous frame.

    Raises ValueError unless there is at least one.
    """

    kind: Literal["truncated"] = "truncated"
    steps: int = 2

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError("steps must be at least 1")

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """Wherever the steps lead."""
        start = evaluated(solver.cost, data, data.uniform_start if previous is None else previous)
        outcome = ProjectedNewton(solver.cost, Settings(max_iterations=self.steps)).solve(data, start)
        return approximation(solver.cost, data, outcome)


@dataclass(frozen=True)
class UncorrectedMethod(Method):
    """naive : each reading as if its cell were alone (r = R_m, or what a naive divider gives). scaled : as if all were
    alike (r = R_m·MN/(M + N − 1) of two-point readings). Costs nothing.
    """

    kind: Literal["naive", "scaled"] = "naive"

    def guess(self, readout: Readout, measured: Array) -> Array:
        """The estimate itself."""
        return readout.apparent_resistance(measured) if self.kind == "naive" else readout.uniform_start(measured)

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """The cells that are read off, put within the bounds."""
        cells = np.clip(self.guess(data.readout, data.measured), data.lower, data.upper)
        return approximation(solver.cost, data, Outcome(cells, np.zeros(len(solver.cost.slope)), Status.APPROXIMATE, 0))
