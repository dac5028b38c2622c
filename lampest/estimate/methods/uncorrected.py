"""No reconstruction: cells read off the readings, right only where no other cell matters, or all are alike."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.methods.method import Method
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.solvers.solution import Outcome, Solution, Solver, Status, approximation


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
