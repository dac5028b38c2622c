"""One step of the projected Newton iteration: where it stands, where it goes, and whether that is better."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.solvers.certificate import Bend, Certificate, certificate, free_cells
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.directions import Factor, direction, raised
from lampest.solvers.newton.ways import LONGEST_STEP, ways

LARGEST_DAMPING = 1e10
DECREASE = 1e-4
EQUAL, HALVED = 1e-12, 0.5  # of the cost: where rounding hides a decrease, the residual must fall to this share
REPRODUCED = 1e-4  # of the cost's scale: 1e-12 of it at a tolerance of 1e-8, which is rounding
MOST_STOPS = 6
CONTRACTION = 0.2  # of a step by the next one: a new factor costs as much as two to three such steps
TIGHT = 0.5
# Which damping is nothing, and what share of it is kept; pairs of frames bend down all the way to their minimum.
NEGLIGIBLE, KEPT = {False: 1e-2, True: 1e-5}, {False: 0.1, True: 0.25}
SHARES = (1.0, 0.5, 0.25, 0.1, 0.02)


@dataclass(frozen=True, eq=False)
class Iterate:
    """Where the iteration stands: an evaluation with its curvature, the damping for the next step, the factor of second
    derivatives that made the last step, if there is one, and what that step promised (−∇φ·s).
    """

    curvature: Curvature
    objective: float
    damping: float
    factor: Factor | None = None
    promised: float = 0.0

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

    def sharp(self, tolerance: float) -> bool:
        """Whether the smoothing costs no more than a share of the cost's scale, and ten times that of the cost itself,
        if the cost is more than rounding.
        """
        allowed = min(self.at.cost_scale, max(10 * self.at.objective, REPRODUCED * self.at.cost_scale))
        return self.gap() * self.at.cost_scale <= tolerance * allowed

    def sharpened(self) -> "Iterate":
        """The same place with a tenth of the smoothing."""
        smoothing = replace(self.curvature.smoothing, width=self.curvature.smoothing.width / 10)
        return Iterate(Curvature(self.at, smoothing), smoothing.objective(self.at), 0.0)

    @cached_property
    def certificate(self) -> Certificate:
        """What one more step would do."""
        return certificate(self.curvature, self.curvature.gradient, self.factor)

    @property
    def falls(self) -> bool:
        """Whether second derivatives show a way down."""
        return self.curvature.factored and self.factor is None and self.certificate.bend is Bend.DOWN

    @property
    def converged(self) -> bool:
        """Whether one more step would do nothing: see `Certificate.converged`."""
        return self.certificate.converged(self.at.cost_scale)


def advance(point: Iterate, data: Data, residual: float) -> Iterate | None:
    """The next point, or None where no damping makes a step that lowers the cost."""
    lower, upper = (bound.ravel() for bound in data.log_bounds)
    position, slope = point.at.position.ravel(), point.curvature.gradient
    free = free_cells(point.at, slope)
    if (contracted := by_kept_factor(point, data, residual, free)) is not None:
        return contracted
    damping, accuracy = point.damping, min(0.1, residual**0.5)
    while damping <= LARGEST_DAMPING:
        moving, known, most = free, np.zeros(len(position)), 0.0
        first: Array | None = None
        for left in reversed(range(MOST_STOPS)):
            towards = direction(point.curvature, moving, known, damping, accuracy, point.factor)
            step, damping = towards.step, towards.damping
            reached = np.clip(position + step, lower, upper)
            beyond = moving & (reached != position + step)
            again = left > 0 and np.any(beyond)
            for length in SHARES[:1] if again else SHARES:
                straight = np.clip(position + np.clip(length * step, -LONGEST_STEP, None), lower, upper)
                promised = -float(slope @ (straight - position))
                most = max(most, promised)
                for way in ways(point.at, length * step, moving):
                    moved = trial(point, data, np.clip(position + way, lower, upper), damping, residual, promised)
                    if moved is not None:
                        return replace(moved, factor=towards.factor, promised=promised)
            if not again:
                break
            # A cell that stops at its bound leaves its partners' steps wrong: let it stop there and ask them again.
            share = (reached - position) / np.where(beyond, step, 1)
            first = share[beyond].min() * step if first is None else first
            stopped = first_stops(point.curvature, beyond, share)
            moving, known = moving & ~stopped, np.where(stopped, reached - position, known)
        if first is not None and (moved := _cut_short(point, data, first, residual)) is not None:
            return moved
        if most <= EQUAL * abs(point.objective) and point.converged:
            return None
        damping = raised(damping)
    return None


def _cut_short(point: Iterate, data: Data, step: Array, residual: float) -> Iterate | None:
    """The next point where a step ends at the first bound that it meets: cells that a heavy penalty ties together,
    though each to the next but loosely, do not stop one by one.
    """
    lower, upper = (bound.ravel() for bound in data.log_bounds)
    target = np.clip(point.at.position.ravel() + step, lower, upper)
    promised = -float(point.curvature.gradient @ step)
    return trial(point, data, target, 0.0, residual, promised)


def by_kept_factor(point: Iterate, data: Data, residual: float, free: NDArray[np.bool_]) -> Iterate | None:
    """The next point with the factor that made the last step, where it promises far less than that one did; else None.

    Source: Kelley, Solving Nonlinear Equations with Newton's Method, 2003, section 2.6 (the Shamanskii method).
    """
    factor, slope = point.factor, point.curvature.gradient
    if factor is None or not factor.exact or not np.array_equal(factor.cells, cells := np.flatnonzero(free)):
        return None
    step = np.zeros(len(slope))
    step[cells] = factor.solve(-slope[cells])
    promised = -float(slope @ step)
    lower, upper = (bound.ravel() for bound in data.log_bounds)
    target = point.at.position.ravel() + step
    inside = np.all(target >= lower) and np.all(target <= upper)
    if not inside or not 0 < promised <= CONTRACTION**2 * point.promised:
        return None
    moved = trial(point, data, target, 0.0, residual, promised)
    return None if moved is None else replace(moved, factor=factor, promised=promised)


def certain_step(point: Iterate, data: Data, residual: float) -> Iterate | None:
    """The point after the certificate's own step, on large panels: a step by conjugate gradients has fewer digits."""
    found = point.certificate
    if point.curvature.factored or found.bend is not Bend.UP:
        return None
    return trial(point, data, point.at.position.ravel() + found.step, 0.0, residual, found.decrement**2)


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
    if not better and not (abs(gain) <= EQUAL * abs(point.objective) and found.residual() < HALVED * residual):
        return None
    if better:
        damping = relaxed(damping, gain / promised, point.curvature.paired)
    return Iterate(Curvature(at, smoothing.moved(point.at, at)), found.objective, damping)


def relaxed(damping: float, share: float, paired: bool) -> float:
    """The next damping from the share of the first-order gain that a step had; a good Newton step has half."""
    if share > 0.25:
        return 0.0 if damping < NEGLIGIBLE[paired] else KEPT[paired] * damping
    return damping if share > 0.05 else raised(damping)
