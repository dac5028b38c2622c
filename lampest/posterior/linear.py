"""Linear model about an estimate with Gaussian noise and Gaussian penalties, in u = log r.

Residuals are x ≈ x̂ + Z·p with curvature ω, p a change of u, and the cost is Σ ω x². Residuals of data have the noise τ;
all others are penalties. With s² = mean ω τ² over the data, cost/s² is −2·log probability.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.cost.cost import Cost
from lampest.cost.losses import Loss
from lampest.cost.problem import Evaluation, Residuals, residuals
from lampest.files.levels import TWO_SIDED
from lampest.panel.compiled import with_entries
from lampest.panel.panel import Array
from lampest.posterior.interval import LEVEL

NEAR_BOUND = 1e-3  # of log r: distance from a bound within which a cell is at it
IGNORANCE = 1e-4  # prior precision of log r, which regularises cells without data and penalties


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Linear model about an estimate.

    Attributes
    ----------
    at : Evaluation
        Evaluation at the estimate. All vectors below are flat, over (frames · cells) or over rows of residuals.
    dual : array
        Duals of its absolute losses.
    own_error : array or float
        Standard deviation of the error of each reading that is the same in all frames, shape of `Data.measured`, or 0.
    deviation : array or None
        Standard deviation of the readings, shape of `Data.measured`; None for σ of the data.
    weight_sigma : tuple of float
        For every term, the standard deviation of log λ if the data chose its weight, otherwise NaN; () if no weight was
        chosen.
    """

    at: Evaluation
    dual: Array
    own_error: Array | float = field(default=0.0, kw_only=True)
    deviation: Array | None = field(default=None, kw_only=True)
    weight_sigma: tuple[float, ...] = field(default=(), kw_only=True)

    @cached_property
    def gradient(self) -> Array:
        """Gradient ∂φ/∂u, (cells,)."""
        return self.at.log_gradient(self.dual).ravel()

    @cached_property
    def at_lower(self) -> NDArray[np.bool_]:
        """Whether a cell is held at its lower bound by the gradient, boolean (cells,)."""
        near = self._position - self._log_bounds[0] <= NEAR_BOUND
        return near & (self.gradient > 0) & ~self.fixed if near.any() else near

    @cached_property
    def at_upper(self) -> NDArray[np.bool_]:
        """Whether a cell is held at its upper bound by the gradient, boolean (cells,)."""
        near = self._log_bounds[1] - self._position <= NEAR_BOUND
        return near & (self.gradient < 0) & ~self.fixed if near.any() else near

    @cached_property
    def fixed(self) -> NDArray[np.bool_]:
        """Whether the bounds of a cell coincide, boolean (cells,)."""
        return (self.at.data.lower >= self.at.data.upper).ravel()

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Numbers of the cells that no bound holds."""
        return np.flatnonzero(~(self.at_lower | self.at_upper | self.fixed))

    @cached_property
    def ignorance(self) -> Array:
        """Prior precision ε of log r, (free,); 12/ln²(upper/lower) for cells that were not read."""
        lower, upper = (bound[self.free] for bound in self._log_bounds)
        # Variance of a uniform distribution over the bounds: ln²(upper/lower)/12
        within = 12 / np.maximum(upper - lower, NEAR_BOUND) ** 2
        return np.asarray(np.where(self.unread, np.maximum(within, IGNORANCE), IGNORANCE))

    @cached_property
    def unread(self) -> NDArray[np.bool_]:
        """Whether a cell's own reading is missing, boolean (free,)."""
        if not self.at.data.partial:
            return np.zeros(len(self.free), dtype=bool)
        seen = np.broadcast_to(self.at.data.given.seen, self.at.cell_resistance.shape).ravel()
        return np.asarray(seen[self.free] == 0)

    @cached_property
    def _position(self) -> Array:
        return np.log(self.at.cell_resistance).ravel()

    @cached_property
    def _log_bounds(self) -> tuple[Array, Array]:
        lower, upper = self.at.data.log_bounds
        return lower.ravel(), upper.ravel()

    @cached_property
    def _residuals(self) -> Residuals:
        return residuals(self.at.cost)

    @cached_property
    def through(self) -> sparse.csc_array:
        """Derivative ∂x/∂y of the data by the readings, sparse (data rows, cells)."""
        return self._residuals.data.jacobian("by_model", self.at)

    @cached_property
    def noise(self) -> Array:
        """Standard deviations τ of the data, (data rows,)."""
        return self._of_rows(self._deviation)

    @property
    def _deviation(self) -> Array:
        return self.at.data.deviation if self.deviation is None else self.deviation

    def _of_rows(self, deviation: Array) -> Array:
        return np.asarray(np.sqrt(_squares(self.through) @ deviation.ravel() ** 2))

    @cached_property
    def data_curvature(self) -> Array:
        """Curvature ω of the data, (data rows,); zero for rows of missing or one-sided readings."""
        side = self.at.data.given.side
        curvature: Array = self.at.weights[self._residuals.data.term] * (self.noise > 0)
        if side is not None and np.any(side):
            curvature = curvature * ~(abs(self.through) @ np.abs(side.ravel()) > 0)
        for _, loss, rows in curved_rows(self.at.cost, self._residuals.data.term):
            curvature[rows] *= loss.data_curvature(self.residual[rows], self.noise[rows])
        return curvature

    @cached_property
    def residual(self) -> Array:
        """Residuals x̂ of the data, (data rows,)."""
        return self._residuals.data.values(self.at)

    @cached_property
    def scale(self) -> float:
        """Scale s² = mean ω τ² over the data with curvature; τ includes the error that is the same in all frames."""
        seen = self.data_curvature > 0
        off = np.hypot(self._deviation, self.own_error) if np.any(self.own_error) else None
        noise = self.noise if off is None else self._of_rows(off)
        return float(np.mean(self.data_curvature[seen] * noise[seen] ** 2)) if seen.any() else 1.0

    @cached_property
    def penalty(self) -> Array:
        """Residuals x̂ of the penalties, (penalty rows,)."""
        return self._residuals.penalties.values(self.at)

    @property
    def penalty_squares(self) -> Array:
        """Squares ω x̂²/s² of the penalties, (penalty rows,)."""
        return np.asarray(self.penalty_curvature * self.penalty**2 / self.scale)

    @cached_property
    def penalty_term(self) -> NDArray[np.intp]:
        """Number of the term of every penalty row."""
        return self._residuals.penalties.term

    @cached_property
    def penalty_curvature(self) -> Array:
        """Curvature ω of the penalties, (penalty rows,)."""
        return penalty_curvature_of(self, self.at.weights)

    @cached_property
    def weight_pulls(self) -> Array:
        """W = σ λ Zᵀ ½ρ'(x̂), (cells, n), of the n terms whose weights the data chose.

        A column is the change of half the gradient for one standard deviation σ of log λ. Without it, 95 % intervals
        cover 81 to 83 % of the cells where the noise is as large as the prior (docs/studies/calibration.md).
        """
        slopes = [np.zeros((0, len(self.penalty_term)))]
        for number, sigma in enumerate(self.weight_sigma):
            rows = self.penalty_term == number
            if np.isfinite(sigma) and rows.any():
                loss, residual = self.at.cost.terms[number].loss, self.penalty
                slope = self.at.weights[number] * loss.stiffness(residual) * residual
                slopes.append(np.where(rows, sigma * slope, 0.0)[None])
        return np.asarray(self.penalty_jacobian.T @ np.concatenate(slopes).T)

    @cached_property
    def steady_pull(self) -> Array:
        """H of the penalties, (penalty rows,): half the slope ∂φ/∂x beyond ω x̂; see `Loss.steady_pull`."""
        pull = np.zeros(len(self.penalty_term))
        for number, loss, rows in curved_rows(self.at.cost, self.penalty_term):
            pull[rows] = self.at.weights[number] * loss.steady_pull(self.penalty[rows])
        return pull

    @cached_property
    def penalty_jacobian(self) -> sparse.csc_array:
        """Z, the derivative ∂x/∂u of the penalties, sparse (penalty rows, cells)."""
        jacobian = self._residuals.penalties.jacobian("by_cells", self.at)
        # ∂x/∂u = (∂x/∂r)·diag(r), entry by entry of the sparse columns
        cells = np.repeat(self.at.cell_resistance.ravel(), np.diff(jacobian.indptr))
        return with_entries(jacobian, jacobian.data * cells)

    @cached_property
    def previous_jacobian(self) -> sparse.csc_array:
        """Derivative ∂x/∂u₀ of the penalties, u₀ = log r of the previous frame, sparse (penalty rows, cells)."""
        return self._known_jacobian("by_previous", self.at.data.given.previous)

    @cached_property
    def baseline_jacobian(self) -> sparse.csc_array:
        """Derivative ∂x/∂u₀ of the penalties, u₀ = log r of the baseline, sparse (penalty rows, cells)."""
        return self._known_jacobian("by_baseline", self.at.data.given.baseline)

    def known_share(self, variance: Array | None) -> Array:
        """Return B, the previous frame's share of every penalty row's variance, (penalty rows,).

        It is zero for terms that do not weigh the previous frame's error. `variance` is that of the previous frame's
        log r, (cells,), or None.
        """
        weighing = [number for number, term in enumerate(self.at.cost.terms) if term.weighs_previous]
        if variance is None or not weighing:
            return np.zeros(len(self.penalty_term))
        share = np.minimum(_squares(self.previous_jacobian) @ variance, 1.0)
        return np.where(np.isin(self.penalty_term, weighing), share, 0.0)

    def _known_jacobian(self, name: str, cells: Array | None) -> sparse.csc_array:
        jacobian = self._residuals.penalties.jacobian(name, self.at)
        if cells is None or not jacobian.nnz:
            return jacobian
        return sparse.csc_array(jacobian @ sparse.diags_array(cells.ravel()))


def penalty_curvature_of(model: LinearModel, weights: Array) -> Array:
    """Return the curvature ω of the penalties for given weights (terms,), (penalty rows,)."""
    curvature: Array = weights[model.penalty_term]
    for number, loss, rows in curved_rows(model.at.cost, model.penalty_term):
        curvature[rows] *= loss.penalty_curvature(model.penalty[rows], weights[number], model.scale)
    return curvature


def curved_rows(cost: Cost, term: NDArray[np.intp]) -> Iterator[tuple[int, Loss, NDArray[np.bool_]]]:
    """Yield (number, loss, boolean rows) of every term whose loss is not squared, where ω is not the weight alone.

    `term` contains the number of the term of every row.
    """
    for number, part in enumerate(cost.terms):
        if not part.loss.squared and (rows := term == number).any():
            yield number, part.loss, rows


def least_widening(model: LinearModel) -> Array:
    """Return the least widening C of every penalty row, max(1, ω x̂²/s²); see `lampest.posterior.dense`.

    Residuals of a cell without a reading are no evidence: they are assumed as large as the 95 % quantile of the other
    residuals of the term.
    """
    squares, cells = model.penalty_squares, np.zeros(model.at.cell_resistance.size)
    widened = np.maximum(1.0, squares)
    if not model.unread.any():
        return widened
    cells[model.free[model.unread]] = 1.0
    unread = abs(model.penalty_jacobian) @ cells > 0
    for number in np.unique(model.penalty_term):
        own = model.penalty_term == number
        if (others := own & ~unread).any():
            far = np.quantile(squares[others], LEVEL, method="higher") / TWO_SIDED**2
            widened[own & unread] = np.maximum(widened[own & unread], far)
    return widened


def _squares(rows: sparse.csc_array) -> sparse.csc_array:
    """Return the squares of the entries of a sparse matrix."""
    return with_entries(rows, rows.data**2)
