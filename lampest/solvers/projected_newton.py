"""Projected trust-region Newton method for the reduced formulation, potentials eliminated.

An iteration: active set, direction by Steihaug and Toint's conjugate gradients with the exact ∇²φ,
projection on the bounds, acceptance, radius. The unknowns are relative changes s of the
conductances, see `lampest.solvers.direction`. Absolute losses are smoothed less and less.
Source: Lin & Moré, SIAM J. Optim. 9, 1999; Chan, Golub & Mulet, SIAM J. Sci. Comput. 20, 1999
(smoothing).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.panel.trust_region import SUFFICIENT_DECREASE, SubproblemStep
from lampest.solvers.certificate import Definiteness, toward_readings
from lampest.solvers.direction import (
    MAX_CHANGE,
    MAX_TRIES,
    RADIUS_FACTOR,
    ActiveSet,
    History,
    QuadraticModel,
    exceeds_rounding,
    hold_beyond_bounds,
    late_or_stalled,
    newton_direction,
    sufficient_decrease,
)
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.iterate import GAUSS_NEWTON_STEPS, MIN_DAMPING, Iterate
from lampest.solvers.preconditioners import Preconditioner, gauss_newton_factor
from lampest.solvers.solution import Outcome, Solver, Status

# Fraction of a solver's tolerance with absolute losses; optima agree to 1e-9 of the cost.
KINKED_SHARE = 0.1
NEXT_DAMPING = 1e-4  # least μ of a second try of Levenberg's step
MAX_DAMPING = 1e3
# Projected gradient, relative to the cost's scale, below which a start does not follow the central
# path. Frames in sequence begin at 0.05, frames that are solved again at their tolerance.
PATH_TOLERANCE = 1e-3


@dataclass(frozen=True)
class NewtonParts:
    """Exchangeable parts of an iteration.

    Attributes
    ----------
    direction : callable
        (point, model, radius, active set) → step of log r, see `newton_direction`.
    active_set : callable
        Cells that keep moving when a step reaches bounds, see `hold_beyond_bounds`.
    acceptance : callable
        (point, trial, predicted decrease) → whether the trial is the next point, see
        `sufficient_decrease`.
    termination : callable
        (data, history) → why the solve ends before an optimum, or None, see `late_or_stalled`.
    """

    direction: Callable[[Iterate, QuadraticModel, float, ActiveSet], SubproblemStep] = (
        newton_direction
    )
    active_set: ActiveSet = hold_beyond_bounds
    acceptance: Callable[[Iterate, Iterate, float], bool] = sufficient_decrease
    termination: Callable[[Data, History], Status | None] = late_or_stalled


@dataclass(frozen=True)
class ProjectedNewton(Solver):
    """Solver of one cost on one panel shape.

    Attributes
    ----------
    cost : Cost
    settings : Settings
    preconditioner : Preconditioner or None
        Preconditioner that the previous frame ended with.
    from_afar : bool
        Whether the start is far from an optimum of a cost with several minima, and its central path
        is followed first.
    parts : NewtonParts
        Direction, active set, acceptance and termination.
    """

    preconditioner: Preconditioner | None = None
    from_afar: bool = False
    parts: NewtonParts = NewtonParts()

    @property
    def name(self) -> str:
        """The solver in words."""
        return "Newton"

    def continued(self, carried: object) -> "ProjectedNewton":
        """Return the solver that begins with the preconditioner of the frame before."""
        preconditioner = carried if isinstance(carried, Preconditioner) else None
        return replace(self, preconditioner=preconditioner)

    def cold(self) -> "ProjectedNewton":
        """Return the solver that follows the central path of the barrier from its start."""
        return replace(self, preconditioner=None, from_afar=True)

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`.

        A failed solve does not raise; the outcome's status states the failure.
        """
        if start.data.start_minimises(start.cost):
            cells = start.data.start(start.cell_resistance)
            convex = start.elsewhere(np.clip(cells, start.data.lower, start.data.upper))
            start = min(start, convex, key=lambda at: at.objective)
        iteration = 0
        if (self.from_afar and has_central_path(start)) or crowds_bounds(start):
            from lampest.solvers.interior_point import central_path  # for such a start alone

            start, iteration = central_path(start, self.settings.max_iterations)
        iterate = Iterate.of(start, Smoothing.start(start), self.preconditioner)
        history = list[tuple[float, float]]()
        unsettled = 0
        tolerance = self.settings.tolerance
        if len(start.cost.slope):
            tolerance *= KINKED_SHARE
        while iteration < self.settings.max_iterations:
            history.append((iterate.objective, iterate.residual))
            status = self.parts.termination(data, history)
            if status is not None:
                return iterate.outcome(status, iteration)
            stationary = iterate.residual <= tolerance
            sharp = iterate.sharp(tolerance)
            dual = iterate.dual_of_optimum(tolerance)
            # At an optimum: end where the certificate holds.
            if dual is not None:
                iterate = iterate.certified()
                if iterate.settled or unsettled == MAX_TRIES:
                    return iterate.outcome(Status.OPTIMUM, iteration, dual)
                unsettled += 1
            trial = None
            if sharp or not stationary:
                iterate, trial = self._stepped(iterate, stationary=stationary)
            # Without a step the solve ends unless absolute losses can still be smoothed less.
            if trial is None and sharp:
                status = Status.BREAKDOWN if dual is None else Status.OPTIMUM
                return iterate.outcome(status, iteration, dual)
            reached = trial or iterate.centred()
            iterate = reached.sharpened(tolerance)
            if iterate is not reached:
                history = []
            iteration += 1
        return iterate.outcome(Status.ITERATIONS, iteration)

    def _stepped(self, point: Iterate, *, stationary: bool) -> tuple[Iterate, Iterate | None]:
        """Return a point, with its certificate where a step needs it, and the next point or None.

        Beside a saddle the next point is the certificate's point of lower cost.
        """
        if stationary:
            point = point.certified()
            lower = point.below_saddle
            if lower is not None:
                return point, lower
        if point.converges:
            # Near convergence the certificate has the step, or its factor preconditions one.
            point = point.certified()
        trial = certified_step(point, self.parts) or descent_step(point, self.parts)
        if trial is not None:
            return point, trial
        point = point.certified()
        return point, point.below_saddle


def has_central_path(start: Evaluation) -> bool:
    """Return whether a start has a central path: bounds are finite, and no loss is absolute."""
    data = start.data
    return bool(np.all(np.isfinite([1 / data.lower, data.upper]))) and not len(start.cost.slope)


def crowds_bounds(start: Evaluation) -> bool:
    """Return whether the cost is plain least squares of a large frame with crowded bounds.

    The frame then has more cells at a bound than lines.
    """
    hessian = Hessian(start, Smoothing.start(start))
    data = start.data
    cells = start.cell_resistance
    squared = all(term.loss.squared for term in start.cost.terms)
    if hessian.dense or not hessian.only_data or not squared:
        return False
    # 1/(1/r) and exp(log r) of a bound differ from it in their last bits.
    at_bound = np.isclose(cells, [data.lower, data.upper], rtol=1e-12, atol=0).any(axis=0)
    crowded = np.sum(at_bound & (data.lower < data.upper)) > sum(cells.shape[1:])
    return bool(crowded and has_central_path(start) and hessian.residual > PATH_TOLERANCE)


def certified_step(point: Iterate, parts: NewtonParts = NewtonParts()) -> Iterate | None:
    """Return the next point by the Newton step of a certificate; None without an accepted one.

    It is the certificate of the point, or that of plain least squares by cells nearby that
    reproduce all readings. Its step needs no conjugate gradients. Of large panels, and of absolute
    losses, these keep more digits.
    """
    if not point.hessian.dense or len(point.at.nonsmooth):
        return None
    verdict = point.certificate or toward_readings(point.hessian)
    if verdict is None or verdict.definiteness is not Definiteness.POSITIVE:
        return None
    trial = point.at_step(verdict.step)
    if trial is None or not parts.acceptance(point, trial, 0.5 * verdict.decrement**2):
        return None
    patience = GAUSS_NEWTON_STEPS
    return _next_point(point, trial, point.newest_preconditioner, patience, convex=point.convex)


def descent_step(point: Iterate, parts: NewtonParts = NewtonParts()) -> Iterate | None:
    """Return the next point; None if no step lowers the cost.

    While directions of negative curvature persist, the trust-region step and Levenberg's step are
    both computed, and the point of lower cost is returned.
    """
    trial = trust_region_step(point, parts)
    if trial is not None and trial.gauss_newton:
        return trial
    trials = [candidate for candidate in (trial, levenberg_step(point)) if candidate is not None]
    return min(trials, key=lambda candidate: candidate.objective, default=None)


def trust_region_step(point: Iterate, parts: NewtonParts) -> Iterate | None:
    """Return the next point by a trust-region step; None if no radius gives an accepted step.

    Every iteration begins with an infinite radius: one-sided readings curve the cost on one side
    only, so that the radius of one iteration need not suit the next.
    """
    model = QuadraticModel.of(point)
    radius = inf
    patience = point.gauss_newton
    convex = point.convex
    for _ in range(MAX_TRIES):
        direction = parts.direction(point, model, radius, parts.active_set)
        convex = convex and not direction.negative
        # Negative curvature: up to `gauss_newton` times, a Levenberg step or the Gauss–Newton
        # matrix replaces ∇²φ.
        if direction.negative and patience and model.exact:
            damped = None if len(point.at.nonsmooth) else levenberg_step(point)
            if damped is not None:
                return replace(damped, gauss_newton=patience - 1, convex=False)
            model = model.gauss_newton(point)
            patience -= 1
            direction = parts.direction(point, model, radius, parts.active_set)
        trial = point.at_step(direction.step)
        if trial is not None and parts.acceptance(point, trial, direction.decrease):
            if model.exact and not direction.negative:
                patience = GAUSS_NEWTON_STEPS
            return _next_point(point, trial, model.preconditioner, patience, convex=convex)
        # Rejected: try again within a smaller radius. Where the decrease is within rounding, the
        # gradient would have to halve, which a step of a quarter of the length cannot do.
        if trial is not None and not exceeds_rounding(point, abs(direction.decrease)):
            break
        radius = RADIUS_FACTOR * direction.length
        if not radius > 0:
            break
    return None


def _next_point(
    point: Iterate,
    trial: Iterate,
    preconditioner: Preconditioner | None,
    patience: int,
    *,
    convex: bool,
) -> Iterate:
    """Return an accepted trial with a preconditioner and the certificate of its predecessor."""
    # Linear convergence: the next step is shorter by the ratio of the residuals.
    moved = np.abs(trial.at.position - point.at.position).max()
    small = point.hessian.dense and not len(point.at.nonsmooth)
    return replace(
        trial,
        preconditioner=preconditioner,
        gauss_newton=patience,
        convex=convex,
        damping=point.damping,
        expected=moved * trial.residual / (point.residual or 1.0) if small else inf,
        nearby=point.newest_certificate,
    )


def levenberg_step(point: Iterate) -> Iterate | None:
    """Return the point after Levenberg's step over the free cells.

    The step is δu = −(JᵀWJ + PᵀKP + μ·diag)⁻¹ ∇φ. The damping μ of the next step is a tenth if the
    cost fell by at least half of the predicted decrease (Moré 1978). Returns None on large
    problems, or if no μ lowers the cost by more than its rounding.
    """
    hessian = point.hessian
    free = point.hessian.free
    if not hessian.dense or not free.any():
        return None
    slope = hessian.gradient[free]
    damping = point.damping
    while damping <= MAX_DAMPING:
        factor = gauss_newton_factor(hessian, free, damping)
        if factor is not None:
            step = np.zeros(free.size)
            step[free] = np.clip(factor.solve(-slope), -MAX_CHANGE, MAX_CHANGE)
            trial = point.at_step(step)
            # Predicted decrease of the damped model: −½ ∇φᵀδu
            predicted = -0.5 * float(step[free] @ slope)
            if not exceeds_rounding(point, predicted):
                return None
            decrease = -inf if trial is None else point.objective - trial.objective
            if trial is not None and decrease > SUFFICIENT_DECREASE * predicted:
                eased = damping / 10 if decrease > predicted / 2 else damping
                return replace(trial, preconditioner=None, damping=max(eased, MIN_DAMPING))
        damping = max(10 * damping, NEXT_DAMPING)
    return None
