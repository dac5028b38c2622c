"""A point of the projected Newton method, with its derivatives and its certificate."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array
from lampest.solvers.bounds import MILLIONTH, moved_by
from lampest.solvers.certificate import Certificate, Definiteness, certificate
from lampest.solvers.hessian import MAX_SHARE, Hessian, Smoothing
from lampest.solvers.preconditioners import Preconditioner
from lampest.solvers.solution import Outcome, Status

# Steps with the Gauss–Newton matrix before a direction of negative curvature is followed
GAUSS_NEWTON_STEPS = 3
# Change of log r up to which a factor of ∇²φ still serves as certificate; second derivatives change
# by about the same share. If the next step is expected to be shorter than its square, ∇²φ is
# factored before it. Without this a frame with a wrong model takes 248 iterations in place of 146
# (test_random_problems).
REFACTOR_DISTANCE = 0.01
# Cost, relative to the cost's scale, below which the smoothing need not become finer
MIN_SMOOTHED_COST = 1e-4
MIN_DAMPING = 1e-15  # first μ of Levenberg's step
MIN_GAP_SHARE = 0.5  # of the tolerance: gap of the finest smoothing
MIN_LAST_STEP = MILLIONTH / 1000  # of log r: a shorter step improves no digit of an estimate


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
    gauss_newton: int = GAUSS_NEWTON_STEPS
    convex: bool = True
    damping: float = MIN_DAMPING
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
    def slope(self) -> Array:
        """Slopes ψ'(x) of the smoothed absolute losses, which are duals of a smoothed optimum."""
        return self.hessian.smoothing.slope(self.at.nonsmooth)

    def sharp(self, tolerance: float, dual: Array | None = None) -> bool:
        """Return whether the duality gap Σ w·(|x| − z·x) is at most `tolerance` of the cost.

        The duals z are ψ'(x) by default.
        """
        if not len(self.at.nonsmooth):
            return True
        gap = self.at.dual_gap(self.slope if dual is None else dual) / self.at.cost_scale
        return gap <= tolerance * self._smoothed_cost

    def dual_of_optimum(self, tolerance: float) -> Array | None:
        """Return duals that prove an optimum within the tolerance; None where there are none.

        Their gap and the projected gradient with them are below the tolerance. The unknown duals
        prove it some steps before ψ'(x), whose digits are those of residuals at 0.
        """
        if self.residual <= tolerance and self.sharp(tolerance):
            return self.slope
        dual = self.hessian.smoothing.dual
        proved = len(dual) and self.sharp(tolerance, dual) and self.dual_residual <= tolerance
        return dual if proved else None

    @property
    def _smoothed_cost(self) -> float:
        """Cost over its scale, at least min_smoothed_cost and at most 1."""
        return min(1.0, max(self.at.objective / self.at.cost_scale, MIN_SMOOTHED_COST))

    def centred(self) -> "Iterate":
        """Return the same point with the duals z = ψ'(x) of the absolute losses."""
        smoothing = self.hessian.smoothing.centred(self.at)
        return replace(self, hessian=replace(self.hessian, smoothing=smoothing))

    def sharpened(self, tolerance: float) -> "Iterate":
        """Return the same point with the smoothing of the next step.

        μ is a share of the mean complementarity: MAX_SHARE, or the root of the gap over the cost if
        that is less and the gradient with the duals is not behind the gap. The smoothing stays once
        its gap is half of `tolerance` of the cost: slopes of narrower corners have no digits where
        heavy weights hold residuals at 0. On large panels, directions of negative curvature
        lead to points whose gradient is large again. The smoothing there is wide again, with a gap
        of MAX_SHARE of a gradient above a millionth: between narrow corners steps would be short.
        """
        smoothing = self.hessian.smoothing
        if not len(smoothing.dual):
            return self
        scale = self.at.cost_scale
        cost = self._smoothed_cost * scale
        complementarity = smoothing.complementarity(self.at)
        level = max(smoothing.level(self.at), np.finfo(float).tiny)
        gap = complementarity * level
        share = MAX_SHARE
        if gap < MAX_SHARE**2 * cost and self.dual_residual <= gap / scale:
            share = np.sqrt(gap / cost)
        least = MIN_GAP_SHARE * tolerance * cost
        factor = min(1.0, max(share * complementarity, least / level))
        if not (self.hessian.dense or self.convex) and self.dual_residual > MILLIONTH:
            factor = max(factor, MAX_SHARE * self.dual_residual * scale / level)
        if factor == 1.0:
            return self
        smoothing = replace(smoothing, width=factor * smoothing.width)
        return Iterate.of(self.at, smoothing, convex=self.convex)

    @cached_property
    def dual_residual(self) -> float:
        """Largest entry of the projected gradient with the duals of the absolute losses."""
        gradient = self.at.log_gradient(self.hessian.smoothing.dual)
        return float(self.at.projected_gradients(gradient))

    @property
    def error(self) -> float:
        """The larger of the gradient and the gap with the duals, relative to the cost's scale."""
        gap = self.at.dual_gap(self.hessian.smoothing.dual)
        return max(self.dual_residual, gap / self.at.cost_scale)

    def certified(self) -> "Iterate":
        """Return this point with its certificate.

        The certificate reuses a factor while the Hessian has hardly changed.
        """
        if self.certificate is not None:
            return self
        previous = self.nearby
        hessian = self.hessian
        if previous and previous.factor and previous.definiteness is Definiteness.POSITIVE:
            near = previous.factor.distance(hessian.cells) <= REFACTOR_DISTANCE**2
            if near and np.array_equal(np.flatnonzero(hessian.free), previous.factor.cells):
                return replace(self, certificate=previous.after(hessian))
        return replace(self, certificate=certificate(hessian, self.preconditioner))

    @property
    def converges(self) -> bool:
        """Whether a certificate of this point is expected to hold after the next step.

        The step must be short, and the cost without absolute losses.
        """
        return self.expected <= REFACTOR_DISTANCE**2 and not len(self.at.nonsmooth)

    @property
    def newest_certificate(self) -> Certificate | None:
        """The newest certificate: of this point if it is computed, otherwise of an earlier one."""
        return self.certificate or self.nearby

    @property
    def settled(self) -> bool:
        """Whether this is a certified strict minimum, or a plateau.

        A plateau has neither a gradient nor a direction of descent.
        """
        verdict = self.certificate
        return verdict is not None and (
            verdict.settled or (not self.residual and verdict.lower is None)
        )

    @property
    def below_saddle(self) -> "Iterate | None":
        """The certificate's point of lower cost next to a saddle; None without such a point."""
        lower = self.certificate and self.certificate.lower
        if not lower:
            return None
        change = lower.nonsmooth - self.at.nonsmooth
        smoothing = self.hessian.smoothing.moved(self.at, lower, change)
        return Iterate.of(lower, smoothing, convex=False)

    @property
    def newest_preconditioner(self) -> Preconditioner | None:
        """Factor of ∇²φ of the newest certificate, else the preconditioner of an earlier point."""
        verdict = self.newest_certificate
        return (verdict and verdict.factor) or self.preconditioner

    def outcome(self, status: Status, iterations: int, dual: Array | None = None) -> Outcome:
        """Return the outcome at this point, with duals that are ψ'(x) by default.

        The certificate's Newton step is taken first if it is long enough to improve the estimate,
        and short enough for the certificate to remain valid.
        """
        final = self.certificate
        cells = self.at.cell_resistance
        dual = self.slope if dual is None else dual
        if final is not None and final.settled and not len(dual):
            length = np.abs(final.step).max()
            if MIN_LAST_STEP < length <= REFACTOR_DISTANCE:
                cells = np.exp(self.at.position + final.step.reshape(cells.shape))
        return Outcome(
            cells,
            dual,
            status,
            iterations,
            certificate=final,
            carried=self.newest_preconditioner,
            convex=self.convex,
            at=self.at,
        )

    def at_step(self, step: Array) -> "Iterate | None":
        """Return the point after a step of u (flat), clipped to the bounds.

        Returns None if the network cannot be solved there.
        """
        at = moved_by(self.at, step)
        if at is None:
            return None
        smoothing = self.hessian.smoothing.moved(self.at, at, self.hessian.nonsmooth_change(step))
        return Iterate.of(at, smoothing, self.preconditioner, convex=self.convex)
