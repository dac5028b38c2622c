"""Projected Newton (`lampest.solvers.projected_newton`) for many panels at once, over a leading axis.

What has converged leaves the batch. A panel that gets stuck, or whose ∇²φ is not positive definite, is handed back
unsolved: the solver for single panels takes it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.solvers.bounds import MILLIONTH, STILL
from lampest.solvers.certificate import SHARE, clear_of_rounding
from lampest.solvers.panel_batch import Mask, Numbers, PanelBatch, Points
from lampest.solvers.preconditioners import Cholesky, matrix_between
from lampest.solvers.projected_newton import ACCEPTED, FARTHEST, MOST_TRIES, MOVED, NEAR, SHORTER, WORN
from lampest.solvers.solution import Settings

MOST_STEPS = 25  # of a panel in a batch; the solver for single panels goes on from there
MOST_PRODUCTS = 12  # of one direction
CERTIFIED = 0.1  # of log r: ∇²φ changes by as much, and its definiteness is shown again beyond


@dataclass(frozen=True, eq=False)
class Kept:
    """What panels keep from frame to frame: M⁻¹, where it was made, and whether it shows a minimum.

    inverse : (panels, cells, cells). position : (panels, cells), NaN where there is none yet. free : (panels, cells)
    between which M is ∇²φ. positive, worn : (panels) whether that ∇²φ was positive definite; whether a direction took
    many products.
    """

    inverse: Array
    position: Array
    free: Mask
    positive: Mask
    worn: Mask

    @classmethod
    def nothing(cls, panels: int, cells: int) -> "Kept":
        """Before the first frame."""
        blank, none = np.zeros((panels, cells), dtype=bool), np.zeros(panels, dtype=bool)
        return cls(np.zeros((panels, cells, cells)), np.full((panels, cells), np.nan), blank, none, ~none)

    def distance(self, panels: Numbers, position: Array) -> Array:
        """(of some panels) the largest change of log r since; infinite where there is nothing."""
        moved = np.abs(position - self.position[panels]).max(axis=1)
        return np.where(np.isnan(moved), np.inf, moved)

    def shows_minimum(self, panels: Numbers, points: Points) -> Mask:
        """(of some panels) whether ∇²φ was positive definite so near that it still is."""
        near = self.distance(panels, points.position) <= CERTIFIED
        return near & self.positive[panels] & ~(points.free & ~self.free[panels]).any(axis=1)

    def renew(self, panels: Numbers, points: Points) -> None:
        """Make M of some panels anew at their points, in place: there are 80 kB of each 10 × 10 panel."""
        matrices = points.matrix()
        for number, panel in enumerate(panels):
            matrix, free = matrices[number], np.flatnonzero(points.free[number])
            scale = np.abs(np.diag(matrix))
            inverse = np.diag(1 / np.where(scale > 0, scale, 1.0))
            factor = Cholesky.of(points.position[number], free, matrix_between(matrix, free)) if len(free) else None
            positive = factor is not None and clear_of_rounding(factor.triangle, factor.norm)
            if factor is not None and positive:
                inverse[np.ix_(free, free)] = factor.solve(np.diag(factor.size)) / factor.size[:, None]
            self.inverse[panel], self.free[panel] = inverse, points.free[number]
            self.positive[panel] = positive or not len(free)
        self.position[panels], self.worn[panels] = points.position, False


@dataclass(frozen=True, eq=False)
class Ended:
    """What a batch found. position : (panels, cells). solved : (panels) whether a strict minimum is verified there.

    points : of all panels at their ends. iterations : (panels).
    """

    points: Points
    solved: Mask
    iterations: NDArray[np.int64]

    def where(self, chosen: Mask, other: "Ended") -> "Ended":
        """This of the chosen panels, the other of all else."""
        if chosen.all():
            return self
        position = np.where(chosen[:, None], self.points.position, other.points.position)
        solved = np.where(chosen, self.solved, other.solved)
        iterations = np.where(chosen, self.iterations, other.iterations)
        return Ended(Points.at(self.points.batch, position), solved, iterations)


def solve(batch: PanelBatch, start: Array, kept: Kept, numbers: Numbers, settings: Settings) -> Ended:
    """Minimise from `start`, (panels, rows, columns) ohm, with what frames before left; `kept` is renewed in place.

    numbers : of the batch's panels among those that are kept.
    """
    lower, upper = batch.log_bounds
    whole = Points.at(batch, np.clip(np.log(start).reshape(lower.shape), lower, upper))
    ends, here = whole.position.copy(), whole
    solved, iterations = np.zeros(len(start), dtype=bool), np.zeros(len(start), dtype=np.int64)
    panels = np.arange(len(start))
    for _ in range(min(MOST_STEPS, settings.max_iterations)):
        if not len(panels):
            break
        near = here.residual <= settings.tolerance
        if near.any():
            doubtful = near & ~kept.shows_minimum(numbers[panels], here)
            if doubtful.any():
                kept.renew(numbers[panels[doubtful]], here.some(np.flatnonzero(doubtful)))
            close, step = _settled(here, kept.inverse[numbers[panels]])
            settled = near & kept.positive[numbers[panels]] & close
            solved[panels[settled]] = True
            stuck = near & ~kept.positive[numbers[panels]]
            staying = ~(settled | stuck)
            if not staying.all():
                ends[panels] = here.position - np.where(settled[:, None], step, 0.0)
                here, panels = here.some(np.flatnonzero(staying)), panels[staying]
        if not len(panels):
            break
        here, moved = _advanced(here, kept, numbers[panels])
        iterations[panels] += 1
        if not moved.all():
            ends[panels] = here.position
            here, panels = here.some(np.flatnonzero(moved)), panels[moved]
    ends[panels] = here.position
    return Ended(Points.at(batch, np.clip(ends, lower, upper)), solved, iterations)


def _settled(here: Points, inverse: Array) -> tuple[Mask, Array]:
    """As `Certificate.settled`, with M in the place of ∇²φ, and the step that M would take."""
    gradient = np.where(here.free, here.gradient, 0.0)
    step = np.where(here.free, _times(inverse, gradient), 0.0)
    small: Mask = np.abs(step).max(axis=1) <= MILLIONTH
    if not here.batch.data.noise_known:
        return small, step
    decrement = np.sqrt(np.maximum((gradient * step).sum(axis=1), 0.0))
    noise = here.batch.data.sigma.reshape(gradient.shape)
    counting = here.reading_weight > 0
    squares = np.where(counting, here.reading_weight * noise**2, 0.0).sum(axis=1)
    scale = np.sqrt(squares / np.maximum(counting.sum(axis=1), 1))
    near = (decrement <= SHARE * scale) & (np.abs(step).max(axis=1) <= NEAR)
    return small | near, step


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _advanced(here: Points, kept: Kept, panels: Numbers) -> tuple[Points, Mask]:
    """The points after one step each, and which of them found one that lowers the cost."""
    old = kept.worn[panels] | (kept.distance(panels, here.position) > MOVED)
    if old.any():
        kept.renew(panels[old], here.some(np.flatnonzero(old)))
    step, predicted, products = _direction(here, kept.inverse[panels])
    kept.worn[panels[products > WORN[True]]] = True
    position, moved = here.position.copy(), np.zeros(len(panels), dtype=bool)
    trying, length = np.arange(len(panels)), 1.0
    lower, upper = here.batch.log_bounds
    for attempt in range(MOST_TRIES):
        target = here.position[trying] - np.log1p(-length * step[trying])
        some = here if len(trying) == len(panels) else here.some(trying)
        trial = Points.at(some.batch, np.clip(target, lower[trying], upper[trying]))
        gain = some.objective - trial.objective
        expected = predicted[trying] * (length * (2 - length))
        invisible = STILL * np.abs(some.objective)
        lowered = np.where(
            expected > invisible,
            gain >= ACCEPTED * expected,
            (np.abs(gain) <= invisible) & (trial.residual <= some.residual / 2),
        )
        if attempt == 0 and lowered.all():
            return trial, np.ones(len(panels), dtype=bool)
        moved[trying[lowered]] = True
        position[trying[lowered]] = trial.position[lowered]
        trying, length = trying[~lowered], SHORTER * length
        if not len(trying):
            break
    return Points.at(here.batch, position), moved


def _direction(here: Points, inverse: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """(step in relative changes of conductance, predicted decrease, products) of every panel, within the bounds."""
    lower, upper = (bound - here.position for bound in here.batch.log_bounds)
    low, high = -np.expm1(-np.maximum(lower, -FARTHEST)), -np.expm1(-np.minimum(upper, FARTHEST))
    accuracy = np.minimum(0.1, np.sqrt(here.residual))
    step, moving, slope = np.zeros_like(here.gradient), here.free, here.gradient.copy()
    exact, left = np.ones((len(step), 1)), np.arange(len(step))
    predicted, count = np.zeros_like(accuracy), np.zeros(len(step), dtype=np.int64)
    for stop in range(MOST_TRIES):
        some = here if len(left) == len(step) else here.some(left)
        given = inverse[left], moving[left], slope[left], accuracy[left]
        found = conjugate_gradients(some.product, exact[left], *given)
        if found.negative.any():
            exact[left[found.negative]] = 0.0
            found = conjugate_gradients(some.product, exact[left], *given)
        count[left] = np.maximum(count[left], found.products)
        step[left] = np.where(moving[left], found.step, step[left])
        if not stop:
            predicted = found.decrease
        beyond = moving & ((step < low) | (step > high))
        left = np.flatnonzero(beyond.any(axis=1))
        if not len(left):
            break
        step, moving = np.clip(step, low, high), moving & ~beyond
        some = here if len(left) == len(step) else here.some(left)
        slope[left] = here.gradient[left] + some.product(np.where(moving[left], 0.0, step[left]), exact[left])
        whole = some.product(step[left], exact[left])
        predicted[left] = -(step[left] * (here.gradient[left] + whole / 2)).sum(axis=1)
    return np.clip(step, low, high), predicted, count


@dataclass(frozen=True, eq=False)
class Directions:
    """step, decrease, negative, products : as `SubproblemStep`, of every panel."""

    step: Array
    decrease: Array
    negative: Mask
    products: NDArray[np.int64]


def conjugate_gradients(
    product: Callable[[Array, Array], Array], exact: Array, inverse: Array, moving: Mask, slope: Array, accuracy: Array
) -> Directions:
    """argmin gᵀs + ½ sᵀHs over the moving cells of every panel; see `lampest.panel.trust_region.steihaug`."""
    residual = np.where(moving, slope, 0.0)
    scaled = np.where(moving, _times(inverse, residual), 0.0)
    search, strength = -scaled, (residual * scaled).sum(axis=1)
    goal, step = accuracy**2 * strength, np.zeros_like(residual)
    negative, count = np.zeros(len(step), dtype=bool), np.zeros(len(step), dtype=np.int64)
    for _ in range(MOST_PRODUCTS):
        going = (strength > goal) & ~negative
        if not going.any():
            break
        image = np.where(moving, product(search, exact), 0.0)
        curvature = (search * image).sum(axis=1)
        negative |= going & ~(curvature > 0)
        going &= ~negative
        count[going] += 1
        length = np.where(going, strength / np.where(going, curvature, 1.0), 0.0)[:, None]
        step, residual = step + length * search, residual + length * image
        scaled = np.where(moving, _times(inverse, residual), 0.0)
        before, strength = strength, np.where(going, (residual * scaled).sum(axis=1), strength)
        ratio = np.where(going, strength / np.where(going, before, 1.0), 0.0)[:, None]
        search = np.where(going[:, None], ratio * search - scaled, search)
    decrease = -0.5 * (step * (np.where(moving, slope, 0.0) + residual)).sum(axis=1)
    return Directions(step, decrease, negative, count)
