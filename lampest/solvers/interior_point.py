"""Log-barrier interior-point method for plain least squares of a large panel, where many cells end at a bound.

argmin φ(g) − μ Σ log(g − g_low) − μ Σ log(g_high − g) in the conductances g for ever smaller μ, by Newton's method with
the multipliers of the bounds as unknowns. Without it such frames take ten times the products.
Source: Nocedal & Wright, Numerical Optimization, 2006, sections 19.2 and 19.3.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array
from lampest.panel.trust_region import SUFFICIENT_DECREASE, Linear, restricted, steihaug
from lampest.solvers.certificate import ACCURACY
from lampest.solvers.hessian import Hessian
from lampest.solvers.preconditioners import TwoLevel
from lampest.solvers.smoothing import Smoothing


@dataclass(frozen=True)
class InteriorPoint:
    """Parameters of the method.

    Attributes
    ----------
    start_margin : float
        Distance from its bounds at which a cell begins, as a share of the median conductance; a fiftieth of what lies
        between its bounds at most.
    barrier_reduction : float
        The next μ over this one, after a step of which bounds left at least half.
    step_to_boundary : float
        Share of the way to the next bound that a step may go.
    min_step : float
        Share of a step that bounds must leave: conjugate gradients end before (directions of nearly no curvature).
    max_steps, max_halvings : int
        Of the method, and of one step.
    start_tolerance : float
        Gradient, of the cost's scale, below which it does not begin: frames in sequence begin at 0.05, what is solved
        again at its tolerance.
    max_barrier_share : float
        Part of the cost that bounds still add where the last steps are left to Newton's method.
    """

    start_margin: float = 0.05
    barrier_reduction: float = 0.2
    step_to_boundary: float = 0.99
    min_step: float = 0.03
    max_steps: int = 90
    max_halvings: int = 12
    start_tolerance: float = 1e-3
    max_barrier_share: float = 1e-8

    def reach(self, room: Array, change: Array) -> float:
        """Return how far along a change all rooms stay positive, at most one."""
        falling = (change < 0) & (room > 0)
        nearest = float((-room[falling] / change[falling]).min(initial=np.inf))
        return min(1.0, self.step_to_boundary * nearest)


METHOD = InteriorPoint()


def by_interior_point(start: Evaluation) -> tuple[Evaluation, int]:
    """Return the cost where the bounds' part in it has become nothing, and the steps.

    `start` and none where it is no help.
    """
    if not crowds_bounds(start):
        return start, 0
    barrier, steps = _Barrier.of(start), 0
    while (
        steps < METHOD.max_steps
        and barrier.added > METHOD.max_barrier_share * barrier.at.objective
        and not start.data.overdue
    ):
        moved = barrier.moved()
        if moved is None:
            break
        barrier, steps = moved, steps + 1
    bounded = barrier.put_at_bounds()
    return (bounded if bounded.objective < start.objective else start), steps


def crowds_bounds(start: Evaluation) -> bool:
    """Whether squares of a large frame's readings are all there is, and more cells than lines stand at a bound."""
    hessian, data = Hessian(start, Smoothing.start(start)), start.data
    if hessian.dense or not hessian.only_data or not all(term.loss.squared for term in start.cost.terms):
        return False
    cells = start.cell_resistance
    if start.projected_gradient(hessian.gradient.reshape(cells.shape)) <= METHOD.start_tolerance:
        return False
    stopped = int(np.sum(((cells <= data.lower) | (cells >= data.upper)) & (data.lower < data.upper)))
    return stopped > sum(cells.shape[1:]) and bool(np.all(np.isfinite([1 / data.lower, data.upper])))


@dataclass(frozen=True, eq=False)
class _Barrier:
    """Point of the interior-point method.

    Attributes
    ----------
    at : Evaluation
        The cost.
    below, above : array
        z, w, the forces that the bounds of g exert, (rows, columns) cost/siemens.
    mean : float
        μ, the mean force times room that the next step aims at.
    length : float
        Of the last step, as far as bounds let it.
    """

    at: Evaluation
    below: Array
    above: Array
    mean: float
    length: float = 1.0

    @classmethod
    def of(cls, start: Evaluation) -> "_Barrier":
        """Return a point somewhat inside the bounds, with the same force times room everywhere."""
        low, high = _bounds(start)
        conductance = 1 / start.cell_resistance[0]
        room = np.minimum(METHOD.start_margin * float(np.median(conductance)), (high - low) / 50)
        at = start.elsewhere(1 / np.clip(conductance, low + room, high - room)[None])
        bare = cls(at, np.zeros_like(low), np.zeros_like(low), 0.0)
        mean = 0.1 * float(np.mean((np.abs(bare.gradient) * np.minimum(*bare.rooms))[bare.moving]))
        under, over = bare.rooms
        return cls(at, _over(mean, under), _over(mean, over), mean)

    @cached_property
    def conductance(self) -> Array:
        return np.asarray(1 / self.at.cell_resistance[0])

    @cached_property
    def rooms(self) -> tuple[Array, Array]:
        """(g − g_low, g_high − g), siemens."""
        low, high = _bounds(self.at)
        return self.conductance - low, high - self.conductance

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """(rows, columns) whether a cell has two bounds that differ."""
        low, high = _bounds(self.at)
        return np.asarray(low < high, dtype=bool)

    @cached_property
    def hessian(self) -> Hessian:
        return Hessian(self.at, Smoothing.start(self.at))

    @cached_property
    def gradient(self) -> Array:
        """∂φ/∂g."""
        return np.asarray(-self.hessian.gradient.reshape(self.conductance.shape) / self.conductance)

    @property
    def added(self) -> float:
        """Σ z·(g − g_low) + w·(g_high − g): at most what the bounds keep the cost above its least value."""
        return float(np.sum(self.below * self.rooms[0] + self.above * self.rooms[1]))

    @cached_property
    def stiffness(self) -> Array:
        """z/(g − g_low) + w/(g_high − g), zero where nothing moves."""
        return _over(self.below, self.rooms[0]) + _over(self.above, self.rooms[1])

    def moved(self) -> "_Barrier | None":
        """Return the point after one step; None where no step leads lower."""
        mean = self.mean * (METHOD.barrier_reduction if self.length > 0.5 else 1.0)
        push = np.where(self.moving, -self.gradient + _over(mean, self.rooms[0]) - _over(mean, self.rooms[1]), 0.0)
        step = self._step(push)
        length = min(METHOD.reach(self.rooms[0], step), METHOD.reach(self.rooms[1], -step))
        before, along = self._merit(self.at, mean), float(np.sum(push * step))
        for _ in range(METHOD.max_halvings):
            cells = 1 / (self.conductance + length * step)
            with suppress(np.linalg.LinAlgError):
                trial = self.at.elsewhere(cells[None])
                if self._merit(trial, mean) <= before - SUFFICIENT_DECREASE * length * along:
                    return self._forced(trial, step, mean, length)
            length /= 2
        return None

    def _step(self, push: Array) -> Array:
        """(∂²φ/∂g² + stiffness)⁻¹·push, by relative steps δg/g; with JᵀWJ where that is indefinite."""
        hessian, free = self.hessian, self.moving.ravel()
        chosen, whole = np.flatnonzero(free), np.zeros(push.size)
        stiff = (self.stiffness * self.conductance**2).ravel()
        exact: Linear = lambda step: hessian.product(step) + (stiff + hessian.gradient) * step  # noqa: E731
        precondition = TwoLevel.of(hessian, stiff).over(free, self.at.cell_resistance)
        slope = -(push * self.conductance).ravel()[chosen]
        # Steps grow exact as the bounds' part fades: residuals of cells there hide those of others.
        accuracy = ACCURACY * min(1.0, self.added / self.at.objective) ** 0.25
        rooms = [(room / self.conductance).ravel()[chosen] for room in self.rooms]

        def admits(step: Array) -> bool:
            return min(METHOD.reach(rooms[0], step), METHOD.reach(rooms[1], -step)) >= METHOD.min_step

        solved = steihaug(restricted(exact, chosen, push.size), precondition, slope, accuracy, admits=admits)
        if solved.negative:
            squares: Linear = lambda step: hessian.gauss_newton_product(step) + stiff * step  # noqa: E731
            solved = steihaug(restricted(squares, chosen, push.size), precondition, slope, accuracy, admits=admits)
        whole[chosen] = solved.step
        return whole.reshape(push.shape) * self.conductance

    def _merit(self, at: Evaluation, mean: float) -> float:
        low, high = _bounds(at)
        inside = (1 / at.cell_resistance[0])[self.moving]
        rooms = np.concatenate([inside - low[self.moving], high[self.moving] - inside])
        return at.objective - mean * float(np.log(rooms).sum()) if np.all(rooms > 0) else float("inf")

    def _forced(self, trial: Evaluation, step: Array, mean: float, ahead: float) -> "_Barrier":
        """Return the trial point with forces that follow as far as they stay positive."""
        below = _over(mean - self.below * step, self.rooms[0]) - self.below
        above = _over(mean + self.above * step, self.rooms[1]) - self.above
        length = min(METHOD.reach(self.below, below), METHOD.reach(self.above, above))
        return _Barrier(trial, self.below + length * below, self.above + length * above, mean, min(length, ahead))

    def put_at_bounds(self) -> Evaluation:
        """Return the cost with cells at the bound whose barrier curves more than the readings do."""
        data = self.at.data
        own = self.hessian.own.reshape(self.conductance.shape) / self.conductance**2
        below, above = (_over(*pair) > own for pair in zip((self.below, self.above), self.rooms, strict=True))
        cells = np.where(below, data.upper[0], self.at.cell_resistance[0])
        return self.at.elsewhere(np.where(above, data.lower[0], cells)[None])


def _bounds(at: Evaluation) -> tuple[Array, Array]:
    """(g_low, g_high) (rows, columns) siemens."""
    return 1 / at.data.upper[0], 1 / at.data.lower[0]


def _over(force: Array | float, room: Array) -> Array:
    """force/room; zero where there is no room at all."""
    return np.asarray(np.divide(force, room, out=np.zeros_like(room), where=room > 0))
