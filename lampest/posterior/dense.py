"""Posterior covariance of log r in closed form, as matrices over the cells.

With A = Jᵀ Ω J + Zᵀ Ω Z + ε s² over the free cells (J: data, Z: penalties) and the gain K = A⁻¹ Jᵀ Ω, the error of the
estimate is K·noise plus the bias of the penalties. Its covariance is

    S = K (τ² + V Vᵀ) Kᵀ + A⁻¹ (s² Zᵀ (C − B) Ω Z + Zᵀ H² Z + W Wᵀ + ε s⁴) A⁻¹ + (A⁻¹ M) S₀ (A⁻¹ M)ᵀ,   M = Zᵀ Ω Z₀

with these symbols:

    Ω    diagonal matrix of the curvatures ω of the residuals
    τ    standard deviations of the data
    V    columns of random errors that the readings of a frame share
    W    σ λ Zᵀ ½ρ', the effect of the uncertainty σ of a chosen weight's log λ (Wood, Pya & Säfken, J. Am. Stat.
         Assoc. 111, 2016)
    S₀   covariance of the previous frame and of the baseline, as far as terms read them
    B    share of a penalty residual's variance that is the previous frame's error, where a term weighs that error
         (Joseph's form)
    C    widening of a penalty residual x̂: the largest of 1, of ω x̂²/s², and of Σ ω x̂²/(s² γ) over its term, γ the
         number of residuals of the term that the data determine. A penalty that does not suit the data therefore does
         not lead to narrow error bars.
    H    slope of a penalty's loss beyond that of its curvature

With C = 1 and equal noise of all data, S is the Laplace approximation s² A⁻¹.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import blas, lapack

from lampest.cost.cost import Cost
from lampest.cost.problem import residuals
from lampest.panel.compiled import with_entries
from lampest.panel.panel import Array
from lampest.panel.trust_region import MAX_DENSE
from lampest.posterior.certainty import Certainty, common_variance
from lampest.posterior.interval import one_sided
from lampest.posterior.linear import IGNORANCE, LinearModel, least_widening
from lampest.solvers.hessian import block_diagonal


@dataclass(frozen=True, eq=False)
class Memory(ABC):
    """Errors of log r of the last estimate and of the baseline, for the error bars of the next frame."""

    last: Array
    baseline: Array

    @abstractmethod
    def resting(self) -> Self:
        """Return the memory with the last estimate as the baseline."""

    @abstractmethod
    def shared(self) -> Array:
        """Return the covariance of the last estimate and the baseline, cell by cell, (cells,)."""

    @abstractmethod
    def variance(self) -> Array:
        """Return the variance of the last estimate, (cells,)."""


@dataclass(frozen=True, eq=False)
class DenseMemory(Memory):
    """Covariances of log r as matrices.

    Attributes
    ----------
    last, baseline : array, shape (cells, cells)
        Covariance of the last estimate, and of the baseline.
    with_baseline : array, shape (cells, cells)
        Covariance between the last estimate (rows) and the baseline (columns).
    """

    with_baseline: Array

    def resting(self) -> Self:
        return replace(self, baseline=self.last, with_baseline=self.last)

    def shared(self) -> Array:
        return np.asarray(np.diag(self.with_baseline))

    def variance(self) -> Array:
        return np.asarray(np.diag(self.last))

    def both(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Return the joint covariance S₀ of (last estimate, baseline) as 2 × 2 blocks."""
        return (self.last, self.with_baseline), (self.with_baseline.T, self.baseline)


@dataclass(frozen=True, eq=False)
class DenseErrors:
    """Errors of an estimate as matrices over the cells.

    Attributes
    ----------
    model : LinearModel
        Linear model about the estimate.
    before : Memory or None
        Errors of the previous frame and of the baseline, if terms read these.
    drawn : array, shape (data rows, n), or None
        V, random errors that the readings of a frame share; None if the errors of the readings are independent.
    """

    model: LinearModel
    before: Any = None
    drawn: Array | None = None

    @cached_property
    def sensitivity(self) -> Array:
        """Sensitivity ∂x/∂u of the data over all cells, (data rows, frames · cells)."""
        through = block_diagonal([network.sensitivity() for network in self.model.at.networks])
        return np.asarray(self.model.through @ through)

    @cached_property
    def jacobian(self) -> Array:
        """J, the sensitivity over the free cells, (data rows, free)."""
        return np.asarray(self._of_free(self.sensitivity))

    def forward(self, change: Array) -> Array:
        """Return the change of the data, (data rows, n), for changes of log r of all cells, (cells, n)."""
        return np.asarray(self.sensitivity @ change)

    def weighed(self, rows: Array) -> Array:
        """Return Jᵀ Ω x over all cells, (cells, n), for data x (data rows, n)."""
        return np.asarray(self.sensitivity.T @ (self.model.data_curvature[:, None] * rows))

    def solved(self, right: Array) -> Array:
        """Return A⁻¹ x, (free, n)."""
        return np.asarray(self.inverse @ right)

    def gained(self, rows: Array, *, fine: bool = False) -> Array:
        """Return K x, (free, n), for data x (data rows, n); `fine` requests the accuracy of reported values."""
        return np.asarray(self._gain @ rows)

    @cached_property
    def _sparse_penalties(self) -> sparse.csc_array:
        """√Ω Z over the free cells, (penalty rows, free) sparse."""
        rows = self._of_free(self.model.penalty_jacobian)
        return with_entries(rows, rows.data * np.sqrt(self.model.penalty_curvature)[rows.indices])

    @cached_property
    def _penalties(self) -> Array:
        return np.asarray(self._sparse_penalties.toarray())

    def _of_free(self, columns: Any) -> Any:
        free = self.model.free
        return columns if len(free) == columns.shape[1] else columns[:, free]

    @cached_property
    def inverse(self) -> Array:
        """A⁻¹, (free, free). Raises numpy.linalg.LinAlgError if A is not positive definite."""
        if not len(self.model.free):
            return np.zeros((0, 0))
        # A = Jᵀ Ω J + Zᵀ Ω Z + ε s²; dsyrk fills the upper triangle.
        matrix = blas.dsyrk(1.0, (self.jacobian * np.sqrt(self.model.data_curvature)[:, None]).T)
        if len(self.model.penalty_term):
            matrix += self._sparse_penalties.T @ self._penalties
        matrix[np.diag_indices(len(matrix))] += self.model.ignorance * self.model.scale
        return positive_inverse(matrix)

    @cached_property
    def _gain(self) -> Array:
        """Gain K = A⁻¹ Jᵀ Ω, (free, data rows)."""
        return self.inverse @ (self.jacobian.T * self.model.data_curvature)

    @cached_property
    def _pulls(self) -> Array:
        """A⁻¹ Zᵀ √Ω, (free, penalty rows)."""
        return np.asarray((self._sparse_penalties @ self.inverse).T)

    @cached_property
    def _held(self) -> Array:
        """A⁻¹ Zᵀ H, (free, penalty rows where H is not zero)."""
        beyond = np.flatnonzero(self.model.steady_pull)
        if not len(beyond):
            return np.zeros((len(self.inverse), 0))
        rows = sparse.csr_array(self._of_free(self.model.penalty_jacobian))[beyond]
        return np.asarray((rows @ self.inverse).T * self.model.steady_pull[beyond])

    @cached_property
    def _reweighted(self) -> Array:
        """A⁻¹ W = A⁻¹ σ λ Zᵀ ½ρ', (free, n): the change of log r for one standard deviation of log λ."""
        return self.inverse @ self.model.weight_pulls[self.model.free]

    def determined(self, term: int) -> float:
        """Return the number of residuals of a term (number) that the data determine.

        γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t), B_t = Z_tᵀ Ω Z_t, B the sum over terms. For a single term tr(B⁺ B_t) is the rank
        of B_t.
        """
        return self._determined[term]

    @cached_property
    def _determined(self) -> dict[int, float]:
        model, rows = self.model, self._penalties
        # tr(A⁻¹ B_t) = Σ over the rows of term t of diag(√Ω Z A⁻¹ Zᵀ √Ω)
        used = (rows * self._pulls.T).sum(axis=1)
        numbers = [int(number) for number in np.unique(model.penalty_term)]
        if len(numbers) == 1:
            known = min(rank(model.at.cost.unweighted), len(self.inverse))
            return {numbers[0]: float(known - used.sum())}
        # diag(√Ω Z B⁺ Zᵀ √Ω), whose sum over the rows of term t is tr(B⁺ B_t)
        alone = np.einsum("ij,jk,ik->i", rows, np.linalg.pinv(rows.T @ rows, hermitian=True), rows, optimize=True)
        return {number: float((alone - used)[model.penalty_term == number].sum()) for number in numbers}

    @cached_property
    def _carried(self) -> list[tuple[int, Array]]:
        """Pairs of a number and −A⁻¹ M, (free, cells): effect of errors of the previous frame (0), the baseline (1)."""
        size = np.sqrt(self.model.penalty_curvature)[:, None]
        known = enumerate((self.model.previous_jacobian, self.model.baseline_jacobian))
        return [(which, np.asarray(-self._pulls @ (rows.toarray() * size))) for which, rows in known if rows.nnz]

    @cached_property
    def _parts(self) -> list[tuple[Array, Array]]:
        """Pairs (X, variances) with S = Σ X diag(variances) Xᵀ, without the errors of previous frames.

        Every X is (free, n), with n variances.
        """
        model = self.model
        parts = [(self._gain, model.noise**2), (self.inverse, model.scale**2 * model.ignorance)]
        if len(model.penalty_term):
            independent = np.hstack([self._held, self._reweighted])
            parts += [(self._pulls, model.scale * self.widening), (independent, np.ones(independent.shape[1]))]
        if self.drawn is not None:
            parts.append((self._gain @ self.drawn, np.ones(self.drawn.shape[1])))
        return parts

    @cached_property
    def variance(self) -> Array:
        """Diagonal of S, (free,)."""
        variance = sum(rows**2 @ size for rows, size in self._parts)
        if self.before is not None:
            # + (A⁻¹ M) S₀ (A⁻¹ M)ᵀ, block by block of S₀
            for (row, first), (column, second) in product(self._carried, repeat=2):
                variance += np.sum((first @ self.before.both()[row][column]) * second, axis=1)
        return np.asarray(variance)

    @cached_property
    def covariance(self) -> Array:
        """S over all cells, (frames · cells, frames · cells); zero for cells that are not free."""
        covariance = sum((rows * size) @ rows.T for rows, size in self._parts)
        if self.before is not None:
            for (row, first), (column, second) in product(self._carried, repeat=2):
                covariance += first @ self.before.both()[row][column] @ second.T
        whole = np.zeros((self.model.at.cell_resistance.size,) * 2)
        whole[np.ix_(self.model.free, self.model.free)] = covariance
        return whole

    def memory(self) -> Memory:
        """Return the errors of the last frame and of the baseline for the next frame.

        Of two frames that are solved together the first is the baseline.
        """
        size = self.model.at.cell_resistance[0].size
        if len(self.model.at.cell_resistance) == 2:
            whole = self.covariance
            return DenseMemory(whole[size:, size:], whole[:size, :size], whole[size:, :size])
        with_baseline, baseline = np.zeros((2, size, size))
        if self.before is not None:
            baseline = self.before.baseline
            for which, carried in self._carried:
                with_baseline[self.model.free] += carried @ self.before.both()[which][1]
        return DenseMemory(self.covariance, baseline, with_baseline)

    @cached_property
    def resolution(self) -> Array:
        """Diagonal of the averaging kernel K J, (free,)."""
        return np.asarray(np.einsum("ij,ji->i", self._gain, self.jacobian))

    @cached_property
    def certainty(self) -> Certainty:
        """Certainty of the estimate without errors that all frames share."""
        shares = self.resolution, self.data_share
        return Certainty.of(self.model, (self.variance, self.shared_variance), shares, self.released)

    @cached_property
    def widening(self) -> Array:
        """Variance factor C − B of the penalty rows, (penalty rows,)."""
        model = self.model
        squares, widened = model.penalty_squares, least_widening(model)
        for number in np.unique(model.penalty_term):
            own = model.penalty_term == number
            # Σ ω x̂²/(s² γ) over the rows of one term
            widened[own] = np.maximum(widened[own], squares[own].sum() / max(self.determined(int(number)), 1.0))
        return np.asarray(widened - model.known_share(None if self.before is None else self.before.variance()))

    def reading_deviation(self) -> Array:
        """Return the standard deviation √diag(F S Fᵀ) of the modelled readings f(r̂), (frames, rows, columns).

        F = ∂f/∂u, and S excludes the errors of earlier frames. For measured readings S is approximated by s² A⁻¹; only
        for missing ones it is computed.
        """
        model = self.model
        slopes = self._of_free(block_diagonal([network.sensitivity() for network in model.at.networks]))
        variance = model.scale * np.sum((slopes @ self.inverse) * slopes, axis=1)
        if model.at.data.partial:
            missing = np.flatnonzero(np.ravel(model.at.data.given.seen) == 0)
            variance[missing] = sum((slopes[missing] @ rows) ** 2 @ size for rows, size in self._parts)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)).reshape(model.at.cell_resistance.shape))

    @property
    def shared_variance(self) -> Array:
        """Part of the variance due to shared random errors V that moves all cells of a frame alike, (free,)."""
        size, free = self.model.at.cell_resistance[0].size, self.model.free
        common = np.zeros(len(free))
        if self.drawn is None:
            return common
        answer = self.answer(self.drawn, *np.zeros((2, size, self.drawn.shape[1])))
        for frame in np.unique(free // size):
            common[free // size == frame] = common_variance(answer[free // size == frame])
        return np.asarray(np.minimum(common, self.variance))

    def answer(self, rows: Array, last: Array, baseline: Array) -> Array:
        """Return the effect on log r, (free, n), of errors that the data share with earlier estimates.

        Parameters
        ----------
        rows : array, shape (data rows, n)
            Errors of the data.
        last, baseline : array, shape (cells, n)
            Effect of the same errors on log r of the last estimate and of the baseline.
        """
        model = self.model
        # K x − A⁻¹ Zᵀ Ω Z₀ a, a the effect on the earlier estimates
        known = model.previous_jacobian @ last + model.baseline_jacobian @ baseline
        if not known.any():
            return self.gained(rows)
        back = model.penalty_jacobian.T @ (model.penalty_curvature[:, None] * known)
        return self.gained(rows) - self.solved(back[model.free])

    @cached_property
    def data_share(self) -> Array:
        """Row sums of the averaging kernel K J, (free,)."""
        everywhere = np.zeros((self.model.at.cell_resistance.size, 1))
        everywhere[self.model.free] = 1.0
        return self.gained(self.forward(everywhere), fine=True)[:, 0]

    def released(self, cells: NDArray[np.intp]) -> Array:
        """Return the variance of log r of cells (numbers) at a bound, each released alone among the free cells."""
        model, own = self.model, (cells, np.arange(len(cells)))
        # Schur complement of each released cell c: A_cc − A_cf A_ff⁻¹ A_fc, with A = Jᵀ Ω J + Zᵀ Ω Z
        unit = np.zeros((model.at.cell_resistance.size, len(cells)))
        unit[own] = 1.0
        penalised = model.penalty_curvature[:, None] * (model.penalty_jacobian @ unit)
        image = self.weighed(self.forward(unit)) + model.penalty_jacobian.T @ penalised
        across = image[model.free]
        left = image[own] - np.sum(across * self.solved(across), axis=0)
        return np.asarray(model.scale / np.maximum(left, IGNORANCE * model.scale))


def active_bounds(
    errors: DenseErrors, rows: Array, last: Array, baseline: Array
) -> tuple[Array, NDArray[np.intp], Array, Array]:
    """Return the effect of shared errors z on the free cells, and intervals of the cells at a bound.

    The distance t_c of a cell from its bound is distributed as N(−slope·v, v + |a|²) truncated to t_c ≥ 0, with v its
    variance among the free cells and a the effect of z on it. If |a| > slope·v, the cell is released and moves with
    the free cells. For an open cell t_c is the conductance, in units of a typical cell's.

    Parameters
    ----------
    errors : DenseErrors
    rows : array, shape (data rows, n)
        Effect of z on the data.
    last, baseline : array, shape (cells, n)
        Effect of z on log r of the last estimate and of the baseline.

    Returns
    -------
    answer : array, shape (free, n)
        Effect of z on log r of the free cells.
    cells : array of int, shape (k,)
        Numbers of the cells at a bound.
    below, above : array, shape (k,)
        Extent of their 95 % intervals downwards and upwards, in log r.

    Raises numpy.linalg.LinAlgError if the cost is flat.
    """
    model = errors.model
    free, cells = model.free, np.flatnonzero(model.at_lower | model.at_upper)
    # Unknowns: u of cells inside and at a lower bound; conductance over that of a typical cell at an upper bound.
    typical = np.exp(np.log(model.at.cell_resistance).ravel()[free].mean()) if len(free) else 1.0
    stretch = np.where(model.at_upper, np.maximum(model.at.cell_resistance.ravel() / typical, 1.0), 1.0)
    # Whitened rows: A = Xᵀ X with X = (√Ω J; √Ω Z), and their change Y with z; the effect of z is (Xᵀ X)⁻¹ Xᵀ Y.
    data, penalties = np.sqrt(model.data_curvature)[:, None], np.sqrt(model.penalty_curvature)[:, None]
    stacked = np.vstack([errors.sensitivity * data, model.penalty_jacobian.toarray() * penalties]) * stretch
    carried = model.previous_jacobian @ last + model.baseline_jacobian @ baseline
    moved = np.vstack([rows * data, -carried * penalties])
    # Each cell at a bound alone: Schur complement, variance v, slope of −log density, and effect a of z.
    own, others = stacked[:, cells], stacked[:, free]
    across = errors.inverse @ (others.T @ own)
    left = np.maximum(np.sum(own**2, axis=0) - np.sum((others.T @ own) * across, axis=0), IGNORANCE * model.scale)
    variance = model.scale / left
    slope = np.abs(model.gradient[cells]) * stretch[cells] / (2 * model.scale)
    answer = ((own - others @ across).T @ moved) / left[:, None]
    # Cells whose bound z overcomes: solve again with the free ones.
    released = np.sqrt(np.sum(answer**2, axis=1)) > slope * variance
    together = np.concatenate([free, cells[released]])
    matrix = stacked[:, together].T @ stacked[:, together]
    matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
    joint = positive_inverse(matrix) @ (stacked[:, together].T @ moved)
    answer[released] = joint[len(free) :]
    # 95 % quantile of the truncated normal distribution, converted to log r for open cells.
    wide = variance + np.sum(answer**2, axis=1)
    reach = one_sided(slope * variance / wide, wide)[1]
    below = np.where(model.at_upper[cells], np.log1p(stretch[cells] * reach), 0.0)
    return joint[: len(free)], cells, below, np.where(model.at_upper[cells], np.inf, reach)


def positive_inverse(matrix: Array) -> Array:
    """Return A⁻¹ from the upper triangle of A. Raises numpy.linalg.LinAlgError if A is not positive definite."""
    return inverse_and_volume(matrix)[0] if matrix.size else matrix


def inverse_and_volume(matrix: Array) -> tuple[Array, float]:
    """Return (A⁻¹, log det A⁻¹) from the upper triangle of A. Raises as `positive_inverse`."""
    factor, failed = lapack.dpotrf(matrix)
    inverse, broken = lapack.dpotri(factor)
    if failed or broken or not np.all(np.isfinite(inverse)):
        raise np.linalg.LinAlgError("the cost is flat round the estimate")
    inverse = inverse + inverse.T  # its lower triangle is zero
    inverse[np.diag_indices(len(inverse))] /= 2
    return np.asarray(inverse), -2 * float(np.sum(np.log(np.diag(factor))))


def swept(table: Array, place: int) -> Array:
    """Return a table T, (n, m) with m ≥ n, swept by its diagonal entry t_pp; a table of rows in memory is overwritten.

        T ← T − t_·p t_p·/t_pp,   row and column p over |t_pp|,   t_pp ← −1/t_pp

    Source: Goodnight, The American Statistician 33, 1979 (the sweep operator).
    """
    pivot, row, column = table[place, place], table[place].copy(), table[:, place].copy()
    # dger adds in place, in a fifth of the time of np.outer.
    table = blas.dger(-1 / pivot, row, column, a=table.T, overwrite_a=True).T
    table[place], table[:, place], table[place, place] = row / abs(pivot), column / abs(pivot), -1 / pivot
    return table


@lru_cache(maxsize=64)
def rank(cost: Cost) -> int:
    """Return the rank of the Jacobian of all penalties at random cells, without regard to bounds.

    For large panels full rank is returned, which penalties nearly have.
    """
    function = residuals(cost).penalties.by_cells
    if function.shape[1] > MAX_DENSE:
        return min(function.shape)
    anywhere = np.random.default_rng(0)
    values = function(*(anywhere.uniform(0.5, 2.0, size) for size in function.sizes))
    jacobian = sparse.csr_array((values, function.pattern), shape=function.shape)
    return int(np.linalg.matrix_rank((jacobian.T @ jacobian).toarray(), hermitian=True))
