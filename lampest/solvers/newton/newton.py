"""Projected, damped Newton in u = log r with potentials eliminated: the solver of the reduced formulation.

Cells that press against a bound are held; the others move by (∇²φ + μ·diag)⁻¹ ∇φ, exactly on small panels and by
preconditioned conjugate gradients on large ones, and stop at their bounds. μ grows where a step fails and vanishes near
a solution, so that the last steps converge quadratically. Absolute losses are smoothed less and less.
Source: Bertsekas, SIAM J. Control Optim. 20, 1982 (projection); Chan, Golub & Mulet, 1999 (smoothing).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.solvers.certificate import Certificate, certificate, free_cells
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.directions import Factor, direction, raised
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.newton.ways import LONGEST_STEP, ways
from lampest.solvers.solution import Outcome, Settings, Status

LARGEST_DAMPING = 1e10
DECREASE = 1e-4
MOST_STOPS = 6
TIGHT = 0.5
SHARES = (1.0, 0.5, 0.25, 0.1, 0.02)
MOST_UNSETTLED = 8  # steps of an estimate that passes all other tests; they converge quadratically or rounding has won


@dataclass(frozen=True, eq=False)
class Iterate:
    """Where the iteration stands: an evaluation with its curvature, the damping for the next step, and a factor of the
    second derivatives where the last step began, if there is one.
    """

    curvature: Curvature
    objective: float
    damping: float
    factor: Factor | None = None

    @property
    def at(self) -> Evaluation:
        """The cost at this point."""
        return self.curvature.at

    def residual(self) -> float:
        """The projected gradient, as the test of optimality measures it."""
        return self.at.projected_gradient(self.curvature.gradient.reshape(self.at.cell_resistance.shape))

    def gap(self) -> float:
        """What the smoothing of absolute losses may still cost, as the test of optimality measures it."""
        slope = self.curvature.smoothing.slope(self.at.rough)
        return self.at.dual_gap(slope) / self.at.cost_scale if len(slope) else 0.0

    def sharpened(self) -> "Iterate":
        """The same place with a tenth of the smoothing."""
        smoothing = replace(self.curvature.smoothing, width=self.curvature.smoothing.width / 10)
        return Iterate(Curvature(self.at, smoothing), smoothing.objective(self.at), 0.0)

    @cached_property
    def certificate(self) -> Certificate:
        """What one more step would do."""
        return certificate(self.curvature, self.curvature.gradient, self.factor)


@dataclass(frozen=True)
class Newton:
    """One cost on one panel shape."""

    cost: Cost
    settings: Settings

    def prepare(self) -> None:
        """Compile the cost, so that the first solve is not charged for it."""
        _ = self.cost.functions.hessian.pattern

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve: the outcome's status says so."""
        smoothing = Smoothing.start(start)
        point = Iterate(Curvature(start, smoothing), smoothing.objective(start), 0.0)
        unsettled = 0
        for iteration in range(self.settings.max_iterations):
            residual, gap = point.residual(), point.gap()
            near = residual <= max(self.settings.tolerance, 0.1 * gap)
            if near and gap > self.settings.tolerance:
                point = point.sharpened()
                continue
            if near and (unsettled == MOST_UNSETTLED or point.certificate.settled):
                return replace(outcome(point, Status.OPTIMUM, iteration), certificate=point.certificate)
            unsettled += near
            moved = advance(point, data, residual)
            if moved is None:
                return outcome(point, Status.OPTIMUM if near else Status.BREAKDOWN, iteration)
            point = moved
        return outcome(point, Status.ITERATIONS, self.settings.max_iterations)


def outcome(point: Iterate, status: Status, iterations: int) -> Outcome:
    """What the caller gets to see."""
    smoothing = point.curvature.smoothing
    return Outcome(point.at.cell_resistance, smoothing.slope(point.at.rough), status, iterations)


def advance(point: Iterate, data: Data, residual: float) -> Iterate | None:
    """The next point, or None where no damping makes a step that lowers the cost."""
    lower, upper = (bound.ravel() for bound in data.log_bounds)
    position, slope = np.log(point.at.cell_resistance).ravel(), point.curvature.gradient
    free = free_cells(point.at, slope)
    damping, accuracy = point.damping, min(0.1, residual**0.5)
    while damping <= LARGEST_DAMPING:
        moving, known = free, np.zeros(len(position))
        for left in reversed(range(MOST_STOPS)):
            towards = direction(point.curvature, moving, known, damping, accuracy)
            step, damping = towards.step, towards.damping
            reached = np.clip(position + step, lower, upper)
            beyond = moving & (reached != position + step)
            again = left > 0 and np.any(beyond)
            for length in SHARES[:1] if again else SHARES:
                straight = np.clip(length * step, -LONGEST_STEP, None)
                promised = -float(slope @ (np.clip(position + straight, lower, upper) - position))
                for way in ways(point.at, length * step, moving):
                    target = np.clip(position + way, lower, upper)
                    moved = trial(point, data, target, damping, residual, promised)
                    if moved is not None:
                        return replace(moved, factor=towards.factor)
            if not again:
                break
            # A cell that stops at its bound leaves its partners' steps wrong: let it stop there and ask them again.
            stopped = first_stops(point.curvature, beyond, (reached - position) / np.where(beyond, step, 1))
            moving, known = moving & ~stopped, np.where(stopped, reached - position, known)
        damping = raised(damping)
    return None


def first_stops(curvature: Curvature, beyond: NDArray[np.bool_], share: Array) -> NDArray[np.bool_]:
    """Of the cells that would go beyond a bound, those that do so first among the ones they are tightly coupled to."""
    cells = np.flatnonzero(beyond)
    local = sparse.coo_array(curvature.local[cells][:, cells])
    size = np.sqrt(np.abs(curvature.local.diagonal()[cells]))
    tight = np.abs(local.data) > TIGHT * size[local.row] * size[local.col]
    links = sparse.coo_array((np.ones(tight.sum()), (local.row[tight], local.col[tight])), shape=local.shape)
    count, group = connected_components(links, directed=False)
    first = np.full(count, np.inf)
    np.minimum.at(first, group, share[cells])
    stops = np.zeros(len(beyond), dtype=bool)
    stops[cells[share[cells] <= first[group]]] = True
    return stops


def trial(
    point: Iterate, data: Data, target: Array, damping: float, residual: float, promised: float
) -> Iterate | None:
    """The point at u = `target` if it is better: a lower cost, or, where rounding hides that, half the residual.

    promised : by how much the gradient alone would have the cost fall.
    """
    cells = np.clip(np.exp(target).reshape(data.measured.shape), data.lower, data.upper)
    smoothing = point.curvature.smoothing
    try:
        at = Evaluation.at(point.at.cost, data, cells)
    except np.linalg.LinAlgError:
        return None
    found = Iterate(Curvature(at, smoothing), smoothing.objective(at), damping)
    gain = point.objective - found.objective
    better = promised > 0 and gain >= DECREASE * promised
    if not better and not (abs(gain) <= 1e-12 * abs(point.objective) and found.residual() < 0.5 * residual):
        return None
    damping = relaxed(damping, gain / promised) if better else damping
    return Iterate(Curvature(at, smoothing.moved(point.at, at)), found.objective, damping)


def relaxed(damping: float, share: float) -> float:
    """The next damping from the share of the first-order gain that a step had; a good Newton step has half."""
    if share > 0.25:
        return 0.0 if damping < 1e-2 else damping / 10
    return damping if share > 0.05 else raised(damping)
