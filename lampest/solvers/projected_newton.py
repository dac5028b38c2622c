"""Projected trust-region Newton method with potentials eliminated.

It is the solver of the reduced formulation.

An iteration: active set, direction by Steihaug and Toint's conjugate gradients with the exact ∇²φ,
projection on the bounds, acceptance, radius. The unknowns are relative changes s of the
conductances, g ← g·(1 − s), in which readings are closest to quadratic. Absolute losses are
smoothed less and less.
Source: Lin & Moré, SIAM J. Optim. 9, 1999; Chan, Golub & Mulet, SIAM J. Sci. Comput. 20, 1999
(smoothing).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, log

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.panel.trust_region import (
    SUFFICIENT_DECREASE,
    Linear,
    SubproblemStep,
    restricted,
    steihaug,
)
from lampest.solvers.bounds import MILLIONTH, MIN_DECREASE_SHARE, moved_by
from lampest.solvers.certificate import Certificate, Definiteness, certificate
from lampest.solvers.convex import by_convex_program
from lampest.solvers.hessian import Hessian
from lampest.solvers.interior_point import central_path, crowds_bounds, has_central_path
from lampest.solvers.preconditioners import Preconditioner, gauss_newton_factor, preconditioner
from lampest.solvers.smoothing import Smoothing
from lampest.solvers.solution import Outcome, Solver, Status


@dataclass(frozen=True)
class Steps:
    """Parameters of the steps.

    Attributes
    ----------
    radius_factor : float
        Next trust radius as a share of the length of a rejected step.
    max_step : float
        Largest change of log r of a cell in one step. Beyond it the quadratic model of a cell is
        wrong.
    max_tries : int
        Maximum number of solves of one direction, each of which may stop further cells at bounds;
        of tries of one step, whose radius is then 4⁻¹⁵, within rounding; and of further steps at a
        point that is stationary but not settled.
    gauss_newton : int
        Number of steps with the Gauss–Newton matrix before a direction of negative curvature is
        followed.
    max_products : tuple of int
        Maximum number of products in one solve, (sparse, dense). A new factor is cheaper on small
        problems.
    max_reuse_products : tuple of int
        Products of one step, (sparse, dense), beyond which the preconditioner is made anew.
    max_reuse_distance : float
        Change of log r beyond which the preconditioner is made anew. Without it small panels take a
        third more products.
    refactor_distance : float
        Change of log r up to which a factor of ∇²φ still serves as certificate; second derivatives
        change by about the same share. If the next step is expected to be shorter than its square,
        ∇²φ is factored before it. Without this a frame with a wrong model takes 248 iterations in
        place of 146 (test_random_problems).
    min_smoothed_cost : float
        Cost, relative to the cost's scale, below which the smoothing need not become finer.
    min_damping, next_damping, max_damping : float
        μ of Levenberg's step: first value, least value of a second try, and largest value.
    window : int
        Iterations after which a solve counts as stalled; well-posed frames end within 15
        iterations.
    min_decrease : float
        Relative decrease of the cost over the window. A joint pair on a plateau falls by more and
        still ends verified (test_random_problems).
    min_reduction : float
        Share of the projected gradient at the window's begin below which the solve still converges.
    """

    radius_factor: float = 0.25
    max_step: float = log(4.0)
    max_tries: int = 15
    gauss_newton: int = 3
    max_products: tuple[int, int] = (400, 40)
    max_reuse_products: tuple[int, int] = (30, 5)
    max_reuse_distance: float = 0.7
    refactor_distance: float = 0.01
    min_smoothed_cost: float = 1e-4
    min_damping: float = 1e-15
    next_damping: float = 1e-4
    max_damping: float = 1e3
    window: int = 20
    min_decrease: float = 1e-8
    min_reduction: float = 0.1


STEPS = Steps()


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
    """

    preconditioner: Preconditioner | None = None
    from_afar: bool = False

    @property
    def name(self) -> str:
        """The solver in words."""
        return "Newton"

    def continued(self, carried: object) -> "ProjectedNewton":
        """Return the solver that begins with the preconditioner of the frame before."""
        return replace(
            self, preconditioner=carried if isinstance(carried, Preconditioner) else None
        )

    def cold(self) -> "ProjectedNewton":
        """Return the solver that follows the central path of the barrier from its start."""
        return replace(self, preconditioner=None, from_afar=True)

    def prepare(self) -> None:
        """Compile the cost, so that the first solve is not charged for it."""
        _ = self.cost.functions.hessian.pattern

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`.

        A failed solve does not raise; the outcome's status states the failure.
        """
        start = by_convex_program(start)
        iteration = 0
        if (self.from_afar and has_central_path(start)) or crowds_bounds(start):
            start, iteration = central_path(start, self.settings.max_iterations)
        iterate = Iterate.of(start, Smoothing.start(start), self.preconditioner)
        history = list[tuple[float, float]]()
        unsettled = 0
        tolerance = self.settings.tolerance
        while iteration < self.settings.max_iterations:
            history.append((iterate.objective, iterate.residual))
            if data.overdue or stalled(history):
                return iterate.outcome(Status.TIME if data.overdue else Status.STALLED, iteration)
            # Absolute losses: narrow the smoothing once its error exceeds what is left of the
            # gradient.
            stationary = iterate.residual <= tolerance
            sharp = iterate.sharp(tolerance)
            reached = stationary or iterate.residual <= iterate.gap / 2
            trial = None
            # At an optimum of the smoothed cost: end where the certificate holds.
            if reached and sharp:
                iterate = iterate.certified()
                if iterate.settled or unsettled == STEPS.max_tries:
                    return iterate.outcome(Status.OPTIMUM, iteration)
                unsettled += 1
            if sharp or not reached:
                if stationary:
                    iterate = iterate.certified()
                    trial = iterate.below_saddle
                if trial is None:
                    # Near convergence the certificate's factor preconditions the step as well.
                    iterate = iterate.certified() if iterate.converges else iterate
                    trial = descent_step(iterate)
                if trial is None:
                    iterate = iterate.certified()
                    trial = iterate.below_saddle
            # Without a step the solve ends unless absolute losses can still be smoothed less.
            if trial is None and sharp:
                return iterate.outcome(
                    Status.OPTIMUM if stationary else Status.BREAKDOWN, iteration
                )
            if trial is None:
                trial = iterate.sharpened()
                history = []
            iterate = trial
            iteration = iteration + 1
        return iterate.outcome(Status.ITERATIONS, iteration)


def stalled(history: Sequence[tuple[float, float]]) -> bool:
    """Return whether cost and projected gradient have stalled over a full window.

    Neither of them then fell by the required amount.

    A stalled solve is one whose cost has stopped falling although its gradient has not vanished:
    the data and penalties leave a valley whose floor is flat, or a loss has corners that second
    derivatives do not show.
    Source: Nocedal & Wright, Numerical Optimization, 2006, section 3.1 (stopping by the decrease of
    the cost).

    Parameters
    ----------
    history : sequence of (cost, projected gradient)
        One pair for each iteration with the same smoothing.
    """
    if len(history) <= STEPS.window:
        return False
    first, steep = history[-STEPS.window - 1]
    last, residual = history[-1]
    return first - last < STEPS.min_decrease * abs(last) and residual > STEPS.min_reduction * steep


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point of the iteration with its derivatives.

    Attributes
    ----------
    hessian : Hessian
        Derivatives of the smoothed cost.
    objective : float
        The smoothed cost φ.
    preconditioner : Preconditioner or None
        Preconditioner M of an earlier point.
    gauss_newton : int
        Number of Gauss–Newton steps that are left before a direction of negative curvature is
        followed.
    convex : bool
        Whether no direction up to this point had negative curvature.
    damping : float
        μ of the next Levenberg step.
    expected : float
        Length of the next step of log r, extrapolated from the decrease of the residual.
    nearby : Certificate or None
        Certificate of an earlier point.
    certificate : Certificate or None
        Certificate of this point, once `certified` has computed it.
    """

    hessian: Hessian
    objective: float
    preconditioner: Preconditioner | None = None
    gauss_newton: int = STEPS.gauss_newton
    convex: bool = True
    damping: float = STEPS.min_damping
    expected: float = inf
    nearby: Certificate | None = None
    certificate: Certificate | None = None

    @classmethod
    def of(
        cls,
        at: Evaluation,
        smoothing: Smoothing,
        preconditioner: Preconditioner | None = None,
        *,
        convex: bool = True,
    ) -> "Iterate":
        """Return the first iterate of a solve, or of another smoothing."""
        return cls(Hessian(at, smoothing), smoothing.objective(at), preconditioner, convex=convex)

    @property
    def at(self) -> Evaluation:
        """The cost at this point."""
        return self.hessian.at

    @cached_property
    def residual(self) -> float:
        """Largest entry of the projected gradient, relative to the cost's scale."""
        return float(self.hessian.residual)

    @cached_property
    def gap(self) -> float:
        """Duality gap Σ w·(|x| − z·x) of the smoothed absolute losses.

        It is relative to the cost's scale.
        """
        if not len(self.at.nonsmooth):
            return 0.0
        return (
            self.at.dual_gap(self.hessian.smoothing.slope(self.at.nonsmooth)) / self.at.cost_scale
        )

    def sharp(self, tolerance: float) -> bool:
        """Return whether the duality gap of the smoothing is at most `tolerance` of the cost."""
        # The reference is the cost itself, but at least min_smoothed_cost and at most one cost
        # scale.
        return self.gap <= tolerance * min(
            1.0, max(self.at.objective / self.at.cost_scale, STEPS.min_smoothed_cost)
        )

    def sharpened(self) -> "Iterate":
        """Return the same point with a tenth of the smoothing width."""
        smoothing = self.hessian.smoothing
        return Iterate.of(
            self.at, replace(smoothing, width=smoothing.width / 10), convex=self.convex
        )

    def certified(self) -> "Iterate":
        """Return this point with its certificate.

        The certificate reuses a factor while the Hessian has hardly changed.
        """
        if self.certificate is not None:
            return self
        previous = self.nearby
        hessian = self.hessian
        if previous and previous.factor and previous.definiteness is Definiteness.POSITIVE:
            near = previous.factor.distance(self.at.cell_resistance) <= STEPS.refactor_distance**2
            if near and np.array_equal(np.flatnonzero(hessian.free), previous.factor.cells):
                return replace(self, certificate=previous.after(hessian))
        return replace(self, certificate=certificate(hessian, self.preconditioner))

    @property
    def converges(self) -> bool:
        """Whether the next step is expected to be short enough for a certificate.

        It is if a certificate of this point holds after it.
        """
        return self.expected <= STEPS.refactor_distance**2 and not len(self.at.nonsmooth)

    @property
    def known(self) -> Certificate | None:
        """The newest certificate: of this point if it is computed, otherwise of an earlier one."""
        return self.certificate or self.nearby

    @property
    def settled(self) -> bool:
        """Whether this is a certified strict minimum, or a plateau.

        A plateau is without any gradient or direction of descent.
        """
        verdict = self.certificate
        return verdict is not None and (
            verdict.settled or (not self.residual and verdict.lower is None)
        )

    @property
    def below_saddle(self) -> "Iterate | None":
        """The certificate's point of lower cost next to a saddle.

        None without a certificate or such a point.
        """
        lower = None if self.certificate is None else self.certificate.lower
        return (
            None
            if lower is None
            else Iterate.of(lower, self.hessian.smoothing.moved(self.at, lower), convex=False)
        )

    @property
    def newest(self) -> Preconditioner | None:
        """The factor of ∇²φ of the newest certificate.

        Without one, it is the preconditioner of an earlier point.
        """
        return (
            self.preconditioner
            if self.known is None or self.known.factor is None
            else self.known.factor
        )

    def outcome(self, status: Status, iterations: int) -> Outcome:
        """Return the outcome at this point.

        The certificate's Newton step is taken first if it comes from a factor, is long enough to
        improve the estimate, and short enough for the certificate to remain valid.
        """
        final = self.certificate
        cells = self.at.cell_resistance
        dual = self.hessian.smoothing.slope(self.at.nonsmooth)
        exact = final is not None and final.factor is not None and final.settled and not len(dual)
        if (
            final is not None
            and exact
            and MILLIONTH / 1000 < np.abs(final.step).max() <= STEPS.refactor_distance
        ):
            cells = np.exp(self.at.position + final.step.reshape(cells.shape))
        return Outcome(cells, dual, status, iterations, final, self.newest, self.convex, self.at)

    def at_step(self, step: Array) -> "Iterate | None":
        """Return the point after a step of u (flat), clipped to the bounds.

        None if its network cannot be solved.
        """
        if (at := moved_by(self.at, step)) is None:
            return None
        return Iterate.of(
            at, self.hessian.smoothing.moved(self.at, at), self.preconditioner, convex=self.convex
        )


def descent_step(point: Iterate) -> Iterate | None:
    """Return the next point; None if no step lowers the cost.

    While directions of negative curvature persist, the trust-region step and Levenberg's step are
    both computed, and the point of lower cost is returned.
    """
    trial = trust_region_step(point)
    if trial is not None and trial.gauss_newton:
        return trial
    trials = [candidate for candidate in (trial, levenberg_step(point)) if candidate is not None]
    return min(trials, key=lambda candidate: candidate.objective, default=None)


def trust_region_step(point: Iterate) -> Iterate | None:
    """Return the next point by a trust-region step; None if no radius gives an accepted step.

    Every iteration begins with an infinite radius: one-sided readings curve the cost on one side
    only, so that the radius of one iteration need not suit the next.
    """
    hessian = point.hessian
    cached = point.newest
    # Preconditioner: the cached one unless the point has moved too far from it.
    if cached is None or cached.distance(point.at.cell_resistance) > STEPS.max_reuse_distance:
        cached = preconditioner(hessian, hessian.free)
    # Unknowns are relative changes s of conductances, δu = −log(1 − s) = s + s²/2 + …: their
    # Hessian is ∇²φ + diag(∇φ). Where lines touch, steps are in log r itself.
    radius = inf
    patience = point.gauss_newton
    convex = point.convex
    curved = np.zeros_like(hessian.gradient) if shares_conductance(point.at) else hessian.gradient
    exact: Linear = lambda step: hessian.product(step) + curved * step  # noqa: E731
    product = exact
    for _ in range(STEPS.max_tries):
        direction = newton_direction(point, cached, product, radius)
        convex = convex and not direction.negative
        # Negative curvature: up to `gauss_newton` times, a Levenberg step or the Gauss–Newton
        # matrix replaces ∇²φ.
        if direction.negative and patience and product is exact:
            damped = None if len(point.at.nonsmooth) else levenberg_step(point)
            if damped is not None:
                return replace(damped, gauss_newton=patience - 1, convex=False)
            product = hessian.gauss_newton_product
            patience = patience - 1
            cached = gauss_newton_factor(hessian, hessian.free) or cached
            direction = newton_direction(point, cached, product, radius)
        trial = point.at_step(direction.step)
        if (
            trial is not None
            and decrease_ratio(point, trial, direction.decrease) >= SUFFICIENT_DECREASE
        ):
            # Accepted: keep the preconditioner unless conjugate gradients took too many products.
            worn = direction.products > STEPS.max_reuse_products[hessian.dense]
            reused, nearby = (None, None) if worn else (cached, point.known)
            patience = (
                patience if direction.negative or product is not exact else STEPS.gauss_newton
            )
            # Linear convergence: the next step is shorter by the ratio of the residuals.
            moved = float(np.abs(trial.at.position - point.at.position).max())
            small = hessian.dense and not len(point.at.nonsmooth)
            expected = moved * trial.residual / (point.residual or 1.0) if small else inf
            return Iterate(
                trial.hessian,
                trial.objective,
                reused,
                patience,
                convex,
                point.damping,
                expected,
                nearby,
            )
        # Rejected: try again within a smaller radius.
        radius = STEPS.radius_factor * direction.length
        if not radius > 0:
            break
    return None


def decrease_ratio(point: Iterate, trial: Iterate, predicted: float) -> float:
    """Return actual over predicted decrease of the cost.

    Within rounding, it is 1 if the gradient halved, otherwise −1.
    """
    decrease = point.objective - trial.objective
    rounding = MIN_DECREASE_SHARE * abs(point.objective)
    if predicted > rounding:
        return decrease / predicted if np.isfinite(decrease) else -1.0
    return 1.0 if abs(decrease) <= rounding and trial.residual <= point.residual / 2 else -1.0


def shares_conductance(at: Evaluation) -> bool:
    """Return whether lines touch and no penalty determines how parallel cells share conductance.

    Steps in log r then keep the shares near those of the start.
    """
    wiring = at.data.wiring
    return (
        wiring is not None
        and bool(wiring.joined)
        and all(term.reads_measurement for term in at.cost.terms)
    )


def newton_direction(
    point: Iterate, precondition: Preconditioner, product: Linear, radius: float
) -> SubproblemStep:
    """Return the minimiser δu of the quadratic model gᵀs + ½ sᵀHs.

    It is within the trust radius and the bounds. Conjugate gradients solve the model over the
    moving cells. Cells that the solution takes beyond a bound are fixed at it, and the model is
    solved again over the others.

    Parameters
    ----------
    point : Iterate
    precondition : Preconditioner
    product : Linear
        H·p over all cells.
    radius : float
        Trust radius in the norm of the preconditioner.
    """
    at = point.at
    gradient = point.hessian.gradient
    free = point.hessian.free
    low, high = (bound.ravel() - at.position.ravel() for bound in at.data.log_bounds)
    low = np.maximum(low, -STEPS.max_step)
    high = np.minimum(high, STEPS.max_step)
    if not (logarithmic := shares_conductance(at)):
        # 1 − exp(−δu)
        low = -np.expm1(-low)
        high = -np.expm1(-high)
    # Forcing term: superlinear convergence (Nocedal & Wright 2006, section 7.1).
    accuracy = min(0.1, point.residual**0.5)
    limit = STEPS.max_products[point.hessian.dense]
    moving = free
    step = np.zeros(free.size)
    slope = gradient
    products = 0
    negative = False
    for _ in range(STEPS.max_tries):
        chosen = np.flatnonzero(moving)
        part = restricted(product, chosen, free.size)
        inverse = precondition.over(moving, at.cell_resistance)
        solved = steihaug(part, inverse, slope[chosen], accuracy, radius, most_products=limit)
        products = max(products, solved.products)
        negative = negative or solved.negative
        step[chosen] = solved.step
        beyond = moving & ((step < low) | (step > high))
        if not beyond.any():
            break
        step = np.clip(step, low, high)
        moving = moving & ~beyond
        if not moving.any():
            break
        # Gradient of the model over the moving cells, with the others at their bounds: g + H
        # s_fixed
        slope = gradient + product(np.where(moving, 0.0, step))
    decrease = (
        solved.decrease if moving is free else -float(gradient @ step + 0.5 * step @ product(step))
    )
    # δu = −log(1 − s)
    return SubproblemStep(
        step if logarithmic else -np.log1p(-step), solved.length, decrease, negative, products
    )


def levenberg_step(point: Iterate) -> Iterate | None:
    """Return the point after Levenberg's step over the free cells.

    The step is δu = −(JᵀWJ + PᵀKP + μ·diag)⁻¹ ∇φ. The damping μ of the next step is a tenth if the
    cost fell by at least half of the predicted decrease (Moré 1978). Returns None on large
    problems, or if no μ lowers the cost.
    """
    hessian = point.hessian
    free = point.hessian.free
    if not hessian.dense or not free.any():
        return None
    slope = hessian.gradient[free]
    damping = point.damping
    while damping <= STEPS.max_damping:
        factor = gauss_newton_factor(hessian, free, damping)
        if factor is not None:
            step = np.zeros(free.size)
            step[free] = np.clip(factor.solve(-slope), -STEPS.max_step, STEPS.max_step)
            # Predicted decrease of the damped model: −½ ∇φᵀδu
            trial = point.at_step(step)
            predicted = -0.5 * float(step[free] @ slope)
            if (
                trial is not None
                and (decrease := point.objective - trial.objective)
                > SUFFICIENT_DECREASE * predicted
            ):
                eased = damping / 10 if decrease > predicted / 2 else damping
                return replace(trial, preconditioner=None, damping=max(eased, STEPS.min_damping))
        damping = max(10 * damping, STEPS.next_damping)
    return None
