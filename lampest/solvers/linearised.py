"""One Newton step from a solved baseline with a factor that is computed once."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.panel.trust_region import Linear, steihaug
from lampest.solvers.hessian import Hessian
from lampest.solvers.preconditioners import Cholesky, preconditioner
from lampest.solvers.smoothing import Smoothing
from lampest.solvers.solution import Outcome, Solution, Status, approximation

ACCURACY = 1e-5  # single cells are small beside whole lines in what is minimised: 1e-2 leaves a change of one unseen
FARTHEST = 3.0  # of log r: a factor of 20


@dataclass(frozen=True, eq=False)
class LinearisedSolver:
    """log r = log r_b − H_b⁻¹ ∇φ(r_b) with the curvature H_b of the baseline's own data; no iteration.

    baseline : the cost at the solved baseline, given the baseline's readings.
    """

    baseline: Evaluation

    def solve(self, cost: Cost, data: Data, previous: Array) -> Solution:
        """The step for a frame's readings, within the bounds and no longer than a factor of 20 either way."""
        here = replace(self.baseline, cost=cost, data=data)
        smoothing = Smoothing.start(here)
        step = np.clip(-self._inverse(Hessian(here, smoothing).gradient), -FARTHEST, FARTHEST)
        cells = here.cell_resistance * np.exp(step).reshape(here.cell_resistance.shape)
        return approximation(cost, data, Outcome(cells, smoothing.dual, Status.APPROXIMATE, 1))

    @cached_property
    def _inverse(self) -> Linear:
        hessian = Hessian(self.baseline, Smoothing.start(self.baseline))
        free = np.ones(len(hessian.gradient), dtype=bool)
        kept = preconditioner(hessian, free)
        precondition = kept.over(free, self.baseline.cell_resistance)
        if isinstance(kept, Cholesky):
            return precondition
        return lambda slope: -steihaug(hessian.product, precondition, slope, ACCURACY).step
