"""Posterior covariance of log r in closed form, as matrices over the cells.

With A = Jᵀ Ω J + Zᵀ Ω Z + ε s² over the free cells (J: data, Z: penalties) and the gain K = A⁻¹ Jᵀ Ω, the error of the
estimate is K·noise plus what the penalties pull it away from the truth:

    S = K (τ² + V Vᵀ) Kᵀ + A⁻¹ (s² Zᵀ (C − B) Ω Z + Zᵀ H² Z + W Wᵀ + ε s⁴) A⁻¹ + (A⁻¹ M) S₀ (A⁻¹ M)ᵀ,   M = Zᵀ Ω Z₀

where V is what one chance moves together in a frame, W = σ λ Zᵀ ½ρ' what a chosen weight's uncertainty does (Wood,
Pya & Säfken, J. Am. Stat. Assoc. 111, 2016), and S₀ is the error of the previous frame and of the baseline, as
far as terms read them. With C = 1 and one noise for all data this is the Laplace approximation s² A⁻¹. B is the share
of a residual's variance that is the previous frame's error where a term weighs that (Joseph's form).
A penalty that does not suit the data must not leave narrow bars: C of a penalised residual x̂ is the largest of 1,
of ω x̂²/s², and of Σ ω x̂²/(s² γ) over its term, of whose residuals data determine γ. H is what a loss pulls beyond its
curvature.
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
    """Errors of the last estimate and of the baseline, as the next frame needs them."""

    last: Array
    baseline: Array

    @abstractmethod
    def resting(self) -> Self:
        """Return the same, with the last estimate as the baseline."""

    @abstractmethod
    def shared(self) -> Array:
        """Covariance of the two, cell by cell."""

    @abstractmethod
    def variance(self) -> Array:
        """Return the variance of the last estimate, (cells)."""


@dataclass(frozen=True, eq=False)
class DenseMemory(Memory):
    """Covariances of log r, (cells, cells): of the last estimate, of the baseline, and of both."""

    with_baseline: Array

    def resting(self) -> Self:
        return replace(self, baseline=self.last, with_baseline=self.last)

    def shared(self) -> Array:
        return np.asarray(np.diag(self.with_baseline))

    def variance(self) -> Array:
        return np.asarray(np.diag(self.last))

    def both(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Return the blocks of the last estimate and of the baseline."""
        return (self.last, self.with_baseline), (self.with_baseline.T, self.baseline)


@dataclass(frozen=True, eq=False)
class DenseErrors:
    """Errors of an estimate as matrices over the cells.

    Attributes
    ----------
    model : LinearModel
        The estimate's surroundings.
    before : object
        What is known of the previous frame's error, if it is read.
    drawn : array or None
        V (data rows, n), what one chance moves together in the frames that are solved; None: each reading alone errs.
    """

    model: LinearModel
    before: Any = None
    drawn: Array | None = None

    @cached_property
    def sensitivity(self) -> Array:
        """∂x/∂u of the data (rows, frames · cells)."""
        through = block_diagonal([network.sensitivity() for network in self.model.at.networks])
        return np.asarray(self.model.through @ through)

    @cached_property
    def jacobian(self) -> Array:
        """J (data rows, free)."""
        return np.asarray(self._of_free(self.sensitivity))

    def forward(self, change: Array) -> Array:
        """J p of changes (cells, n)."""
        return np.asarray(self.sensitivity @ change)

    def weighed(self, rows: Array) -> Array:
        """Jᵀ Ω x of rows of the data (rows, n), (cells, n)."""
        return np.asarray(self.sensitivity.T @ (self.model.data_curvature[:, None] * rows))

    def solved(self, right: Array) -> Array:
        """A⁻¹ x of (free, n)."""
        return np.asarray(self.inverse @ right)

    def gained(self, rows: Array, *, fine: bool = False) -> Array:
        """K x of rows of the data; fine : of what is reported itself."""
        return np.asarray(self._gain @ rows)

    @cached_property
    def _sparse_penalties(self) -> sparse.csc_array:
        """√Ω Z."""
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
        """A⁻¹ (free, free). Raises numpy.linalg.LinAlgError where A is not positive definite."""
        if not len(self.model.free):
            return np.zeros((0, 0))
        matrix = blas.dsyrk(1.0, (self.jacobian * np.sqrt(self.model.data_curvature)[:, None]).T)
        if len(self.model.penalty_term):
            matrix += self._sparse_penalties.T @ self._penalties
        matrix[np.diag_indices(len(matrix))] += self.model.ignorance * self.model.scale
        return positive_inverse(matrix)

    @cached_property
    def _gain(self) -> Array:
        """K (free, data rows)."""
        return self.inverse @ (self.jacobian.T * self.model.data_curvature)

    @cached_property
    def _pulls(self) -> Array:
        """A⁻¹ Zᵀ √Ω (free, penalty rows)."""
        return np.asarray((self._sparse_penalties @ self.inverse).T)

    @cached_property
    def _held(self) -> Array:
        """A⁻¹ Zᵀ H (free, rows where H is not zero)."""
        beyond = np.flatnonzero(self.model.steady_pull)
        if not len(beyond):
            return np.zeros((len(self.inverse), 0))
        rows = sparse.csr_array(self._of_free(self.model.penalty_jacobian))[beyond]
        return np.asarray((rows @ self.inverse).T * self.model.steady_pull[beyond])

    @cached_property
    def _reweighted(self) -> Array:
        """A⁻¹ σ λ Zᵀ ½ρ' (free, n): what one standard deviation of log λ does to log r."""
        return self.inverse @ self.model.weight_pulls[self.model.free]

    def determined(self, term: int) -> float:
        """γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t), B_t = Z_tᵀ Ω Z_t, B their sum; B⁺ B_t has B_t's rank where that is alone."""
        return self._determined[term]

    @cached_property
    def _determined(self) -> dict[int, float]:
        model, rows = self.model, self._penalties
        used = (rows * self._pulls.T).sum(axis=1)
        numbers = [int(number) for number in np.unique(model.penalty_term)]
        if len(numbers) == 1:
            known = min(rank(model.at.cost.unweighted), len(self.inverse))
            return {numbers[0]: float(known - used.sum())}
        alone = np.einsum("ij,jk,ik->i", rows, np.linalg.pinv(rows.T @ rows, hermitian=True), rows, optimize=True)
        return {number: float((alone - used)[model.penalty_term == number].sum()) for number in numbers}

    @cached_property
    def _carried(self) -> list[tuple[int, Array]]:
        """−A⁻¹ M (free, cells): what errors of the previous frame (0) and of the baseline (1) do to this one."""
        size = np.sqrt(self.model.penalty_curvature)[:, None]
        known = enumerate((self.model.previous_jacobian, self.model.baseline_jacobian))
        return [(which, np.asarray(-self._pulls @ (rows.toarray() * size))) for which, rows in known if rows.nnz]

    @cached_property
    def _parts(self) -> list[tuple[Array, Array]]:
        """(rows, variances) of which S is the sum over rows · variances · rowsᵀ, without the previous frame's."""
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
        """The diagonal of S over the free cells."""
        variance = sum(rows**2 @ size for rows, size in self._parts)
        if self.before is not None:
            for (row, first), (column, second) in product(self._carried, repeat=2):
                variance += np.sum((first @ self.before.both()[row][column]) * second, axis=1)
        return np.asarray(variance)

    @cached_property
    def covariance(self) -> Array:
        """S over all cells (frames · cells)²; zero for those that are not free."""
        covariance = sum((rows * size) @ rows.T for rows, size in self._parts)
        if self.before is not None:
            for (row, first), (column, second) in product(self._carried, repeat=2):
                covariance += first @ self.before.both()[row][column] @ second.T
        whole = np.zeros((self.model.at.cell_resistance.size,) * 2)
        whole[np.ix_(self.model.free, self.model.free)] = covariance
        return whole

    def memory(self) -> Memory:
        """Return what the next frame must know of the last one here; of two frames the first is the baseline."""
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
        """The diagonal of the averaging kernel."""
        return np.asarray(np.einsum("ij,ji->i", self._gain, self.jacobian))

    @cached_property
    def certainty(self) -> Certainty:
        """The certainty without errors that all frames share."""
        shares = self.resolution, self.data_share
        return Certainty.of(self.model, (self.variance, self.shared_variance), shares, self.released)

    @cached_property
    def widening(self) -> Array:
        """C − B of the penalty rows."""
        model = self.model
        squares, widened = model.penalty_squares, least_widening(model)
        for number in np.unique(model.penalty_term):
            own = model.penalty_term == number
            widened[own] = np.maximum(widened[own], squares[own].sum() / max(self.determined(int(number)), 1.0))
        return np.asarray(widened - model.known_share(None if self.before is None else self.before.variance()))

    def reading_deviation(self) -> Array:
        """√diag(F S Fᵀ) of the readings f(r̂), F = ∂f/∂u, (frames, rows, columns): what the cells' errors do to them.

        S without what the baseline's error adds. Of readings that count, s² F A⁻¹ Fᵀ stands for it.
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
        """The part of the variance by which chances of a frame move all its cells alike."""
        size, free = self.model.at.cell_resistance[0].size, self.model.free
        common = np.zeros(len(free))
        if self.drawn is None:
            return common
        answer = self.answer(self.drawn, *np.zeros((2, size, self.drawn.shape[1])))
        for frame in np.unique(free // size):
            common[free // size == frame] = common_variance(answer[free // size == frame])
        return np.asarray(np.minimum(common, self.variance))

    def answer(self, rows: Array, last: Array, baseline: Array) -> Array:
        """Return the effect on log r of errors of the data, (rows, n), that earlier estimates share, (cells, n)."""
        model = self.model
        known = model.previous_jacobian @ last + model.baseline_jacobian @ baseline
        if not known.any():
            return self.gained(rows)
        back = model.penalty_jacobian.T @ (model.penalty_curvature[:, None] * known)
        return self.gained(rows) - self.solved(back[model.free])

    @cached_property
    def data_share(self) -> Array:
        """The row sums of the averaging kernel."""
        everywhere = np.zeros((self.model.at.cell_resistance.size, 1))
        everywhere[self.model.free] = 1.0
        return self.gained(self.forward(everywhere), fine=True)[:, 0]

    def released(self, cells: NDArray[np.intp]) -> Array:
        """Variance of cells (numbers) that stand at a bound if each alone were free among the free ones."""
        model, own = self.model, (cells, np.arange(len(cells)))
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
    """Return (what shared errors z do to log r of the free cells (free, n), the cells at a bound, how far these reach).

    A cell c at a bound stands alone, t_c ~ N(−slope·v, v + |a|²) cut off at t_c ≥ 0, v its variance among the free
    cells, a what z does to it; where |a| > slope·v it moves with the free cells. An open cell's t is its conductance,
    in units of a typical cell's. The reach is that of their intervals into the inside, below and above, in log r.
    rows, last, baseline : z's columns in the data (rows, n), and in earlier estimates (cells, n). Raises LinAlgError if
    flat.
    """
    model = errors.model
    free, cells = model.free, np.flatnonzero(model.at_lower | model.at_upper)
    typical = np.exp(np.log(model.at.cell_resistance).ravel()[free].mean()) if len(free) else 1.0
    stretch = np.where(model.at_upper, np.maximum(model.at.cell_resistance.ravel() / typical, 1.0), 1.0)
    data, penalties = np.sqrt(model.data_curvature)[:, None], np.sqrt(model.penalty_curvature)[:, None]
    stacked = np.vstack([errors.sensitivity * data, model.penalty_jacobian.toarray() * penalties]) * stretch
    carried = model.previous_jacobian @ last + model.baseline_jacobian @ baseline
    moved = np.vstack([rows * data, -carried * penalties])  # √Ω of what z moves of data and penalties
    own, others = stacked[:, cells], stacked[:, free]
    across = errors.inverse @ (others.T @ own)
    left = np.maximum(np.sum(own**2, axis=0) - np.sum((others.T @ own) * across, axis=0), IGNORANCE * model.scale)
    variance = model.scale / left
    slope = np.abs(model.gradient[cells]) * stretch[cells] / (2 * model.scale)
    answer = ((own - others @ across).T @ moved) / left[:, None]
    released = np.sqrt(np.sum(answer**2, axis=1)) > slope * variance
    together = np.concatenate([free, cells[released]])
    matrix = stacked[:, together].T @ stacked[:, together]
    matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
    joint = positive_inverse(matrix) @ (stacked[:, together].T @ moved)
    answer[released] = joint[len(free) :]
    wide = variance + np.sum(answer**2, axis=1)
    reach = one_sided(slope * variance / wide, wide)[1]
    below = np.where(model.at_upper[cells], np.log1p(stretch[cells] * reach), 0.0)
    return joint[: len(free)], cells, below, np.where(model.at_upper[cells], np.inf, reach)


def positive_inverse(matrix: Array) -> Array:
    """A⁻¹ from the upper triangle of A. Raises numpy.linalg.LinAlgError where A is not positive definite."""
    return inverse_and_volume(matrix)[0] if matrix.size else matrix


def inverse_and_volume(matrix: Array) -> tuple[Array, float]:
    """(A⁻¹, log det A⁻¹) from the upper triangle of A. Raises as `positive_inverse`."""
    factor, failed = lapack.dpotrf(matrix)
    inverse, broken = lapack.dpotri(factor)
    if failed or broken or not np.all(np.isfinite(inverse)):
        raise np.linalg.LinAlgError("the cost is flat round the estimate")
    inverse = inverse + inverse.T  # its lower triangle is zero
    inverse[np.diag_indices(len(inverse))] /= 2
    return np.asarray(inverse), -2 * float(np.sum(np.log(np.diag(factor))))


@lru_cache(maxsize=64)
def rank(cost: Cost) -> int:
    """Return the rank of all penalties' Jacobian at cells like any others, whatever bounds take away.

    Of large panels the full rank, which those of penalties nearly have.
    """
    function = residuals(cost).penalties.by_cells
    if function.shape[1] > MAX_DENSE:
        return min(function.shape)
    anywhere = np.random.default_rng(0)
    values = function(*(anywhere.uniform(0.5, 2.0, size) for size in function.sizes))
    jacobian = sparse.csr_array((values, function.pattern), shape=function.shape)
    return int(np.linalg.matrix_rank((jacobian.T @ jacobian).toarray(), hermitian=True))
