"""Projected trust-region Newton method with potentials eliminated: the solver of the reduced formulation.

An iteration: active set, direction by Steihaug and Toint's conjugate gradients with the exact ∇²φ, projection on the
bounds, acceptance, radius. The unknowns are relative changes s of the conductances, g ← g·(1 − s), in which readings
are closest to quadratic. Absolute losses are smoothed less and less.
Source: Lin & Moré, SIAM J. Optim. 9, 1999; Chan, Golub & Mulet, SIAM J. Sci. Comput. 20, 1999 (smoothing).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.panel.trust_region import Linear, restricted, steihaug
from lampest.solvers.active_kinks import unsmoothed_minimum
from lampest.solvers.bounds import MILLIONTH, STILL, free_cells, moved_by
from lampest.solvers.certificate import Certificate, Definiteness, certificate
from lampest.solvers.hessian import Hessian
from lampest.solvers.interior_point import by_interior_point
from lampest.solvers.preconditioners import Preconditioner, gauss_newton_factor, preconditioner
from lampest.solvers.smoothing import Smoothing
from lampest.solvers.solution import Outcome, Settings, Status
from lampest.solvers.termination import ProgressWindow

ACCEPTED = 1e-4  # of the predicted decrease, as in Nocedal & Wright, 2006, algorithm 4.1
SHORTER = 0.25  # of a rejected step: the radius for the next try
FARTHEST = float(np.log(4.0))  # of log r in one step: beyond, the quadratic model of a cell is wrong
MOST_TRIES = 15  # solves of a direction, in which cells stop at bounds; tries of a step (4⁻¹⁵ is rounding); last steps
GAUSS_NEWTON = 3  # steps with JᵀWJ before a direction of negative curvature is followed
WORN = {True: 5, False: 30}  # products of a step after which a kept preconditioner is made anew: dense, sparse
MOST_PRODUCTS = {True: 40, False: 400}  # of a solve: a factor anew is cheaper on small problems
MOVED = 0.7  # of log r: the same; without it small panels take a third more products
NEAR = 0.01  # of log r: second derivatives change by as much; before a step of its square ∇²φ is factored
LEAST_DAMPING, DAMPED, MOST_DAMPING = 1e-15, 1e-4, 1e3  # μ: to begin with, of a second try, at most


@dataclass(frozen=True)
class ProjectedNewton:
    """One cost on one panel shape. kept : the preconditioner that the frame before left, or None."""

    cost: Cost
    settings: Settings
    kept: Preconditioner | None = None

    def prepare(self) -> None:
        """Compile the cost, so that the first solve is not charged for it."""
        _ = self.cost.functions.hessian.pattern

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. Never raises for a failed solve: the outcome's status says so."""
        start, iteration = by_interior_point(start)
        point, unsettled, tolerance = Iterate.of(start, Smoothing.start(start), self.kept), 0, self.settings.tolerance
        progress = ProgressWindow()
        while iteration < self.settings.max_iterations:
            if data.overdue:
                return point.outcome(Status.TIME, iteration)
            progress = progress.after(point.hessian.smoothing.width, point.objective, point.residual)
            if progress.stalled:
                return point.outcome(Status.STALLED, iteration)
            near = point.residual <= tolerance
            if near or point.residual <= point.gap / 2:
                if not point.sharp(tolerance):
                    point, iteration = point.sharpened(), iteration + 1
                    continue
                flat = not point.residual and point.certificate.lower is None
                if point.certificate.settled or flat or unsettled == MOST_TRIES:
                    return point.unsmoothed(iteration) or point.outcome(Status.OPTIMUM, iteration)
                unsettled += 1
            moved = (escaped(point) if near else None) or advanced(point)
            if moved is None or not moved.gauss_newton:
                trials = [trial for trial in (moved, damped_step(point)) if trial is not None]
                moved = min(trials, key=lambda trial: trial.objective, default=None) or escaped(point)
            if moved is None:
                if (ended := point.unsmoothed(iteration)) is not None:
                    return ended
                if point.sharp(tolerance):
                    return point.outcome(Status.OPTIMUM if near else Status.BREAKDOWN, iteration)
                moved = point.sharpened()
            point, iteration = moved, iteration + 1
        return point.outcome(Status.ITERATIONS, iteration)


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point with its derivatives; objective : φ, smoothed. kept : M, or None.

    gauss_newton : how many more steps with JᵀWJ may avoid negative curvature. convex : whether no direction on the way
    here had any. expected : the length of the next step of log r, as the residual fell in the one before it.
    nearby : the certificate of a point before, or None.
    """

    hessian: Hessian
    objective: float
    kept: Preconditioner | None = None
    gauss_newton: int = GAUSS_NEWTON
    convex: bool = True
    expected: float = inf
    nearby: Certificate | None = None
    damping: float = LEAST_DAMPING

    @classmethod
    def of(
        cls, at: Evaluation, smoothing: Smoothing, kept: Preconditioner | None = None, convex: bool = True
    ) -> "Iterate":
        """Where a solve begins."""
        return cls(Hessian(at, smoothing), smoothing.objective(at), kept, convex=convex)

    @property
    def at(self) -> Evaluation:
        """The cost at this point."""
        return self.hessian.at

    @cached_property
    def residual(self) -> float:
        """The projected gradient, relative to the cost's scale."""
        return self.at.projected_gradient(self.hessian.gradient.reshape(self.at.cell_resistance.shape))

    @cached_property
    def gap(self) -> float:
        """What the smoothing of absolute losses may still cost, relative to the cost's scale."""
        if not len(self.at.nonsmooth):
            return 0.0
        return self.at.dual_gap(self.hessian.smoothing.slope(self.at.nonsmooth)) / self.at.cost_scale

    def sharp(self, tolerance: float) -> bool:
        """Whether the smoothing costs no more than a share of the cost, and is not mere rounding."""
        allowed = min(self.at.cost_scale, max(10 * self.at.objective, 1e-4 * self.at.cost_scale))
        return self.gap * self.at.cost_scale <= tolerance * allowed

    def sharpened(self) -> "Iterate":
        """The same place with a tenth of the smoothing."""
        smoothing = self.hessian.smoothing
        return Iterate.of(self.at, replace(smoothing, width=smoothing.width / 10), convex=self.convex)

    @cached_property
    def certificate(self) -> Certificate:
        """What one more step would do; by the factor of a point before, where ∇²φ has hardly changed since."""
        before, cells = self.nearby, self.at.cell_resistance
        if before is not None and before.factor is not None and before.factor.distance(cells) <= NEAR**2:
            free = np.flatnonzero(free_cells(self.at, self.hessian.gradient))
            if before.definiteness is Definiteness.POSITIVE and np.array_equal(free, before.factor.cells):
                return before.after(self.at, self.hessian.gradient)
        return certificate(self.hessian, self.kept)

    @property
    def known(self) -> Certificate | None:
        """The newest certificate that was made."""
        found: Certificate | None = self.__dict__.get("certificate")
        return found or self.nearby

    @property
    def newest(self) -> Preconditioner | None:
        """The last factor of ∇²φ, where there is one, or what was kept."""
        return self.kept if self.known is None or self.known.factor is None else self.known.factor

    def outcome(self, status: Status, iterations: int) -> Outcome:
        """What the caller gets, after the certificate's own step where that comes from a factor and certifies."""
        found, cells = self.__dict__.get("certificate"), self.at.cell_resistance
        dual = self.hessian.smoothing.slope(self.at.nonsmooth)
        factored = found is not None and found.factor is not None and found.settled and not len(dual)
        if found is not None and factored and MILLIONTH / 1000 < float(np.abs(found.step).max()) <= NEAR:
            cells = np.exp(self.at.position + found.step.reshape(cells.shape))
        return Outcome(cells, dual, status, iterations, found, self.newest, self.convex, self.at)

    def unsmoothed(self, iterations: int) -> Outcome | None:
        """The minimum nearby without any smoothing; None where there are no absolute losses, or none is found."""
        found = unsmoothed_minimum(self.at, self.hessian.smoothing.slope(self.at.nonsmooth))
        if found is None:
            return None
        at, dual, certified = found
        return Outcome(at.cell_resistance, dual, Status.OPTIMUM, iterations + 1, certified, convex=self.convex)

    def at_step(self, step: Array) -> "Iterate | None":
        """The point after a step of u (flat), within the bounds; None where its network cannot be solved."""
        at = moved_by(self.at, step)
        return None if at is None else Iterate.of(at, self.hessian.smoothing.moved(self.at, at), self.kept, self.convex)

    def expects(self, trial: "Iterate") -> float:
        """How long the step after one to `trial` will be, of log r; infinite where losses are smoothed."""
        moved = float(np.abs(trial.at.position - self.at.position).max())
        return inf if len(self.at.nonsmooth) else moved * trial.residual / (self.residual or 1.0)

    def accepts(self, trial: "Iterate | None", predicted: float) -> float:
        """The ratio of actual to predicted decrease; where rounding hides it, 1 or −1: did the gradient halve?"""
        if trial is None or not np.isfinite(trial.objective):
            return -1.0
        gain = self.objective - trial.objective
        invisible = STILL * abs(self.objective)
        if predicted > invisible:
            return gain / predicted
        return 1.0 if abs(gain) <= invisible and trial.residual <= self.residual / 2 else -1.0


@dataclass(frozen=True, eq=False)
class Direction:
    """step : of u = log r, within the bounds. predicted : decrease of the quadratic model. length : ‖s‖_M.

    products : of the longest of its solves. negative : whether negative curvature was met.
    """

    step: Array
    predicted: float
    length: float
    products: int
    negative: bool


def advanced(point: Iterate) -> Iterate | None:
    """The next point by a trust-region step; None where no radius makes one that is accepted.

    Every iteration begins with the whole step: readings at a rail curve the cost on one side alone.
    """
    hessian, cells = point.hessian, point.at.cell_resistance
    if point.expected <= NEAR**2 and not len(point.at.nonsmooth):
        _ = point.certificate
    free, kept = free_cells(point.at, hessian.gradient), point.newest
    if kept is None or kept.distance(cells) > MOVED:
        kept = preconditioner(hessian, free)
    radius, patience, convex = inf, point.gauss_newton, point.convex
    curved = np.zeros_like(hessian.gradient) if shares_conductance(point.at) else hessian.gradient
    exact: Linear = lambda step: hessian.product(step) + curved * step  # noqa: E731
    product = exact
    for _ in range(MOST_TRIES):
        found = direction(point, kept, free, product, radius)
        convex = convex and not found.negative
        if found.negative and patience and product is exact:
            damped = None if len(point.at.nonsmooth) else damped_step(point)
            if damped is not None:
                return replace(damped, gauss_newton=patience - 1, convex=False)
            product, patience = hessian.gauss_newton_product, patience - 1
            kept = gauss_newton_factor(hessian, free) or kept
            found = direction(point, kept, free, product, radius)
        trial = point.at_step(found.step)
        ratio = point.accepts(trial, found.predicted)
        if trial is not None and ratio >= ACCEPTED:
            worn = found.products > WORN[hessian.dense]
            patience = patience if found.negative or product is not exact else GAUSS_NEWTON
            expected = point.expects(trial) if hessian.dense else inf
            kept, nearby = None if worn else kept, None if worn else point.known
            return Iterate(trial.hessian, trial.objective, kept, patience, convex, expected, nearby, point.damping)
        radius = SHORTER * found.length
        if not radius > 0:
            break
    return None


def shares_conductance(at: Evaluation) -> bool:
    """Whether lines touch and no penalty says how parallel cells share: in log r they stay near the start's shares."""
    wiring = at.data.wiring
    return wiring is not None and bool(wiring.joined) and all(term.reads_measurement for term in at.cost.terms)


def direction(
    point: Iterate, kept: Preconditioner, free: NDArray[np.bool_], product: Linear, radius: float
) -> Direction:
    """argmin of the quadratic model within radius and bounds: cells beyond a bound stop there, the others go on."""
    at, gradient = point.at, point.hessian.gradient
    lower, upper = (bound.ravel() - at.position.ravel() for bound in at.data.log_bounds)
    low, high = np.maximum(lower, -FARTHEST), np.minimum(upper, FARTHEST)
    logarithmic = shares_conductance(at)
    if not logarithmic:
        low, high = -np.expm1(-low), -np.expm1(-high)
    accuracy = min(0.1, point.residual**0.5)
    moving, step, slope = free, np.zeros(free.size), gradient
    most, negative, length, predicted = 0, False, 0.0, -inf
    for _ in range(MOST_TRIES):
        chosen = np.flatnonzero(moving)
        among, precondition = restricted(product, chosen, free.size), kept.over(moving, at.cell_resistance)
        most_products = MOST_PRODUCTS[point.hessian.dense]
        found = steihaug(among, precondition, slope[chosen], accuracy, radius, most_products=most_products)
        most, negative, length = max(most, found.products), negative or found.negative, found.length
        step = np.where(moving, 0.0, step)
        step[chosen] = found.step
        beyond = moving & ((step < low) | (step > high))
        if not beyond.any():
            if moving is free:
                predicted = found.decrease
            break
        step = np.clip(step, low, high)
        moving = moving & ~beyond
        if not moving.any():
            break
        slope = gradient + product(np.where(moving, 0.0, step))
    if predicted == -inf:
        predicted = -float(gradient @ step + 0.5 * step @ product(step))
    return Direction(step if logarithmic else -np.log1p(-step), predicted, length, most, negative)


def escaped(point: Iterate) -> Iterate | None:
    """From a saddle, where the certificate has seen the cost fall."""
    lower = point.certificate.lower
    return None if lower is None else Iterate.of(lower, point.hessian.smoothing.moved(point.at, lower), convex=False)


def damped_step(point: Iterate) -> Iterate | None:
    """Levenberg's step (JᵀWJ + PᵀKP + μ·diag)⁻¹·(−∇φ) in log r.

    None on large problems, or where no μ lowers the cost.
    """
    hessian, free = point.hessian, free_cells(point.at, point.hessian.gradient)
    if not hessian.dense or not free.any():
        return None
    slope, damping = hessian.gradient[free], point.damping
    while damping <= MOST_DAMPING:
        factor = gauss_newton_factor(hessian, free, damping)
        if factor is not None:
            step = np.zeros(free.size)
            step[free] = np.clip(factor.solve(-slope), -FARTHEST, FARTHEST)
            trial, predicted = point.at_step(step), -0.5 * float(step[free] @ slope)
            if trial is not None and (gain := point.objective - trial.objective) > ACCEPTED * predicted:
                eased = damping / 10 if gain > predicted / 2 else damping
                return replace(trial, kept=None, damping=max(eased, LEAST_DAMPING))
        damping = max(10 * damping, DAMPED)
    return None
