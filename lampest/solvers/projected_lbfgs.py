"""Projected L-BFGS for many panels over a leading axis, about inverse Hessians that are kept from frame to frame.

Where frames differ little, M⁻¹ ∇φ is nearly Newton's step, and every further step costs one gradient and one product
with M⁻¹. What has converged leaves the batch. A panel that gets stuck, or whose ∇²φ is not positive definite, is handed
back unsolved: the solver for single panels takes it.
Source: Nocedal & Wright, Numerical Optimization, 2006, algorithm 7.4.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.trust_region import SUFFICIENT_DECREASE
from lampest.solvers.bounds import MILLIONTH, MIN_DECREASE_SHARE
from lampest.solvers.certificate import clear_of_rounding
from lampest.solvers.hessian import Hessian, matrix_between
from lampest.solvers.preconditioners import Cholesky
from lampest.solvers.projected_newton import STEPS
from lampest.solvers.smoothing import Smoothing
from lampest.solvers.solution import Settings

Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

MAX_STEPS = 40  # of a panel in a batch; the solver for single panels goes on from there
CERTIFIED_DISTANCE = 0.1  # of log r: ∇²φ changes by as much, and its definiteness is shown again beyond
LAST_STEP = 0.01 * MILLIONTH  # of log r: M⁻¹ ∇φ misses Newton’s step by a tenth of it


@dataclass(frozen=True, eq=False)
class InverseHessians:
    """Inverse Hessians of panels, kept from frame to frame.

    Attributes
    ----------
    inverse : array, shape (panels, cells, cells)
        M⁻¹.
    position : array, shape (panels, cells)
        Point where M was made, log r; NaN where there is none yet.
    free : array of bool, shape (panels, cells)
        Cells between which M is ∇²φ.
    positive : array of bool, shape (panels,)
        Whether that ∇²φ was positive definite.
    worn : array of bool, shape (panels,)
        Whether a step failed since.
    """

    inverse: Array
    position: Array
    free: Mask
    positive: Mask
    worn: Mask

    @classmethod
    def nothing(cls, panels: int, cells: int) -> "InverseHessians":
        """Return the inverses before the first frame."""
        blank, none = np.zeros((panels, cells), dtype=bool), np.zeros(panels, dtype=bool)
        return cls(np.zeros((panels, cells, cells)), np.full((panels, cells), np.nan), blank, none, ~none)

    def distance(self, panels: Numbers, position: Array) -> Array:
        """(of some panels) the largest change of log r since; infinite where there is nothing."""
        moved = np.abs(position - self.position[panels]).max(axis=1)
        return np.where(np.isnan(moved), np.inf, moved)

    def shows_minimum(self, panels: Numbers, points: Hessian) -> Mask:
        """(of some panels) whether ∇²φ was positive definite so near that it still is."""
        near = self.distance(panels, points.position) <= CERTIFIED_DISTANCE
        return near & self.positive[panels] & ~(points.free & ~self.free[panels]).any(axis=1)

    def newton(self, panels: Numbers, gradient: Array) -> Array:
        """M⁻¹ g (of some panels, cells)."""
        if panels[-1] - panels[0] == len(panels) - 1:
            together = self.inverse[panels[0] : panels[-1] + 1]
            return np.asarray((together @ gradient[..., None])[..., 0])
        step = np.empty_like(gradient)
        for row, panel in enumerate(panels.tolist()):  # without a copy of their matrices
            np.matmul(self.inverse[panel], gradient[row], out=step[row])
        return step

    def renew(self, panels: Numbers, points: Hessian) -> None:
        """Make M of some panels anew at their points, in place: there are 80 kB of each 10 × 10 panel.

        M is ∇²φ in relative changes of conductances, whose quadratic model has ∇φ more on the diagonal. Frames that
        begin at one estimate share M: their Hessians differ by what their residuals add.
        """
        if len(panels) > 1 and not np.ptp(points.position, axis=0).any():
            self.renew(panels[:1], points.some(np.array([0])))
            for values in (self.inverse, self.position, self.free, self.positive, self.worn):
                values[panels[1:]] = values[panels[0]]
            return
        matrices = points.matrix.copy()
        np.einsum("...ii->...i", matrices)[...] += points.gradient
        for number, panel in enumerate(panels):
            matrix, free = matrices[number], np.flatnonzero(points.free[number])
            scale = np.abs(np.diag(matrix))
            inverse = np.diag(1 / np.where(scale > 0, scale, 1.0))
            factor = Cholesky.of(points.position[number], free, matrix_between(matrix, free)) if len(free) else None
            positive = factor is not None and clear_of_rounding(factor.triangle, factor.norm)
            if factor is not None and positive:
                inverse[np.ix_(free, free)] = factor.inverse()
            self.inverse[panel], self.free[panel] = inverse, points.free[number]
            self.positive[panel] = positive or not len(free)
        self.position[panels], self.worn[panels] = points.position, False


@dataclass(frozen=True, eq=False)
class BatchOutcome:
    """Ends of a batch.

    Attributes
    ----------
    points : Hessian
    solved : array of bool, shape (panels,)
        Whether a strict minimum is verified there.
    iterations : array of int, shape (panels,)
    """

    points: Hessian
    solved: Mask
    iterations: NDArray[np.int64]

    def where(self, chosen: Mask, otherwise: "BatchOutcome") -> "BatchOutcome":
        """Return this of the chosen panels, the other of all else."""
        if chosen.all():
            return self
        position = np.where(chosen[:, None], self.points.position, otherwise.points.position)
        solved = np.where(chosen, self.solved, otherwise.solved)
        iterations = np.where(chosen, self.iterations, otherwise.iterations)
        return BatchOutcome(self.points.elsewhere(position), solved, iterations)


def serves(cost: Cost, data: Data) -> bool:
    """Return whether a batch can minimise a cost: smooth losses, and readings of floating lines without wire."""
    if any(term.loss.enters == "dual" for term in cost.terms) or cost.frames != 1 or data.wiring is not None:
        return False
    entries = cost.functions.entries
    return isinstance(data.readout, TwoPointReadout) and entries.at_model is not None and not entries.crossed


def solve(start: Evaluation, inverses: InverseHessians, numbers: Numbers, settings: Settings) -> BatchOutcome:
    """Minimise the costs of many panels.

    Parameters
    ----------
    start : Evaluation
        With a leading axis of panels, within their bounds.
    inverses : InverseHessians
        From earlier frames; renewed in place.
    numbers : array, shape (panels,)
        Places of these panels in `inverses`.
    settings : Settings
    """
    whole = points = Hessian(start, Smoothing(1.0, np.zeros(0)))
    ends, (count,) = whole.position.copy(), start.data.panels
    solved, iterations = np.zeros(count, dtype=bool), np.zeros(count, dtype=np.int64)
    panels, secants = np.arange(count), Secants()
    for _ in range(min(MAX_STEPS, settings.max_iterations)):
        if not len(panels):
            break
        near = points.residual <= settings.tolerance
        if near.any():
            doubtful = near & ~inverses.shows_minimum(numbers[panels], points)
            if doubtful.any():
                inverses.renew(numbers[panels[doubtful]], points.some(np.flatnonzero(doubtful)))
            step = np.where(
                points.free, inverses.newton(numbers[panels], np.where(points.free, points.gradient, 0.0)), 0.0
            )
            settled = near & inverses.positive[numbers[panels]] & (np.abs(step).max(axis=1) <= LAST_STEP)
            solved[panels[settled]] = True
            stuck = near & ~inverses.positive[numbers[panels]]
            staying = ~(settled | stuck)
            if not staying.all():
                ends[panels] = points.position - np.where(settled[:, None], step, 0.0)
                points, panels, secants = points.some(np.flatnonzero(staying)), panels[staying], secants.some(staying)
        if not len(panels):
            break
        points, secants, moved = _advanced(points, secants, inverses, numbers[panels])
        iterations[panels] += 1
        if not moved.all():
            ends[panels] = points.position
            points, panels, secants = points.some(np.flatnonzero(moved)), panels[moved], secants.some(moved)
    ends[panels] = points.position
    return BatchOutcome(whole.elsewhere(ends), solved, iterations)


@dataclass(frozen=True, eq=False)
class Secants:
    """Newest steps and changes of the gradient, which correct M.

    Attributes
    ----------
    pairs : tuple of (s, y, 1/sᵀy)
        The newest last: (panels, cells) each, and (panels); 0 where none counts.
    most : int
        Number that is kept.
    """

    pairs: tuple[tuple[Array, Array, Array], ...] = ()
    most: int = 4

    def some(self, chosen: Mask) -> "Secants":
        """Return the secants of some panels."""
        return Secants(tuple((step[chosen], change[chosen], size[chosen]) for step, change, size in self.pairs))

    def without(self, forgotten: Mask) -> "Secants":
        """Return the secants, of which those of some panels count no longer."""
        return Secants(tuple((s, y, np.where(forgotten, 0.0, size)) for s, y, size in self.pairs))

    def after(self, before: Hessian, points: Hessian) -> "Secants":
        """Return the secants with one step more; cells that are not free at both ends do not count."""
        both = before.free & points.free
        step = np.where(both, points.position - before.position, 0.0)
        change = np.where(both, points.gradient - before.gradient, 0.0)
        along = (step * change).sum(axis=1)
        size = np.where(along > 0, 1 / np.where(along > 0, along, 1.0), 0.0)
        return Secants((*self.pairs, (step, change, size))[-self.most :])

    def direction(self, points: Hessian, inverses: InverseHessians, panels: Numbers) -> Array:
        """−H ∇φ over the free cells by the two-loop recursion, H = M⁻¹ with its corrections."""
        slope, shares = np.where(points.free, points.gradient, 0.0), list[Array]()
        for step, change, size in reversed(self.pairs):
            shares.append(size * (step * slope).sum(axis=1))
            slope = slope - shares[-1][:, None] * change
        direction = inverses.newton(panels, slope)
        for (step, change, size), share in zip(self.pairs, reversed(shares), strict=True):
            direction += (share - size * (change * direction).sum(axis=1))[:, None] * step
        return np.where(points.free, -direction, 0.0)


def _advanced(
    points: Hessian, secants: Secants, inverses: InverseHessians, panels: Numbers
) -> tuple[Hessian, Secants, Mask]:
    """Return the points after one step each, and which of them found one that lowers the cost.

    Steps are relative changes of conductances, g ← g·(1 − s), in which readings are closest to quadratic.
    """
    old = inverses.worn[panels] | (inverses.distance(panels, points.position) > STEPS.max_reuse_distance)
    if old.any():
        inverses.renew(panels[old], points.some(np.flatnonzero(old)))
        secants = secants.without(old)
    step = secants.direction(points, inverses, panels)
    position, moved = points.position.copy(), np.zeros(len(panels), dtype=bool)
    trying, length = np.arange(len(panels)), 1.0
    low, high = points.position - STEPS.max_step, points.position + STEPS.max_step
    most = -np.expm1(-STEPS.max_step)  # relative change of a conductance
    for attempt in range(STEPS.max_tries):
        target = points.position[trying] - np.log1p(-np.minimum(length * step[trying], most))
        some = points if len(trying) == len(panels) else points.some(trying)
        trial = some.elsewhere(np.clip(target, low[trying], high[trying]))
        gain = some.at.objectives - trial.at.objectives
        expected = -(some.gradient * (trial.position - some.position)).sum(axis=1)
        invisible = MIN_DECREASE_SHARE * np.abs(some.at.objectives)
        lowered = np.where(
            np.abs(expected) > invisible,
            gain >= SUFFICIENT_DECREASE * np.abs(expected),
            (np.abs(gain) <= invisible) & (trial.residual <= some.residual / 2),
        )
        if attempt == 0 and lowered.all():
            return trial, secants.after(points, trial), lowered
        inverses.worn[panels[trying[~lowered]]] = True
        moved[trying[lowered]] = True
        position[trying[lowered]] = trial.position[lowered]
        trying, length = trying[~lowered], STEPS.radius_factor * length
        if not len(trying):
            break
    after = points.elsewhere(position)
    return after, secants.after(points, after), moved
