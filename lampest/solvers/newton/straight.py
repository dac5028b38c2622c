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

from lampest.cost.problem import Evaluation
from lampest.panel.conjugate import conjugate_gradients
from lampest.panel.panel import Array
from lampest.solvers.certificate import free_cells
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.directions import Factor
from lampest.solvers.newton.rough import Rough
from lampest.solvers.newton.smoothing import Smoothing

NEAR = 1e-4  # of the cost's scale, its gradient: from here Newton's method takes two to four steps
MOST_STEPS = 60  # after which those that end at all have ended
SLOW = 1e-5  # of the cost, by which a step lowers it where squares alone no longer tell what is best
FARTHEST = 2.0  # times that r changes in a step: 30 ended 0.7 % higher in the mean of 20 frames, in as many steps
ACCURACY = 0.1  # of a step by conjugate gradients
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
DECREASE = 1e-4  # as in Nocedal & Wright, section 3.1
MANY = 24  # products of a first step: lines count then. 5 to 15 are usual, 25 to 60 where readings are weighed
WORN, FEW = 1.5, 8  # times the products that a new factor takes, and at least so many: when it is made anew


def from_afar(start: Evaluation) -> tuple[Evaluation, int, Factor | None]:
    """Where Newton's method may go on, the steps, and what it may precondition its own with, if that serves well.

    `start` itself, none and nothing where Newton's method alone is as good.
    """
    if not _serves(start):
        return start, 0, None
    here, steps = _Straight(start), 0
    while steps < MOST_STEPS and here.residual > NEAR and not start.data.overdue:
        moved = here.moved()
        if moved is None:
            break
        slow = here.at.objective - moved.at.objective <= SLOW * here.at.objective
        here, steps = moved, steps + 1
        if slow:
            break
    return here.at, steps, here.factor


def _serves(start: Evaluation) -> bool:
    """Whether readings follow r in proportion, and a large frame is penalised without corners."""
    curvature = Curvature(start, Smoothing.start(start))
    large = len(start.cell_resistance) == 1 and not curvature.factored
    return large and start.data.readout.homogeneous and not curvature.only_misfit and not len(start.cost.slope)


@dataclass(frozen=True, eq=False)
class _Straight:
    """at : the cost. rough : what conjugate gradients are preconditioned with, if it still serves. products, last : how
    many the first and the last step with the last one took.
    """

    at: Evaluation
    rough: Rough | None = None
    products: int = 0
    last: int = 0

    @property
    def factor(self) -> Factor | None:
        """What `rough` is for Newton's method, if steps take FEW products with it."""
        if self.rough is None or self.last > FEW:
            return None
        everything = np.arange(len(self.cells))
        return Factor(everything, self.at.cell_resistance, self.rough.over(everything, self.cells))

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
        lined = self.products > MANY
        rough = self.rough or Rough.of(self.curvature, np.zeros(len(self.cells)), lined)
        step, products = self._step(rough)
        first = self.products if self.rough else products
        kept = rough if products <= max(WORN * first, FEW) else None
        for share in SHARES:
            if (found := self._lower(share * step)) is not None:
                return _Straight(found, kept, first, products)
        return None

    def _step(self, rough: Rough) -> tuple[Array, int]:
        """δr/r that is best for squares, zero at cells that press against a bound; and how many products that took."""
        free, products = np.flatnonzero(free_cells(self.at, self.curvature.gradient)), 0
        whole, step = np.zeros(len(self.cells)), np.zeros(len(self.cells))

        def product(search: Array) -> Array:
            nonlocal products
            products += 1
            whole[free] = search
            return self.curvature.straight_product(whole)[free]

        right = -self.curvature.gradient[free]
        step[free], _ = conjugate_gradients(product, rough.over(free, self.cells), right, ACCURACY)
        return step, products

    def _lower(self, step: Array) -> Evaluation | None:
        """The cost after a relative step, within the bounds and FARTHEST, if it is lower."""
        near = self.cells * np.clip(1 + step, 1 / FARTHEST, FARTHEST)
        target = np.clip(near, self.at.data.lower.ravel(), self.at.data.upper.ravel())
        promised = -float(self.curvature.gradient @ np.log(target / self.cells))
        if not promised > 0:
            return None
        found = self.at.elsewhere(target.reshape(self.at.cell_resistance.shape))
        return found if self.at.objective - found.objective >= DECREASE * promised else None
