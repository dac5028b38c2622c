"""Projected L-BFGS for many panels over a leading axis, with inverse Hessians of earlier frames.

If frames differ little, M⁻¹ ∇φ is nearly the Newton step, and every further step costs one gradient
and one product with M⁻¹. Panels that have converged leave the batch. A panel that finds no step of
lower cost, or whose ∇²φ is not positive definite, is returned unsolved, and the solver for single
panels continues with it.
Source: Nocedal & Wright, Numerical Optimization, 2006, algorithm 7.4.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import NO_DUAL, Data, Evaluation
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.solvers.bounds import MILLIONTH
from lampest.solvers.certificate import clear_of_rounding
from lampest.solvers.direction import conductance_change, log_resistance_change
from lampest.solvers.hessian import Hessian
from lampest.solvers.preconditioners import Cholesky
from lampest.solvers.progress import decreases_enough
from lampest.solvers.smoothing import Smoothing
from lampest.solvers.solution import Settings
from lampest.solvers.steps import STEPS

Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

MAX_STEPS = 40  # of a panel in a batch; the solver for single panels continues from there
# Of log r: ∇²φ changes by about this share; beyond, its definiteness is tested again.
CERTIFIED_DISTANCE = 0.1
# Of log r; within CERTIFIED_DISTANCE, M⁻¹ ∇φ is within a tenth of Newton’s step.
LAST_STEP = 0.01 * MILLIONTH


NAME = "L-BFGS"  # of the solver, in tables


@dataclass(frozen=True, eq=False)
class InverseHessians:
    """Inverse Hessians of panels, reused from frame to frame.

    Attributes
    ----------
    inverse : array, shape (panels, cells, cells)
        M⁻¹.
    position : array, shape (panels, cells)
        Point at which M was made, log r; NaN before the first.
    free : array of bool, shape (panels, cells)
        Cells over which M is ∇²φ; M is diagonal for the others.
    positive : array of bool, shape (panels,)
        Whether that ∇²φ was positive definite.
    worn : array of bool, shape (panels,)
        Whether a step failed since M was made.
    """

    inverse: Array
    position: Array
    free: Mask
    positive: Mask
    worn: Mask

    @classmethod
    def nothing(cls, panels: int, cells: int) -> "InverseHessians":
        """Return the state before the first frame, without any inverse."""
        blank = np.zeros((panels, cells), dtype=bool)
        none = np.zeros(panels, dtype=bool)
        return cls(
            np.zeros((panels, cells, cells)), np.full((panels, cells), np.nan), blank, none, ~none
        )

    def copy(self, panel: int, target: int) -> None:
        """Let a target panel begin with the inverse Hessian of a panel, in place."""
        for values in (self.inverse, self.position, self.free, self.positive, self.worn):
            values[target] = values[panel]

    def distance(self, panels: Numbers, position: Array) -> Array:
        """Return the largest |δ log r| since M was made, for the chosen panels.

        The distance is infinite where there is no M.
        """
        moved = np.abs(position - self.position[panels]).max(axis=1)
        return np.where(np.isnan(moved), np.inf, moved)

    def shows_minimum(self, panels: Numbers, points: Hessian) -> Mask:
        """Return whether M, made near `points`, had a positive definite ∇²φ over their free cells.

        The point of M is near within CERTIFIED_DISTANCE of log r.
        """
        near = self.distance(panels, points.position) <= CERTIFIED_DISTANCE
        return near & self.positive[panels] & ~(points.free & ~self.free[panels]).any(axis=1)

    def newton(self, panels: Numbers, gradient: Array) -> Array:
        """Return M⁻¹ g, (chosen panels, cells)."""
        step = np.empty_like(gradient)
        for row, panel in enumerate(panels.tolist()):  # without a copy of their matrices
            np.matmul(self.inverse[panel], gradient[row], out=step[row])
        return step

    def renew(self, panels: Numbers, points: Hessian) -> None:
        """Make M of the chosen panels anew at their points, in place.

        One inverse of a 10 × 10 panel takes 80 kB. M is the Hessian in relative changes s of
        conductances, ∇²φ + diag(∇φ). Frames that begin at the same estimate share M, because their
        Hessians differ only by the part of their residuals.
        """
        if len(panels) > 1 and not np.ptp(points.position, axis=0).any():
            self.renew(panels[:1], points.some(np.array([0])))
            for values in (self.inverse, self.position, self.free, self.positive, self.worn):
                values[panels[1:]] = values[panels[0]]
            return
        matrices = points.matrix.copy()
        np.einsum("...ii->...i", matrices)[...] += points.gradient
        # M⁻¹ over the free cells; 1/diagonal elsewhere, and everywhere if M is not positive
        # definite.
        for number, panel in enumerate(panels):
            matrix = matrices[number]
            free = np.flatnonzero(points.free[number])
            scale = np.abs(np.diag(matrix))
            inverse = np.diag(1 / np.where(scale > 0, scale, 1.0))
            factor = None
            if len(free):
                factor = Cholesky.of(points.position[number], free, matrix[np.ix_(free, free)])
            positive = factor is not None and clear_of_rounding(factor.triangle, factor.norm)
            if factor is not None and positive:
                inverse[np.ix_(free, free)] = factor.inverse()
            self.inverse[panel] = inverse
            self.free[panel] = points.free[number]
            self.positive[panel] = positive or not len(free)
        self.position[panels] = points.position
        self.worn[panels] = False


@dataclass(frozen=True, eq=False)
class BatchOutcome:
    """Outcome of a batch.

    Attributes
    ----------
    points : Hessian
        Derivatives at the last points.
    solved : array of bool, shape (panels,)
        Whether a strict minimum is verified.
    iterations : array of int, shape (panels,)
    """

    points: Hessian
    solved: Mask
    iterations: NDArray[np.int64]


def serves(cost: Cost, data: Data) -> bool:
    """Return whether a batch can minimise a cost.

    All losses must be smooth and convex, the readings two-point readings without wiring, and no
    second derivative may couple cells with readings, or readings with each other.
    """
    if (
        any(term.loss.enters == "dual" for term in cost.terms)
        or not cost.convex_losses
        or cost.frames != 1
        or data.wiring is not None
    ):
        return False
    entries = cost.functions.entries
    return (
        isinstance(data.readout, TwoPointReadout)
        and entries.at_model is not None
        and not entries.crossed
    )


def solve(
    start: Evaluation, inverses: InverseHessians, numbers: Numbers, settings: Settings
) -> BatchOutcome:
    """Minimise the costs of many panels of one shape.

    Parameters
    ----------
    start : Evaluation
        Evaluation with a leading axis of panels, within their bounds.
    inverses : InverseHessians
        Inverse Hessians of earlier frames; renewed in place.
    numbers : array, shape (panels,)
        Numbers of these panels in `inverses`.
    settings : Settings
    """
    begun = Hessian(start, Smoothing(1.0, NO_DUAL))
    points = begun
    ends = begun.position.copy()
    (count,) = start.data.panels
    solved = np.zeros(count, dtype=bool)
    iterations = np.zeros(count, dtype=np.int64)
    panels = np.arange(count)
    secants = Secants()
    for _ in range(min(MAX_STEPS, settings.max_iterations)):
        if not len(panels):
            break
        # Panels with a small gradient: renew M where it does not show a minimum, then accept short
        # Newton steps.
        near = points.residual <= settings.tolerance
        if near.any():
            step, settled, stuck = _last_steps(points, inverses, numbers[panels], near)
            solved[panels[settled]] = True
            # Panels that are accepted, or are no minimum, leave the batch; the accepted ones after
            # their last step.
            staying = ~(settled | stuck)
            if not staying.all():
                ends[panels] = points.position - np.where(settled[:, None], step, 0.0)
                points = points.some(np.flatnonzero(staying))
                panels = panels[staying]
                secants = secants.some(staying)
        if not len(panels):
            break
        # One L-BFGS step of all others. Panels without a step of lower cost leave, too.
        points, secants, moved = _advanced(points, secants, inverses, numbers[panels])
        iterations[panels] += 1
        if not moved.all():
            ends[panels] = points.position
            points = points.some(np.flatnonzero(moved))
            panels = panels[moved]
            secants = secants.some(moved)
    ends[panels] = points.position
    return BatchOutcome(begun.elsewhere(ends), solved, iterations)


def _last_steps(
    points: Hessian, inverses: InverseHessians, panels: Numbers, near: Mask
) -> tuple[Array, Mask, Mask]:
    """Return the Newton steps of panels, and which of the `near` ones are settled or stuck.

    Panels whose gradient is small are near an optimum. A panel is settled if M shows a minimum and
    the step is short, and stuck if ∇²φ is not positive definite. M is renewed, in place, where it
    does not show a minimum.
    """
    doubtful = near & ~inverses.shows_minimum(panels, points)
    if doubtful.any():
        inverses.renew(panels[doubtful], points.some(np.flatnonzero(doubtful)))
    gradient = np.where(points.free, points.gradient, 0.0)
    step = np.where(points.free, inverses.newton(panels, gradient), 0.0)
    positive = inverses.positive[panels]
    settled = near & positive & (np.abs(step).max(axis=1) <= LAST_STEP)
    return step, settled, near & ~positive


@dataclass(frozen=True, eq=False)
class Secants:
    """Newest steps and changes of the gradient, which correct M.

    Attributes
    ----------
    pairs : tuple of (s, y, 1/sᵀy)
        Steps s and changes y of the gradient, (panels, cells) each, and 1/sᵀy (panels,), the newest
        last. 1/sᵀy is 0 where a pair does not count.
    most : int
        Maximum number of pairs.
    """

    pairs: tuple[tuple[Array, Array, Array], ...] = ()
    most: int = 4

    def some(self, chosen: Mask) -> "Secants":
        """Return the secants of some panels."""
        return Secants(
            tuple((step[chosen], change[chosen], size[chosen]) for step, change, size in self.pairs)
        )

    def without(self, forgotten: Mask) -> "Secants":
        """Return the secants with those of the `forgotten` panels excluded."""
        return Secants(tuple((s, y, np.where(forgotten, 0.0, size)) for s, y, size in self.pairs))

    def after(self, before: Hessian, points: Hessian) -> "Secants":
        """Return the secants with one more step.

        Cells that are not free at both ends are excluded.
        """
        free = before.free & points.free
        step = np.where(free, points.position - before.position, 0.0)
        change = np.where(free, points.gradient - before.gradient, 0.0)
        along = (step * change).sum(axis=1)
        # Pairs without positive curvature sᵀy are excluded.
        size = np.where(along > 0, 1 / np.where(along > 0, along, 1.0), 0.0)
        return Secants((*self.pairs, (step, change, size))[-self.most :])

    def direction(self, points: Hessian, inverses: InverseHessians, panels: Numbers) -> Array:
        """Return −H ∇φ over the free cells, H = M⁻¹ corrected by the secants in two loops."""
        slope = np.where(points.free, points.gradient, 0.0)
        shares = list[Array]()
        for step, change, size in reversed(self.pairs):
            # α = sᵀq/sᵀy, q ← q − α y
            shares.append(size * (step * slope).sum(axis=1))
            slope = slope - shares[-1][:, None] * change
        direction = inverses.newton(panels, slope)
        for (step, change, size), share in zip(self.pairs, reversed(shares), strict=True):
            # β = yᵀd/sᵀy, d ← d + (α − β) s
            direction += (share - size * (change * direction).sum(axis=1))[:, None] * step
        return np.where(points.free, -direction, 0.0)


def _advanced(
    points: Hessian, secants: Secants, inverses: InverseHessians, panels: Numbers
) -> tuple[Hessian, Secants, Mask]:
    """Return the points after one step each, their secants, and whether the step lowered the cost.

    Unknowns of a step are relative changes of conductances, g ← g·(1 − s), in which readings are
    closest to quadratic.
    """
    # Renew M after a failed step, and where the point has moved far from it.
    old = inverses.worn[panels] | (
        inverses.distance(panels, points.position) > STEPS.max_reuse_distance
    )
    if old.any():
        inverses.renew(panels[old], points.some(np.flatnonzero(old)))
        secants = secants.without(old)
    step = secants.direction(points, inverses, panels)
    length = np.ones((len(panels), 1))
    low = points.position - STEPS.max_step
    high = points.position + STEPS.max_step
    most = conductance_change(np.asarray(STEPS.max_step))
    trial = points
    moved = np.zeros(len(panels), dtype=bool)
    # Backtracking line search: u − log(1 − t·s), t shortened for the panels that have not found a
    # step, at last to 0.
    for attempt in range(STEPS.max_tries + 1):
        target = points.position + log_resistance_change(np.minimum(length * step, most))
        trial = points.elsewhere(np.where(length > 0, np.clip(target, low, high), points.position))
        gain = points.at.objectives - trial.at.objectives
        expected = np.abs((points.gradient * (trial.position - points.position)).sum(axis=1))
        moved = decreases_enough(
            gain, expected, points.at.objectives, points.residual, trial.residual
        )
        stays = moved | (length[:, 0] == 0)
        if stays.all():
            break
        inverses.worn[panels[~stays]] = True
        length[~stays] *= STEPS.radius_factor if attempt + 1 < STEPS.max_tries else 0.0
    return trial, secants.after(points, trial), moved & (length[:, 0] > 0)
