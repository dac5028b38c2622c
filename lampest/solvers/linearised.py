"""One Newton step from a solved baseline with a factor that is computed once."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.conjugate import DENSE_UNKNOWNS, conjugate_gradients
from lampest.panel.panel import Array
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.local import local_inverse
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.solution import Outcome, Solution, Status, approximation

ACCURACY = 1e-5  # single cells are small beside whole lines in what is minimised: 1e-2 leaves a change of one unseen
FARTHEST = 3.0


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
        step = np.clip(-self._inverse(Curvature(here, smoothing).gradient), -FARTHEST, FARTHEST)
        cells = here.cell_resistance * np.exp(step).reshape(here.cell_resistance.shape)
        return approximation(cost, data, Outcome(cells, smoothing.dual, Status.APPROXIMATE, 1))

    @cached_property
    def _inverse(self) -> Callable[[Array], Array]:
        curvature = Curvature(self.baseline, Smoothing.start(self.baseline))
        everything = np.arange(len(curvature.gradient))
        if len(everything) <= DENSE_UNKNOWNS:
            matrix = curvature.matrix
            factor = cho_factor(matrix + np.diag(1e-12 * np.abs(np.diag(matrix))))
            return lambda slope: cho_solve(factor, slope)
        precondition = local_inverse(curvature.local, np.zeros(len(everything)), everything)
        return lambda slope: conjugate_gradients(curvature.product, precondition, slope, ACCURACY)[0]
