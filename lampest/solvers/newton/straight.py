"""Penalised large panels from afar: Gauss and Newton's steps straight in the cells' resistance r.

Two-point readings are homogeneous in r, and the paper's penalties are squares of what is linear in it. In log r both
bend down, and damped steps went along that for thirty to a hundred iterations, each with a factor of its own; squares
of what is straight never bend down, and one factor in ohm, which knows nothing of how far cells have moved, serves many
steps. The last steps are left to Newton's method.
Source: Nocedal & Wright, Numerical Optimization, 2006, section 10.3 (Gauss, Newton).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation
from lampest.panel.conjugate import Linear, conjugate_gradients
from lampest.panel.panel import Array
from lampest.solvers.certificate import free_cells
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.directions import local_inverse
from lampest.solvers.newton.smoothing import Smoothing

NEAR = 1e-4  # of the cost's scale, its gradient: from here Newton's method takes two to four steps
MOST_STEPS = 60  # after which those that end at all have ended
SLOW = 1e-5  # of the cost, by which a step lowers it where squares alone no longer tell what is best
FARTHEST = 2.0  # times that r changes in a step: 30 ended 0.7 % higher in the mean of 20 frames, in as many steps
ACCURACY = 0.1  # of a step by conjugate gradients
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
DECREASE = 1e-4  # as in Nocedal & Wright, section 3.1
WORN, FEW = 1.5, 8  # times the products that a new factor takes, and at least so many: when it is made anew


def from_afar(start: Evaluation) -> tuple[Evaluation, int]:
    """Where Newton's method may go on, and the steps; `start` itself and none where that alone is as good."""
    if not _serves(start):
        return start, 0
    here, steps = _Straight(start), 0
    while steps < MOST_STEPS and here.residual > NEAR and not start.data.overdue:
        moved = here.moved()
        if moved is None:
            break
        slow = here.at.objective - moved.at.objective <= SLOW * here.at.objective
        here, steps = moved, steps + 1
        if slow:
            break
    return here.at, steps


def _serves(start: Evaluation) -> bool:
    """Whether readings follow r in proportion, and a large frame is penalised without corners."""
    curvature = Curvature(start, Smoothing.start(start))
    large = len(start.cell_resistance) == 1 and not curvature.factored
    return large and start.data.readout.homogeneous and not curvature.only_misfit and not len(start.cost.slope)


@dataclass(frozen=True, eq=False)
class _Rough:
    """solve : the inverse, in ohm, of what terms and each cell's own reading say, over all cells. products : how many
    the first step by conjugate gradients took with it.
    """

    solve: Linear
    products: int = 0

    @classmethod
    def of(cls, curvature: Curvature) -> "_Rough":
        """At a point."""
        local = curvature.straight_local
        return cls(local_inverse(local, np.zeros(local.shape[0]), np.arange(local.shape[0])))

    def over(self, free: NDArray[np.intp], cells: Array) -> Linear:
        """Of relative steps of the free ones of the cells (cells) ohm."""
        whole = np.zeros(len(cells))

        def solve(values: Array) -> Array:
            whole[free] = values / cells[free]
            return np.asarray(self.solve(whole)[free] / cells[free])

        return solve


@dataclass(frozen=True, eq=False)
class _Straight:
    """at : the cost. rough : what conjugate gradients are preconditioned with, if it still serves."""

    at: Evaluation
    rough: _Rough | None = None

    @cached_property
    def curvature(self) -> Curvature:
        """Second derivatives."""
        return Curvature(self.at, Smoothing.start(self.at))

    @cached_property
    def residual(self) -> float:
        """The projected gradient, as the test of optimality measures it."""
        return self.at.projected_gradient(self.curvature.gradient.reshape(self.at.cell_resistance.shape))

    @cached_property
    def cells(self) -> Array:
        """r, flat."""
        return self.at.cell_resistance.ravel()

    def moved(self) -> "_Straight | None":
        """After one step; None where no share of it leads lower."""
        step, rough = self._step()
        for share in SHARES:
            if (found := self._lower(share * step)) is not None:
                return _Straight(found, rough)
        return None

    def _step(self) -> tuple[Array, _Rough | None]:
        """δr/r that is best for squares, zero at cells that press against a bound; and what still preconditions."""
        free, products = np.flatnonzero(free_cells(self.at, self.curvature.gradient)), 0
        whole, step = np.zeros(len(self.cells)), np.zeros(len(self.cells))

        def product(search: Array) -> Array:
            nonlocal products
            products += 1
            whole[free] = search
            return self.curvature.straight_product(whole)[free]

        used = self.rough or _Rough.of(self.curvature)
        right = -self.curvature.gradient[free]
        step[free], _ = conjugate_gradients(product, used.over(free, self.cells), right, ACCURACY)
        if not used.products:
            return step, _Rough(used.solve, products)
        return step, used if products <= max(WORN * used.products, FEW) else None

    def _lower(self, step: Array) -> Evaluation | None:
        """The cost after a relative step, within the bounds and FARTHEST, if it is lower."""
        near = self.cells * np.clip(1 + step, 1 / FARTHEST, FARTHEST)
        target = np.clip(near, self.at.data.lower.ravel(), self.at.data.upper.ravel())
        promised = -float(self.curvature.gradient @ np.log(target / self.cells))
        if not promised > 0:
            return None
        found = self.at.elsewhere(target.reshape(self.at.cell_resistance.shape))
        return found if self.at.objective - found.objective >= DECREASE * promised else None
