"""The surroundings of an estimate as a linear model with Gaussian noise and Gaussian penalties, in u = log r.

Residuals are x ≈ x̂ + Z·p with curvature ω, data with noise τ, all others penalties: the cost is Σ ω x². With s² = mean
ω τ² over the data, cost/s² stands for −2·log probability.
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

NEAR_BOUND = 1e-3  # in log r
IGNORANCE = 1e-4  # precision of log r where neither data nor penalties say anything


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Linear model about an estimate.

    Attributes
    ----------
    at : Evaluation
        The estimate.
    dual : array
        Of its absolute losses. All vectors are flat over (frames · cells) or over rows.
    own_error : array or float
        Standard deviation of what each reading is off by in all frames, as `Data.measured`, or 0.
    deviation : array or None
        Standard deviation of the readings, the same shape; None: that of the data, σ.
    weight_sigma : tuple of float
        Of every term the standard deviation of log λ where the data chose its weight, else NaN; (): none was chosen.
    """

    at: Evaluation
    dual: Array
    own_error: Array | float = field(default=0.0, kw_only=True)
    deviation: Array | None = field(default=None, kw_only=True)
    weight_sigma: tuple[float, ...] = field(default=(), kw_only=True)

    @cached_property
    def gradient(self) -> Array:
        """∂φ/∂u."""
        return self.at.log_gradient(self.dual).ravel()

    @cached_property
    def at_lower(self) -> NDArray[np.bool_]:
        """Cells that press against their lower bound."""
        near = self._position - self._log_bounds[0] <= NEAR_BOUND
        return near & (self.gradient > 0) & ~self.fixed if near.any() else near

    @cached_property
    def at_upper(self) -> NDArray[np.bool_]:
        """Cells that press against their upper bound."""
        near = self._log_bounds[1] - self._position <= NEAR_BOUND
        return near & (self.gradient < 0) & ~self.fixed if near.any() else near

    @cached_property
    def fixed(self) -> NDArray[np.bool_]:
        """Cells that bounds leave no choice."""
        return (self.at.data.lower >= self.at.data.upper).ravel()

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """The numbers of all other cells."""
        return np.flatnonzero(~(self.at_lower | self.at_upper | self.fixed))

    @cached_property
    def ignorance(self) -> Array:
        """(free) precision of log r without data or penalties; of unread cells 12/ln²(upper/lower)."""
        lower, upper = (bound[self.free] for bound in self._log_bounds)
        within = 12 / np.maximum(upper - lower, NEAR_BOUND) ** 2
        return np.asarray(np.where(self.unread, np.maximum(within, IGNORANCE), IGNORANCE))

    @cached_property
    def unread(self) -> NDArray[np.bool_]:
        """(free) whether a cell's own reading says nothing."""
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
        """∂x/∂y of the data."""
        return self._residuals.data.jacobian("by_model", self.at)

    @cached_property
    def noise(self) -> Array:
        """τ of the data."""
        return self._of_rows(self._deviation)

    @property
    def _deviation(self) -> Array:
        return self.at.data.deviation if self.deviation is None else self.deviation

    def _of_rows(self, deviation: Array) -> Array:
        return np.asarray(np.sqrt(_squares(self.through) @ deviation.ravel() ** 2))

    @cached_property
    def data_curvature(self) -> Array:
        """ω of the data; zero where a row is missing, and where it reads what only bounds the truth."""
        side = self.at.data.given.side
        curvature: Array = self.at.weights[self._residuals.data.term] * (self.noise > 0)
        if side is not None and np.any(side):
            curvature = curvature * ~(abs(self.through) @ np.abs(side.ravel()) > 0)
        for _, loss, rows in curved_rows(self.at.cost, self._residuals.data.term):
            curvature[rows] *= loss.data_curvature(self.residual[rows], self.noise[rows])
        return curvature

    @cached_property
    def residual(self) -> Array:
        """x̂ of the data."""
        return self._residuals.data.values(self.at)

    @cached_property
    def scale(self) -> float:
        """s², with each reading's own error in τ."""
        seen = self.data_curvature > 0
        off = np.hypot(self._deviation, self.own_error) if np.any(self.own_error) else None
        noise = self.noise if off is None else self._of_rows(off)
        return float(np.mean(self.data_curvature[seen] * noise[seen] ** 2)) if seen.any() else 1.0

    @cached_property
    def penalty(self) -> Array:
        """x̂ of the penalties."""
        return self._residuals.penalties.values(self.at)

    @property
    def penalty_squares(self) -> Array:
        """ω x̂²/s² of the penalties."""
        return np.asarray(self.penalty_curvature * self.penalty**2 / self.scale)

    @cached_property
    def penalty_term(self) -> NDArray[np.intp]:
        """The number of the term that every penalty row belongs to."""
        return self._residuals.penalties.term

    @cached_property
    def penalty_curvature(self) -> Array:
        """ω of the penalties."""
        return penalty_curvature_of(self, self.at.weights)

    @cached_property
    def weight_pulls(self) -> Array:
        """σ λ Zᵀ ½ρ'(x̂) (cells, n) of the terms whose weights the data chose: how the slope varies with log λ."""
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
        """H of the penalties: what pulls at the estimate beyond ω x̂, as half of ∂φ/∂x; see `Loss.steady_pull`."""
        pull = np.zeros(len(self.penalty_term))
        for number, loss, rows in curved_rows(self.at.cost, self.penalty_term):
            pull[rows] = self.at.weights[number] * loss.steady_pull(self.penalty[rows])
        return pull

    @cached_property
    def penalty_jacobian(self) -> sparse.csc_array:
        """∂x/∂u of the penalties."""
        jacobian = self._residuals.penalties.jacobian("by_cells", self.at)
        cells = np.repeat(self.at.cell_resistance.ravel(), np.diff(jacobian.indptr))
        return with_entries(jacobian, jacobian.data * cells)

    @cached_property
    def previous_jacobian(self) -> sparse.csc_array:
        """∂x/∂u₀ of the penalties, u₀ = log of the previous frame's cells."""
        return self._known_jacobian("by_previous", self.at.data.given.previous)

    @cached_property
    def baseline_jacobian(self) -> sparse.csc_array:
        """The same for the baseline's cells."""
        return self._known_jacobian("by_baseline", self.at.data.given.baseline)

    def known_share(self, variance: Array | None) -> Array:
        """Return the previous frame's share of every penalty row's variance, where its term weighs that."""
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
    """ω of the penalties for any weights."""
    curvature: Array = weights[model.penalty_term]
    for number, loss, rows in curved_rows(model.at.cost, model.penalty_term):
        curvature[rows] *= loss.penalty_curvature(model.penalty[rows], weights[number], model.scale)
    return curvature


def curved_rows(cost: Cost, term: NDArray[np.intp]) -> Iterator[tuple[int, Loss, NDArray[np.bool_]]]:
    """Return number, loss and rows of `term` of all terms whose loss is not squared: there ω is not the weight."""
    for number, part in enumerate(cost.terms):
        if not part.loss.squared and (rows := term == number).any():
            yield number, part.loss, rows


def least_widening(model: LinearModel) -> Array:
    """C of every penalty row, at least: the largest of 1 and ω x̂²/s²; see `lampest.posterior.dense`.

    On a cell that was not read x̂ is no evidence: its rows are taken to deviate as much as 95 % of its term's others.
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
    """Element by element."""
    return with_entries(rows, rows.data**2)
