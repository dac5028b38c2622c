"""Projected, damped Newton in u = log r with potentials eliminated: the solver of the reduced formulation.

Cells that press against a bound are held; the others move by (∇²φ + μ·diag)⁻¹ ∇φ, exactly on small panels and by
preconditioned conjugate gradients on large ones, and stop at their bounds. μ grows where a step fails and vanishes near
a solution, so that the last steps converge quadratically. Absolute losses are smoothed less and less.
Source: Bertsekas, SIAM J. Control Optim. 20, 1982 (projection); Chan, Golub & Mulet, 1999 (smoothing).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.solvers.certificate import NEARBY, Bend, free_cells
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.directions import FOLLOWED, Factor
from lampest.solvers.newton.exactly import exactly
from lampest.solvers.newton.groping import advanced
from lampest.solvers.newton.inside import from_inside
from lampest.solvers.newton.pieces import by_pieces, has_pieces
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.newton.steps import Iterate, by_kept_factor, certain_step
from lampest.solvers.newton.straight import from_afar
from lampest.solvers.solution import Outcome, Settings, Status

# Iterations: who has kinks or corners and still moves is taken piece by piece; not along the bent valleys of cells that
# lines in touch make parallel.
GROPING = 15
# Two frames of so many cells together that conjugate gradients have not brought to an end go on by factors, which take
# 35 ms each there; they took 4 to 40 more iterations where readings off by 5 % let cells run to bounds far away.
WINDING, WINDING_UNKNOWNS = 40, 1200
MOST_UNSETTLED = 8  # steps of an estimate that passes all other tests; they converge quadratically or rounding has won

STALLED = 1e-11  # of the cost with absolute losses rounded: steps that lower it by less follow the rounding's valleys


@dataclass(frozen=True)
class Newton:
    """One cost on one panel shape.

    factor : of the frame before, which makes the first step where it is near. shortcut : what is tried first, and
    returns None where it falls short.
    """

    cost: Cost
    settings: Settings
    factor: Factor | None = None
    shortcut: "Callable[[Newton, Data, Evaluation], Outcome | None] | None" = None

    def following(self, factor: Factor | None) -> "Newton":
        """The same for the frame after one that left this factor."""
        return replace(self, factor=factor)

    def prepare(self) -> None:
        """Compile the cost, so that the first solve is not charged for it."""
        _ = self.cost.functions.hessian.pattern

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve: the outcome's status says so.

        Iterations are the factors and the solves by conjugate gradients, and pieces of kinked losses; steps that use a
        factor again do not count.
        """
        if self.shortcut is not None and (found := self.shortcut(self, data, start)) is not None:
            return found
        start, iteration = from_inside(start)
        start, further, rough = from_afar(start)
        iteration += further
        smoothing = Smoothing.start(start)
        point = self._begun(Iterate(Curvature(start, smoothing), smoothing.objective(start), 0.0, rough), data)
        unsettled, pieces = 0, has_pieces(self.cost, point.at.cell_resistance.size)
        winding = point.at.cell_resistance.size <= WINDING_UNKNOWNS and not len(self.cost.slope)
        stands = stalled = stuck = False
        while iteration < self.settings.max_iterations:
            if data.overdue:
                return outcome(point, Status.TIME, iteration)
            if iteration >= WINDING and winding and point.curvature.paired:
                point, data = _by_factors(point, data)
                unsettled, stands, stalled = 0, False, False
            if pieces and (stuck or (iteration >= GROPING and data.wiring is None)):
                point, whole, count = by_pieces(point, data)
                iteration += count
                if whole:
                    return certified(point, iteration)
                unsettled, stands, stalled, stuck, pieces = 0, False, False, False, False
                continue
            residual, gap = point.residual(), point.gap()
            near = residual <= max(self.settings.tolerance, 0.1 * gap) or (stands and point.converged)
            flat = near and (unsettled == MOST_UNSETTLED or not point.falls)
            if (stalled or flat) and not point.sharp(self.settings.tolerance):
                if (ended := exactly(point, data)) is not None:
                    return certified(ended, iteration + 1)
                point, iteration, unsettled, stands, stalled = point.sharpened(), iteration + 1, 0, False, False
                continue
            if stalled and not near:
                if stuck := pieces:
                    continue
                return outcome(point, Status.BREAKDOWN, iteration)
            if near and (unsettled == MOST_UNSETTLED or point.certificate.settled):
                if stuck := pieces and point.certificate.bend is Bend.DOWN:
                    continue
                return certified(point, iteration)
            unsettled += near
            moved = (certain_step(point, data, residual) if near else None) or advanced(point, data, residual)
            if moved is None:
                if (ended := exactly(point, data)) is not None:
                    return certified(ended, iteration + 1)
                if not near and not stands and point.converged:
                    stands = True
                    continue
                if stuck := pieces:
                    continue
                return outcome(point, Status.OPTIMUM if near else Status.BREAKDOWN, iteration)
            stands, stalled = False, _stalled(point, moved)
            again = moved.factor is not None and moved.factor is point.factor and moved.factor.exact
            point, iteration = moved, iteration if again else iteration + 1
        return outcome(point, Status.ITERATIONS, self.settings.max_iterations)

    def _begun(self, point: Iterate, data: Data) -> Iterate:
        """The point after one step with the factor of the frame before, if that gets it anywhere.

        It is not kept for a second one: what certifies a point is of its own cost. Absolute losses are smoothed too
        differently at the end of one solve and the beginning of the next.
        """
        if self.factor is None or len(point.at.cost.slope):
            return point
        free = free_cells(point.at, point.curvature.gradient)
        if not self.factor.serves(np.flatnonzero(free), point.at.cell_resistance, FOLLOWED):
            return point
        known = replace(point, factor=self.factor, promised=np.inf)
        moved = by_kept_factor(known, data, point.residual(), free)
        return point if moved is None else replace(moved, factor=None)


def _by_factors(point: Iterate, data: Data) -> tuple[Iterate, Data]:
    """The same place on a panel of which second derivatives are factored."""
    data = replace(data, factored=True)
    at = Evaluation.at(point.at.cost, data, point.at.cell_resistance)
    return Iterate(Curvature(at, point.curvature.smoothing), point.objective, 0.0), data


def _stalled(point: Iterate, moved: Iterate) -> bool:
    """Whether a step led along a valley of the rounded kinks alone."""
    return len(point.at.rough) > 0 and point.objective - moved.objective <= STALLED * point.objective


def outcome(point: Iterate, status: Status, iterations: int) -> Outcome:
    """What the caller gets to see."""
    smoothing = point.curvature.smoothing
    factor = point.factor if point.factor is not None and point.factor.exact else None
    return Outcome(point.at.cell_resistance, smoothing.slope(point.at.rough), status, iterations, factor=factor)


def certified(point: Iterate, iterations: int) -> Outcome:
    """An optimum, after the step that certifies it where a factor has made that: what is checked next costs no more.

    Not after one that is small against what the noise leaves open alone: derivatives hold no further than NEARBY.
    Absolute losses keep their duals at the point itself.
    """
    found = replace(outcome(point, Status.OPTIMUM, iterations), certificate=point.certificate)
    step = point.certificate.step.reshape(point.at.position.shape)
    far = float(np.abs(step).max(initial=0.0)) > NEARBY
    if found.factor is None or not point.certificate.settled or len(found.dual) or far:
        return found
    position = point.at.position + step
    return replace(found, cell_resistance=np.exp(position))
