"""Log-barrier interior-point method with potentials eliminated.

The method minimises φ(g) − μ Σ log(g − g_low) − μ Σ log(g_high − g) over the conductances g for
decreasing μ, by Newton's method with the multipliers of the bounds as further unknowns. A start far
from the optimum of a cost with several minima follows the central path of the method, which ends in
lower minima than steps straight down. Plain least squares of a large panel, where many cells end at
a bound, take a tenth of the products.
Source: Nocedal & Wright, Numerical Optimization, 2006, sections 19.2 and 19.3.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import SUFFICIENT_DECREASE, backtracked, restricted, steihaug
from lampest.solvers.certificate import ACCURACY
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.preconditioners import Cholesky, TwoLevel

# Distance of the first point from the bounds, as a share of the median conductance; at most a
# fiftieth of the distance between the bounds of the cell
START_MARGIN = 0.05
BARRIER_REDUCTION = 0.2  # factor of μ after a step of which bounds left more than half
STEP_TO_BOUNDARY = 0.99  # share of the distance to the nearest bound that a step may cover
# Share of a step that bounds must leave. Conjugate gradients end before a longer one, which
# directions of nearly no curvature cause. Without it, and with μ reduced after every step, a frame
# of a large panel may take ten times as long (docs/studies/speed.md).
MIN_STEP = 0.03
MAX_STEPS = 90
MAX_LENGTHS = 12  # tried lengths of one step
# Share of the cost due to the bounds at which the method ends; the last steps are left to Newton's
# method.
MAX_BARRIER_SHARE = 1e-8
# Change of the distances (g − g_low, g_high − g) with g.
SIDES = np.array([1.0, -1.0])[:, None, None, None]


def central_path(start: Evaluation, max_steps: int = MAX_STEPS) -> tuple[Evaluation, int]:
    """Return the point at which the barrier's share of the cost has vanished.

    The number of steps is returned, too. Returns `start` if the path ends at a higher cost.
    """
    barrier = Barrier.of(start)
    steps = 0
    while steps < min(max_steps, MAX_STEPS) and not start.data.overdue:
        ended = not barrier.added > MAX_BARRIER_SHARE * barrier.at.objective
        trial = None if ended else barrier.advanced()
        if trial is None:
            break
        barrier = trial
        steps = steps + 1
    bounded = barrier.put_at_bounds()
    return (bounded if bounded.objective < start.objective else start), steps


def reach(distances: Array, change: Array) -> float:
    """Return the largest share ≤ 1 of a change that keeps all positive distances positive."""
    falling = (change < 0) & (distances > 0)
    nearest = float((-distances[falling] / change[falling]).min(initial=np.inf))
    return min(1.0, STEP_TO_BOUNDARY * nearest)


def over(force: Array | float, distances: Array) -> Array:
    """Return force/distance; zero where the distance is zero."""
    return np.divide(force, distances, out=np.zeros_like(distances), where=distances > 0)


@dataclass(frozen=True, eq=False)
class Barrier:
    """Iterate of the interior-point method.

    Attributes
    ----------
    at : Evaluation
    multipliers : array, shape (2, frames, rows, columns)
        Multipliers z and w of the lower and the upper bounds of g, cost/siemens.
    mean : float
        Barrier parameter μ, the target of z·(g − g_low) and w·(g_high − g).
    length : float
        Share of the last step that bounds left.
    """

    at: Evaluation
    multipliers: Array
    mean: float
    length: float = 1.0

    @classmethod
    def of(cls, start: Evaluation) -> "Barrier":
        """Return the first iterate, inside the bounds with z·(g − g_low) = w·(g_high − g) = μ."""
        low = 1 / start.data.upper
        high = 1 / start.data.lower
        conductance = 1 / start.cell_resistance
        margin = np.minimum(START_MARGIN * np.median(conductance), (high - low) / 50)
        at = start.elsewhere(1 / np.clip(conductance, low + margin, high - margin))
        bare = cls(at, np.zeros((2, *low.shape)), 0.0)
        mean = 0.1 * float(
            np.mean((np.abs(bare.gradient) * bare.distances.min(axis=0))[bare.moving])
        )
        return replace(bare, multipliers=over(mean, bare.distances), mean=mean)

    @cached_property
    def conductance(self) -> Array:
        """Conductances g, (frames, rows, columns) siemens."""
        return 1 / self.at.cell_resistance

    @cached_property
    def distances(self) -> Array:
        """Distances to the bounds (g − g_low, g_high − g), (2, frames, rows, columns) siemens."""
        data = self.at.data
        return np.stack([self.conductance - 1 / data.upper, 1 / data.lower - self.conductance])

    @property
    def moving(self) -> Mask:
        """Whether the bounds of a cell differ, boolean (frames, rows, columns)."""
        return self.at.data.lower < self.at.data.upper

    @cached_property
    def hessian(self) -> Hessian:
        """Derivatives of φ in u = log r."""
        return Hessian(self.at, Smoothing.start(self.at))

    @cached_property
    def gradient(self) -> Array:
        """Gradient ∂φ/∂g = −(∂φ/∂u)/g, (frames, rows, columns)."""
        return -self.hessian.gradient.reshape(self.conductance.shape) / self.conductance

    @property
    def added(self) -> float:
        """Complementarity Σ z·(g − g_low) + w·(g_high − g), which estimates the barrier's cost."""
        return float(np.sum(self.multipliers * self.distances))

    @property
    def stiffness(self) -> Array:
        """Second derivative z/(g − g_low) + w/(g_high − g) of the barrier; zero for fixed cells."""
        return np.asarray(over(self.multipliers, self.distances).sum(axis=0))

    def merit(self, mean: float) -> float:
        """Return the barrier function φ − μ Σ log(g − g_low) − μ Σ log(g_high − g).

        The function is infinite outside the bounds.
        """
        distances = self.distances[:, self.moving]
        if not np.all(distances > 0):
            return float("inf")
        return self.at.objective - mean * float(np.log(distances).sum())

    def advanced(self) -> "Barrier | None":
        """Return the iterate after one step; None if no step lowers the barrier function."""
        mean = self.mean * (BARRIER_REDUCTION if self.length > 0.5 else 1.0)
        # −∇ of the barrier function: −∂φ/∂g + μ/(g − g_low) − μ/(g_high − g)
        push = (SIDES * over(mean, self.distances)).sum(axis=0) - self.gradient
        step = self.newton_step(push)
        length = reach(self.distances, SIDES * step)
        # Backtracking until the barrier function falls by a share of the predicted decrease.
        current = self.merit(mean)
        slope = SUFFICIENT_DECREASE * np.sum(push * step)

        def lower(share: float) -> Barrier | None:
            conductance = self.conductance + share * length * step
            try:
                trial = Barrier(self.at.elsewhere(1 / conductance), push, mean, share * length)
                return trial if trial.merit(mean) <= current - slope * trial.length else None
            except np.linalg.LinAlgError:
                return None

        trial = backtracked(lower, MAX_LENGTHS)
        if trial is None:
            return None
        # δz = (μ − z·δg)/(g − g_low) − z, δw = (μ + w·δg)/(g_high − g) − w, as far as they stay
        # positive
        change = over(mean - self.multipliers * SIDES * step, self.distances) - self.multipliers
        share = reach(self.multipliers, change)
        return replace(
            trial,
            multipliers=self.multipliers + share * change,
            length=min(share, trial.length),
        )

    def newton_step(self, push: Array) -> Array:
        """Return the step (∂²φ/∂g² + stiffness)⁻¹·push.

        The Gauss–Newton matrix replaces ∂²φ/∂g² if the sum is indefinite. Conjugate gradients solve
        for relative steps δg/g, whose Hessian is ∇²φ + diag(∇φ) + stiffness·g².
        """
        chosen = np.flatnonzero(self.moving)
        stiff = (self.stiffness * self.conductance**2).ravel()
        slope = -(push * self.conductance).ravel()[chosen]
        step = np.zeros(push.size)
        solve = self._dense if self.hessian.dense else self._sparse
        step[chosen] = solve(chosen, stiff, slope)
        return step.reshape(push.shape) * self.conductance

    def _dense(self, chosen: Numbers, stiff: Array, slope: Array) -> Array:
        """Return the relative step of the chosen cells by Cholesky's factor."""
        hessian = self.hessian
        exact = hessian.matrix + np.diag(hessian.gradient)
        for matrix in (exact, hessian.gauss_newton_matrix):
            factor = Cholesky.of(self.at.cell_resistance, chosen, matrix + np.diag(stiff))
            if factor is not None:
                return -factor.solve(slope)
        return np.full(len(chosen), np.nan)

    def _sparse(self, chosen: Numbers, stiff: Array, slope: Array) -> Array:
        """Return the relative step of the chosen cells by conjugate gradients."""
        hessian = self.hessian
        free = self.moving.ravel()
        penalties = sparse.csr_array(hessian.penalty_matrix + sparse.diags_array(stiff))
        precondition = TwoLevel.of(hessian, penalties).over(free, self.at.cell_resistance)
        # Accuracy grows as the barrier's share shrinks: residuals of cells at bounds hide those of
        # the others (docs/studies/speed.md).
        accuracy = ACCURACY * min(1.0, self.added / self.at.objective) ** 0.25
        distances = (self.distances / self.conductance).reshape(2, -1)[:, chosen]

        def admits(step: Array) -> bool:
            return reach(distances, SIDES[:, 0, 0] * step) >= MIN_STEP

        def exact(step: Array) -> Array:
            return hessian.product(step) + (stiff + hessian.gradient) * step

        def gauss_newton(step: Array) -> Array:
            return hessian.gauss_newton_product(step) + stiff * step

        for product in (exact, gauss_newton):
            part = restricted(product, chosen, free.size)
            solved = steihaug(part, precondition, slope, accuracy, admits=admits)
            if not solved.negative:
                break
        return solved.step

    def put_at_bounds(self) -> Evaluation:
        """Return the evaluation with cells moved to their bounds.

        A cell is moved to a bound if the curvature of the bound's barrier exceeds the cell's own.
        """
        data = self.at.data
        # The multiplier exceeds the curvature of the cell's own reading and penalties in the
        # conductance: z/(g − g_low) > ∂²φ/∂g²
        curvature = self.hessian.diagonal.reshape(self.conductance.shape) / self.conductance**2
        below, above = over(self.multipliers, self.distances) > curvature
        cells = np.where(below, data.upper, self.at.cell_resistance)
        return self.at.elsewhere(np.where(above, data.lower, cells))
