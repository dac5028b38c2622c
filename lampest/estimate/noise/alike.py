"""The size of readings' own errors with which the unloaded cells are alike, by marginal likelihood.

A reading's own error e moves cells by up to (M + N − 1)/2 · e in log r, one against its neighbours. So large an error
is told by the unloaded panel alone, if its cells scatter about one value without an order, log r ~ N(μ, s²):

    −2 log p(y | e, s) ≈ Σ (y − f(u))²/τ² + Σ (u − ū)²/s² + log |A| + Σ log τ² + (m − 1) log s²,   τ² = σ² + (e y')²

at the u that is most probable (Laplace), A its curvature, y' the reading's derivative by its recorded value's
logarithm. e and s are taken on grids, both with equal odds for equal ratios. Where cells are not alike, e comes out
too large rather than too small.
"""

from dataclasses import dataclass

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.estimate.model_check.cells_fit import cells_alone
from lampest.panel.hidden import hidden_columns
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic
from lampest.recording.readings import Readings

SIZES = tuple(float(size) for size in np.geomspace(5e-4, 0.3, 22))
SCATTERS = (0.03, 0.1, 0.2, 0.4)  # s: films of one batch scatter by a tenth, worn ones by 0.4
UNSEEN = 1e12  # times σ, of a reading that says nothing, or one side only
FIT = LevenbergMarquardt(evaluations=25, settled=5e-3, damping=0.0, longest=1.5)


@dataclass(frozen=True, eq=False)
class Alike:
    """cost : −2 log p(y | e) of SIZES, the least of them 0."""

    cost: Array

    @classmethod
    def of(cls, scene: Scene, resting: Readings) -> "Alike":
        """Of the mean of the unloaded frames (rows, columns), with its σ. Raises what arithmetic does."""
        assert resting.sigma is not None
        data = cells_alone().data(resting.alone(), Background(scene))
        columns = hidden_columns(resting.value, resting.value, scene, Systematic(reading_error=1.0))
        share = np.abs(columns).sum(axis=0)
        plain = (resting.seen > 0) & (resting.side == 0)
        costs = np.empty((len(SIZES), len(SCATTERS)))
        for column, spread in enumerate(SCATTERS):
            cells = np.log(data.uniform_start[0])
            for row in reversed(range(len(SIZES))):
                deviation = np.where(plain, np.hypot(resting.sigma, SIZES[row] * share), UNSEEN * resting.sigma)
                cells, costs[row, column] = most_probable(data, resting.value, deviation, spread, cells)
        together = -2 * np.logaddexp.reduce(-costs / 2, axis=1)
        return cls(together - together.min())

    @property
    def size(self) -> float:
        """√E[e²]: wider where the size is uncertain."""
        weight = np.exp(-self.cost / 2)
        return float(np.sqrt(weight @ np.square(SIZES) / weight.sum()))

    def contradicts(self, size: float) -> float:
        """−2 log likelihood that a larger error gains over this one; 0 where the most likely one is not larger."""
        best = int(np.argmin(self.cost))
        return float(np.interp(size, SIZES, self.cost)) if size < SIZES[best] else 0.0


def most_probable(data: Data, value: Array, deviation: Array, spread: float, start: Array) -> tuple[Array, float]:
    """(u (rows, columns), −2 log p(y | e, s)) from readings and their τ."""
    count = value.size
    unlike = (np.eye(count) - 1 / count) / spread
    free = data.lower[0] < data.upper[0]
    lower, upper = (
        np.where(free, far, bound[0]).ravel() for far, bound in zip((-np.inf, np.inf), data.log_bounds, strict=True)
    )

    def model(cells: Array) -> SumOfSquares:
        network = data.network(0, np.exp(cells).reshape(value.shape))
        missed = ((network.reading() - value) / deviation).ravel()
        jacobian = network.sensitivity() / deviation.reshape(-1, 1) * free.ravel()
        return SumOfSquares(np.concatenate([missed, unlike @ cells]), np.vstack([jacobian, unlike]))

    found = FIT.minimum(model, start.ravel(), (lower, upper))
    curvature = np.linalg.slogdet(found.at.normal)[1]
    prior = 2 * np.log(deviation).sum() + 2 * (count - 1) * np.log(spread)
    return found.position.reshape(value.shape), 2 * found.at.cost + curvature + prior
