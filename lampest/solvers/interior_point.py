"""Log-barrier interior-point method for plain least squares of a large panel, where many cells end at a bound.

The method minimises φ(g) − μ Σ log(g − g_low) − μ Σ log(g_high − g) over the conductances g for decreasing μ, by
Newton's method with the multipliers of the bounds as further unknowns. Without it such frames take ten times the
products.
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
        Distance of the first point from the bounds, as a share of the median conductance; at most a fiftieth of the
        distance between the bounds of the cell.
    barrier_reduction : float
        Factor of μ after a step of which bounds left more than half.
    step_to_boundary : float
        Share of the distance to the nearest bound that a step may cover.
    min_step : float
        Share of a step that bounds must leave. Conjugate gradients end before a longer one, which directions of nearly
        no curvature cause.
    max_steps, max_halvings : int
        Maximum number of steps of the method, and of halvings of one step.
    start_tolerance : float
        Projected gradient, relative to the cost's scale, below which the method does not begin. Frames in sequence
        begin at 0.05, frames that are solved again at their tolerance.
    max_barrier_share : float
        Share of the cost due to the bounds at which the method ends; the last steps are left to Newton's method.
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
        """Return the largest share ≤ 1 of a change that keeps all distances `room` positive."""
        falling = (change < 0) & (room > 0)
        nearest = float((-room[falling] / change[falling]).min(initial=np.inf))
        return min(1.0, self.step_to_boundary * nearest)


# Without min_step, and with μ reduced after every step, one of two later frames at 100 × 100 takes more than 60 s in
# place of 5 to 8 s (docs/studies/speed.md).
METHOD = InteriorPoint()


def by_interior_point(start: Evaluation) -> tuple[Evaluation, int]:
    """Return the point at which the barrier's share of the cost has vanished, and the number of steps.

    Returns `start` and no steps if the method does not apply, and `start` if the method ends at a higher cost.
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
    """Return whether the cost is plain least squares of a large frame with more cells at a bound than lines."""
    hessian, data = Hessian(start, Smoothing.start(start)), start.data
    if hessian.dense or not hessian.only_data or not all(term.loss.squared for term in start.cost.terms):
        return False
    cells = start.cell_resistance
    if start.projected_gradients(hessian.gradient.reshape(cells.shape)) <= METHOD.start_tolerance:
        return False
    # 1/(1/r) and exp(log r) of a bound differ from it in their last bits.
    at_bound = np.isclose(cells, data.lower, rtol=1e-12, atol=0) | np.isclose(cells, data.upper, rtol=1e-12, atol=0)
    stopped = int(np.sum(at_bound & (data.lower < data.upper)))
    return stopped > sum(cells.shape[1:]) and bool(np.all(np.isfinite([1 / data.lower, data.upper])))


@dataclass(frozen=True, eq=False)
class _Barrier:
    """Iterate of the interior-point method.

    Attributes
    ----------
    at : Evaluation
    below, above : array, shape (rows, columns)
        Multipliers z and w of the lower and the upper bounds of g, cost/siemens.
    mean : float
        Barrier parameter μ, the target of z·(g − g_low) and w·(g_high − g).
    length : float
        Share of the last step that bounds left.
    """

    at: Evaluation
    below: Array
    above: Array
    mean: float
    length: float = 1.0

    @classmethod
    def of(cls, start: Evaluation) -> "_Barrier":
        """Return the first iterate: a point inside the bounds with z·(g − g_low) = w·(g_high − g) = μ."""
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
        """Conductances g, (rows, columns) siemens."""
        return np.asarray(1 / self.at.cell_resistance[0])

    @cached_property
    def rooms(self) -> tuple[Array, Array]:
        """Distances to the bounds (g − g_low, g_high − g), (rows, columns) siemens."""
        low, high = _bounds(self.at)
        return self.conductance - low, high - self.conductance

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Whether the bounds of a cell differ, boolean (rows, columns)."""
        low, high = _bounds(self.at)
        return np.asarray(low < high, dtype=bool)

    @cached_property
    def hessian(self) -> Hessian:
        """Derivatives of φ in u = log r."""
        return Hessian(self.at, Smoothing.start(self.at))

    @cached_property
    def gradient(self) -> Array:
        """Gradient ∂φ/∂g = −(∂φ/∂u)/g, (rows, columns)."""
        return np.asarray(-self.hessian.gradient.reshape(self.conductance.shape) / self.conductance)

    @property
    def added(self) -> float:
        """Complementarity Σ z·(g − g_low) + w·(g_high − g), an estimate of the cost that the barrier adds."""
        return float(np.sum(self.below * self.rooms[0] + self.above * self.rooms[1]))

    @cached_property
    def stiffness(self) -> Array:
        """Second derivative of the barrier, z/(g − g_low) + w/(g_high − g); zero for cells that cannot move."""
        return _over(self.below, self.rooms[0]) + _over(self.above, self.rooms[1])

    def moved(self) -> "_Barrier | None":
        """Return the iterate after one step; None if no step lowers the barrier function."""
        mean = self.mean * (METHOD.barrier_reduction if self.length > 0.5 else 1.0)
        # −∇ of the barrier function: −∂φ/∂g + μ/(g − g_low) − μ/(g_high − g)
        push = np.where(self.moving, -self.gradient + _over(mean, self.rooms[0]) - _over(mean, self.rooms[1]), 0.0)
        step = self._step(push)
        length = min(METHOD.reach(self.rooms[0], step), METHOD.reach(self.rooms[1], -step))
        # Backtracking until the barrier function falls by a share of the predicted decrease.
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
        """Return the step (∂²φ/∂g² + stiffness)⁻¹·push; with the Gauss–Newton matrix where that is indefinite.

        Conjugate gradients solve for relative steps δg/g, whose Hessian is ∇²φ + diag(∇φ) + stiffness·g².
        """
        hessian, free = self.hessian, self.moving.ravel()
        chosen, whole = np.flatnonzero(free), np.zeros(push.size)
        stiff = (self.stiffness * self.conductance**2).ravel()
        exact: Linear = lambda step: hessian.product(step) + (stiff + hessian.gradient) * step  # noqa: E731
        precondition = TwoLevel.of(hessian, stiff).over(free, self.at.cell_resistance)
        slope = -(push * self.conductance).ravel()[chosen]
        # Accuracy grows as the barrier's share shrinks: residuals of cells at bounds hide those of the others. With
        # ACCURACY throughout, besides the changes named at METHOD, a later frame takes 83 s (docs/studies/speed.md).
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
        """Return the barrier function φ − μ Σ log(g − g_low) − μ Σ log(g_high − g); infinite outside the bounds."""
        low, high = _bounds(at)
        inside = (1 / at.cell_resistance[0])[self.moving]
        rooms = np.concatenate([inside - low[self.moving], high[self.moving] - inside])
        return at.objective - mean * float(np.log(rooms).sum()) if np.all(rooms > 0) else float("inf")

    def _forced(self, trial: Evaluation, step: Array, mean: float, ahead: float) -> "_Barrier":
        """Return the iterate at the trial point, with multipliers moved as far as they stay positive."""
        # δz = (μ − z·δg)/(g − g_low) − z, δw = (μ + w·δg)/(g_high − g) − w
        below = _over(mean - self.below * step, self.rooms[0]) - self.below
        above = _over(mean + self.above * step, self.rooms[1]) - self.above
        length = min(METHOD.reach(self.below, below), METHOD.reach(self.above, above))
        return _Barrier(trial, self.below + length * below, self.above + length * above, mean, min(length, ahead))

    def put_at_bounds(self) -> Evaluation:
        """Return the evaluation with cells put at each bound whose barrier curvature exceeds that of their reading."""
        data = self.at.data
        # In the conductance: z/(g − g_low) > W·(∂y/∂g)²
        own = self.hessian.own.reshape(self.conductance.shape) / self.conductance**2
        below, above = (_over(*pair) > own for pair in zip((self.below, self.above), self.rooms, strict=True))
        cells = np.where(below, data.upper[0], self.at.cell_resistance[0])
        return self.at.elsewhere(np.where(above, data.lower[0], cells)[None])


def _bounds(at: Evaluation) -> tuple[Array, Array]:
    """Return the bounds (g_low, g_high) of the conductance, (rows, columns) siemens each."""
    return 1 / at.data.upper[0], 1 / at.data.lower[0]


def _over(force: Array | float, room: Array) -> Array:
    """Return force/room; zero where room is zero."""
    return np.asarray(np.divide(force, room, out=np.zeros_like(room), where=room > 0))
