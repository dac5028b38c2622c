"""Projected L-BFGS for many panels over a leading axis, with inverse Hessians of earlier frames.

If frames differ little, M⁻¹ ∇φ is nearly the Newton step, and every further step costs one gradient
and one product with M⁻¹. Panels that have converged leave the batch. A panel that finds no step of
lower cost, or whose ∇²φ is not positive definite, is returned unsolved, and the solver for single
panels continues with it.
Source: Nocedal & Wright, Numerical Optimization, 2006, algorithm 7.4.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import NO_DUAL, Evaluation
from lampest.panel.panel import Array, Mask, Numbers
from lampest.solvers.bounds import MILLIONTH
from lampest.solvers.certificate import clear_of_rounding
from lampest.solvers.direction import (
    MAX_CHANGE,
    MAX_REUSE_DISTANCE,
    MAX_TRIES,
    RADIUS_FACTOR,
    conductance_change,
    decreases_enough,
    log_resistance_change,
)
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.preconditioners import Cholesky
from lampest.solvers.solution import Settings

MAX_STEPS = 40  # of a panel in a batch; the solver for single panels continues from there
# Change of log r by which ∇²φ changes by about as much; its definiteness is then tested again.
CERTIFIED_DISTANCE = 0.1
# Change of log r; M⁻¹ ∇φ is within a tenth of Newton’s step in CERTIFIED_DISTANCE.
LAST_STEP = 0.01 * MILLIONTH
MAX_PAIRS = 4  # newest steps that correct M
NAME = "L-BFGS"  # of the solver, in tables


@dataclass(frozen=True, eq=False)
class InverseHessian:
    """Inverse Hessian of one panel, reused from frame to frame.

    Attributes
    ----------
    inverse : array, shape (cells, cells)
        M⁻¹.
    position : array, shape (cells,)
        Point at which M was made, log r.
    free : array of bool, shape (cells,)
        Cells over which M is ∇²φ; M is diagonal for the others.
    positive : bool
        Whether that ∇²φ was positive definite.
    worn : bool
        Whether a step failed since M was made.
    """

    inverse: Array
    position: Array
    free: Mask
    positive: bool
    worn: bool = False

    @classmethod
    def of(cls, points: Hessian, row: int) -> "InverseHessian":
        """Return M⁻¹ over the free cells of a panel.

        For the other cells, and for all if M is not positive definite, 1/diagonal stands in. M is
        the Hessian in relative changes s of conductances, ∇²φ + diag(∇φ).
        """
        matrix = points.matrix[row] + np.diag(points.gradient[row])
        free = np.flatnonzero(points.free[row])
        scale = np.abs(np.diag(matrix))
        inverse = np.diag(1 / np.where(scale > 0, scale, 1.0))
        position = points.position[row].copy()
        factor = Cholesky.of(position, free, matrix) if len(free) else None
        positive = not len(free)
        if factor is not None and clear_of_rounding(factor.triangle, factor.norm):
            positive = True
            inverse[np.ix_(free, free)] = factor.inverse()
        return cls(inverse, position, points.free[row].copy(), positive)


# Before the first frame of a panel
NO_INVERSE = InverseHessian(
    np.zeros(()), np.full((), np.inf), np.zeros((), dtype=bool), positive=False, worn=True
)


@dataclass(frozen=True, eq=False)
class InverseHessians:
    """Inverse Hessians of many panels, NO_INVERSE before the first frame of a panel."""

    panels: tuple[InverseHessian, ...]

    @classmethod
    def nothing(cls, panels: int) -> "InverseHessians":
        """Return the state before the first frame, without any inverse."""
        return cls((NO_INVERSE,) * panels)

    def some(self, numbers: Numbers) -> "InverseHessians":
        """Return the inverse Hessians of the panels with these numbers."""
        return InverseHessians(tuple(self.panels[number] for number in numbers.tolist()))

    def replaced(self, numbers: Numbers, others: "InverseHessians") -> "InverseHessians":
        """Return the inverse Hessians with others for the panels with these numbers."""
        new = dict(zip(numbers.tolist(), others.panels, strict=True))
        return InverseHessians(tuple(new.get(n, panel) for n, panel in enumerate(self.panels)))

    def distance(self, position: Array) -> Array:
        """Return the largest |δ log r| of every panel since M was made, (panels,).

        The distance is infinite where there is no M.
        """
        pairs = zip(self.panels, position, strict=True)
        return np.array([np.abs(there - panel.position).max() for panel, there in pairs])

    @property
    def positive(self) -> Mask:
        """Whether ∇²φ of every panel was positive definite, (panels,); not where there is no M."""
        return np.array([panel.positive for panel in self.panels])

    def shows_minimum(self, points: Hessian) -> Mask:
        """Return whether M, made near `points`, had a positive definite ∇²φ over their free cells.

        The point of M is near within CERTIFIED_DISTANCE of log r.
        """
        near = self.distance(points.position) <= CERTIFIED_DISTANCE
        pairs = zip(self.panels, points.free, strict=True)
        covered = [not (free & ~panel.free).any() for panel, free in pairs]
        return near & self.positive & covered

    def newton(self, gradient: Array) -> Array:
        """Return M⁻¹ g, (panels, cells); 0 where there is no M."""
        pairs = zip(self.panels, gradient, strict=True)
        return np.array([np.dot(panel.inverse, slope) for panel, slope in pairs])

    def old(self, position: Array) -> Mask:
        """Return whether M failed a step, or was made far from a position, (panels,)."""
        worn = np.array([panel.worn for panel in self.panels])
        return worn | (self.distance(position) > MAX_REUSE_DISTANCE)

    def renewed(self, chosen: Mask, points: Hessian) -> "InverseHessians":
        """Return the inverse Hessians with M of the chosen panels made anew at their points.

        One inverse of a 10 × 10 panel takes 80 kB. Frames that begin at the same estimate share M,
        because their Hessians differ only by the part of their residuals.
        """
        rows = np.flatnonzero(chosen)
        alike = len(rows) > 1 and not np.ptp(points.position[rows], axis=0).any()
        there = points.some(rows[:1] if alike else rows)
        made = [InverseHessian.of(there, row) for row in range(len(there.position))]
        return self.replaced(rows, InverseHessians((*made,) * len(rows) if alike else (*made,)))


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
    inverses : InverseHessians
        Inverse Hessians for the next frames.
    """

    points: Hessian
    solved: Mask
    iterations: NDArray[np.int64]
    inverses: InverseHessians


def serves(cost: Cost) -> bool:
    """Return whether a batch can minimise a cost of two-point readings without wiring.

    All losses must be smooth and convex, and no second derivative may couple cells with readings,
    or readings with each other.
    """
    if any(term.loss.enters == "dual" for term in cost.terms) or not cost.convex_losses:
        return False
    entries = cost.functions.entries
    return entries.at_model is not None and not entries.crossed


def solve(start: Evaluation, inverses: InverseHessians, settings: Settings) -> BatchOutcome:
    """Minimise the costs of many panels of one shape.

    Parameters
    ----------
    start : Evaluation
        Evaluation with a leading axis of panels, within their bounds.
    inverses : InverseHessians
        Inverse Hessians of these panels from earlier frames.
    settings : Settings
    """
    begun = Hessian(start, Smoothing(1.0, NO_DUAL))
    points = begun
    ends = begun.position.copy()
    (count,) = start.data.panels
    solved = np.zeros(count, dtype=bool)
    iterations = np.zeros(count, dtype=np.int64)
    panels = np.arange(count)
    moved = np.ones(count, dtype=bool)
    secants = Secants()
    for _ in range(min(MAX_STEPS, settings.max_iterations)):
        # Panels without a step of lower cost leave the batch, and of those with a small gradient
        # those with a short Newton step, after it, and those that are no minimum. M is renewed
        # where it does not show a minimum.
        staying = moved
        near = points.residual <= settings.tolerance
        if near.any():
            current = inverses.some(panels)
            doubtful = near & ~current.shows_minimum(points)
            if doubtful.any():
                current = current.renewed(doubtful, points)
                inverses = inverses.replaced(panels, current)
            gradient = np.where(points.free, points.gradient, 0.0)
            step = np.where(points.free, current.newton(gradient), 0.0)
            short = np.abs(step).max(axis=1) <= LAST_STEP
            settled = moved & near & current.positive & short
            solved[panels[settled]] = True
            ends[panels] = points.position - np.where(settled[:, None], step, 0.0)
            staying = moved & ~settled & ~(near & ~current.positive)
        else:
            ends[panels] = points.position
        if not staying.all():
            points = points.some(np.flatnonzero(staying))
            panels = panels[staying]
            secants = secants.some(staying)
        if not len(panels):
            break
        # One L-BFGS step of all others.
        points, secants, current, moved = _advanced(points, secants, inverses.some(panels))
        inverses = inverses.replaced(panels, current)
        iterations[panels] += 1
    ends[panels] = points.position
    return BatchOutcome(begun.elsewhere(ends), solved, iterations, inverses)


@dataclass(frozen=True, eq=False)
class Secants:
    """Newest steps and changes of the gradient, which correct M.

    Attributes
    ----------
    pairs : tuple of (s, y, 1/sᵀy)
        Steps s and changes y of the gradient, (panels, cells) each, and 1/sᵀy (panels,), the newest
        last. 1/sᵀy is 0 where a pair does not count.
    """

    pairs: tuple[tuple[Array, Array, Array], ...] = ()

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
        return Secants((*self.pairs, (step, change, size))[-MAX_PAIRS:])

    def direction(self, points: Hessian, inverses: InverseHessians) -> Array:
        """Return −H ∇φ over the free cells, H = M⁻¹ corrected by the secants in two loops."""
        slope = np.where(points.free, points.gradient, 0.0)
        shares = list[Array]()
        for step, change, size in reversed(self.pairs):
            # α = sᵀq/sᵀy, q ← q − α y
            shares.append(size * (step * slope).sum(axis=1))
            slope = slope - shares[-1][:, None] * change
        direction = inverses.newton(slope)
        for (step, change, size), share in zip(self.pairs, reversed(shares), strict=True):
            # β = yᵀd/sᵀy, d ← d + (α − β) s
            direction += (share - size * (change * direction).sum(axis=1))[:, None] * step
        return np.where(points.free, -direction, 0.0)


def _advanced(
    points: Hessian, secants: Secants, inverses: InverseHessians
) -> tuple[Hessian, Secants, InverseHessians, Mask]:
    """Return the points after one step of each panel.

    Unknowns of a step are relative changes of conductances, g ← g·(1 − s), in which readings are
    closest to quadratic.

    Returns
    -------
    points : Hessian
    secants : Secants
    inverses : InverseHessians
        Made anew after a failed step, and where the point has moved far from them.
    moved : array of bool, shape (panels,)
        Whether the step lowered the cost.
    """
    old = inverses.old(points.position)
    if old.any():
        inverses = inverses.renewed(old, points)
        secants = secants.without(old)
    step = secants.direction(points, inverses)
    count = len(inverses.panels)
    length = np.ones((count, 1))
    most = conductance_change(np.asarray(MAX_CHANGE))
    # Backtracking line search: u − log(1 − t·s), t shortened for the panels that have not found a
    # step, at last to 0.
    for attempt in range(MAX_TRIES + 1):
        change = log_resistance_change(np.minimum(length * step, most))
        change = np.where(length > 0, np.clip(change, -MAX_CHANGE, MAX_CHANGE), 0.0)
        trial = points.elsewhere(points.position + change)
        gain = points.at.objectives - trial.at.objectives
        expected = np.abs((points.gradient * (trial.position - points.position)).sum(axis=1))
        moved = decreases_enough(
            gain, expected, points.at.objectives, points.residual, trial.residual
        )
        stays = moved | (length[:, 0] == 0)
        if stays.all():
            break
        worn = (
            replace(panel, worn=panel.worn or not stay)
            for panel, stay in zip(inverses.panels, stays, strict=True)
        )
        inverses = InverseHessians(tuple(worn))
        length[~stays] *= RADIUS_FACTOR if attempt + 1 < MAX_TRIES else 0.0
    return trial, secants.after(points, trial), inverses, moved & (length[:, 0] > 0)
