"""Posterior covariance of log r: as matrices over the cells, or from samples in product form.

With A = Jᵀ Ω J + Zᵀ Ω Z + ε s² over the free cells (J: data, Z: penalties) and the gain K = A⁻¹ Jᵀ
Ω, the error of the estimate is K·noise plus the bias of the penalties. Its covariance is

    S = K (τ² + V Vᵀ) Kᵀ + A⁻¹ (s² Zᵀ (C − B) Ω Z + P Pᵀ + ε s⁴) A⁻¹ + (A⁻¹ M) S₀ (A⁻¹ M)ᵀ
    M = Zᵀ Ω Z₀

with these symbols:

    Ω    diagonal matrix of the curvatures ω of the residuals
    τ    standard deviations of the data
    V    columns of random errors that the readings of a frame share
    P    independent errors of half the gradient due to penalties: σ λ Zᵀ ½ρ', the effect of the
         uncertainty σ of a chosen weight's log λ (Wood, Pya & Säfken, J. Am. Stat. Assoc. 111,
         2016), and the slope of a penalty's loss beyond that of its curvature
    S₀   covariance of the previous frame and of the baseline, as far as terms read them
    B    share of a penalty residual's variance that is the previous frame's error, where a term
         weighs that error (Joseph's form)
    C    widening of a penalty residual x̂: the largest of 1, of ω x̂²/s², and of Σ ω x̂²/(s² γ) over
         its term, γ the number of residuals of the term that the data determine. A penalty that
         does not suit the data therefore does not lead to narrow error bars.

With C = 1 and equal noise of all data, S is the Laplace approximation s² A⁻¹.

A sample is ε = A⁻¹ (Jᵀ Ω (τ z₁ + V z₃) + s Zᵀ √((C − B) Ω) z₂ + P z₄ − M ε₀) with standard normal
z. It costs one solve by conjugate gradients. Its covariance is S but for the prior term ε s⁴.
Standard deviations from n samples scatter by 1/√(2n).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import blas, lapack

from lampest.files.levels import TWO_SIDED
from lampest.panel.compiled import with_entries
from lampest.panel.panel import Array
from lampest.panel.trust_region import MAX_DENSE, Linear, steihaug
from lampest.posterior.certainty import Certainty, common_variance
from lampest.posterior.interval import LEVEL, one_sided
from lampest.posterior.linear import IGNORANCE, LinearModel, rank
from lampest.posterior.memory import DenseMemory, Memory, SampledMemory
from lampest.solvers.hessian import Hessian, block_diagonal
from lampest.solvers.preconditioners import TwoLevel
from lampest.solvers.smoothing import Smoothing


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
        V, random errors that the readings of a frame share; None if the errors of the readings are
        independent.
    """

    model: LinearModel
    before: Any = None
    drawn: Array | None = None

    @cached_property
    def sensitivity(self) -> Array:
        """Sensitivity ∂x/∂u of the data over all cells, (data rows, frames · cells)."""
        return np.asarray(self.model.through @ self._readings_by_cells)

    @property
    def _readings_by_cells(self) -> Array:
        return block_diagonal([network.sensitivity() for network in self.model.at.networks])

    @cached_property
    def jacobian(self) -> Array:
        """J, the sensitivity over the free cells, (data rows, free)."""
        return self.sensitivity[:, self.model.free]

    def forward(self, change: Array) -> Array:
        """Return the change of the data, (data rows, n), for changes of log r of all cells.

        The changes of log r have shape (cells, n).
        """
        return np.asarray(self.sensitivity @ change)

    def weighed(self, rows: Array) -> Array:
        """Return Jᵀ Ω x over all cells, (cells, n), for data x (data rows, n)."""
        return np.asarray(self.sensitivity.T @ (self.model.data_curvature[:, None] * rows))

    def solved(self, right: Array, *, fine: bool = False) -> Array:
        """Return A⁻¹ x, (free, n); `fine` requests the accuracy of reported values."""
        return np.asarray(self.inverse @ right)

    def gained(self, rows: Array, *, fine: bool = False) -> Array:
        """Return K x, (free, n), for data x (data rows, n)."""
        return self.solved(self.weighed(rows)[self.model.free], fine=fine)

    @cached_property
    def _rows(self) -> sparse.csc_array:
        """√Ω Z over all cells, (penalty rows, cells) sparse."""
        rows = self.model.penalty_jacobian
        return with_entries(rows, rows.data * np.sqrt(self.model.penalty_curvature)[rows.indices])

    @cached_property
    def _penalties(self) -> Array:
        """√Ω Z over the free cells, (penalty rows, free)."""
        return np.asarray(self._rows[:, self.model.free].toarray())

    @cached_property
    def inverse(self) -> Array:
        """A⁻¹, (free, free). Raises numpy.linalg.LinAlgError if A is not positive definite."""
        # A = Jᵀ Ω J + Zᵀ Ω Z + ε s²; dsyrk fills the upper triangle.
        if not len(self.model.free):
            return np.zeros((0, 0))
        matrix = blas.dsyrk(1.0, (self.jacobian * np.sqrt(self.model.data_curvature)[:, None]).T)
        matrix += self._rows[:, self.model.free].T @ self._penalties
        matrix[np.diag_indices(len(matrix))] += self.model.ignorance * self.model.scale
        return positive_inverse(matrix)

    @cached_property
    def _gain(self) -> Array:
        """Gain K = A⁻¹ Jᵀ Ω, (free, data rows)."""
        return self.inverse @ (self.jacobian.T * self.model.data_curvature)

    @cached_property
    def _pulls(self) -> Array:
        """A⁻¹ Zᵀ √Ω, (free, penalty rows)."""
        return np.asarray((self._rows[:, self.model.free] @ self.inverse).T)

    def determined(self, term: int) -> float:
        """Return the number of residuals of a term (number) that the data determine.

        γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t), B_t = Z_tᵀ Ω Z_t, B the sum over terms. For a single term
        tr(B⁺ B_t) is the rank of B_t.
        """
        of_term = self.model.penalty_term == term
        rows = self._penalties
        # tr(A⁻¹ B_t) = Σ over the rows of term t of diag(√Ω Z A⁻¹ Zᵀ √Ω)
        used = float(np.sum(rows[of_term] * self._pulls.T[of_term]))
        if of_term.all():
            return min(rank(self.model.at.cost.unweighted), len(self.inverse)) - used
        # tr(B⁺ B_t) in the same way
        return float(np.sum((rows[of_term] @ self._penalties_inverse) * rows[of_term])) - used

    @cached_property
    def _penalties_inverse(self) -> Array:
        """B⁺, (free, free)."""
        return np.asarray(np.linalg.pinv(self._penalties.T @ self._penalties, hermitian=True))

    @cached_property
    def _carried(self) -> list[tuple[int, Array]]:
        """Pairs of a number and −A⁻¹ M, (free, cells).

        The matrix is the effect of errors of the previous frame (0), the baseline (1).
        """
        size = np.sqrt(self.model.penalty_curvature)[:, None]
        known = enumerate(self.model.known_jacobians)
        return [
            (which, np.asarray(-self._pulls @ (rows.toarray() * size)))
            for which, rows in known
            if rows.nnz
        ]

    @cached_property
    def _own(self) -> list[tuple[Array, Array]]:
        """Pairs (X, Y), (free, n) each, with S = Σ X Yᵀ without the errors of previous frames."""
        model = self.model
        parts: list[tuple[Array, Array | float]] = [
            (self._gain, model.noise**2),
            (self.inverse, model.scale**2 * model.ignorance),
        ]
        if len(model.penalty_term):
            parts += [
                (self._pulls, model.scale * self.widening),
                ((model.pulls[model.free].T @ self.inverse).T, 1.0),
            ]
        if self.drawn is not None:
            parts.append((self._gain @ self.drawn, 1.0))
        return [(rows * size, rows) for rows, size in parts]

    @cached_property
    def _inherited(self) -> list[tuple[Array, Array]]:
        """The same of (A⁻¹ M) S₀ (A⁻¹ M)ᵀ, block by block of S₀."""
        if self.before is None:
            return []
        pairs = product(self._carried, repeat=2)
        blocks = self.before.blocks
        return [(first @ blocks[row, column], second) for (row, first), (column, second) in pairs]

    @cached_property
    def variance(self) -> Array:
        """Diagonal of S, (free,)."""
        return np.asarray(
            sum(np.sum(left * right, axis=1) for left, right in self._own + self._inherited)
        )

    @cached_property
    def covariance(self) -> Array:
        """S over all cells, (frames · cells, frames · cells); zero for cells that are not free."""
        matrix = np.zeros((self.model.at.cell_resistance.size,) * 2)
        matrix[np.ix_(self.model.free, self.model.free)] = sum(
            x @ y.T for x, y in self._own + self._inherited
        )
        return matrix

    def memory(self) -> Memory:
        """Return the errors of the last frame and of the baseline for the next frame.

        Of two frames that are solved together the first is the baseline.
        """
        size = self.model.at.cell_resistance[0].size
        if len(self.model.at.cell_resistance) == 2:
            return DenseMemory(self.covariance.reshape(2, size, 2, size).swapaxes(1, 2)[::-1, ::-1])
        blocks = np.zeros((2, 2, size, size))
        blocks[0, 0] = self.covariance
        if self.before is not None:
            blocks[1, 1] = self.before.blocks[1, 1]
            for which, carried in self._carried:
                blocks[0, 1, self.model.free] += carried @ self.before.blocks[which, 1]
            blocks[1, 0] = blocks[0, 1].T
        return DenseMemory(blocks)

    @cached_property
    def resolution(self) -> Array:
        """Diagonal of the averaging kernel K J, (free,)."""
        return np.asarray(np.einsum("ij,ji->i", self._gain, self.jacobian))

    @cached_property
    def certainty(self) -> Certainty:
        """Certainty of the estimate without errors that all frames share."""
        shares = self.resolution, self.data_share
        return Certainty.of(
            self.model, (self.variance, self.shared_variance), shares, self.released
        )

    @cached_property
    def widening(self) -> Array:
        """Variance factor C − B of the penalty rows, (penalty rows,).

        Residuals that involve a cell without a reading are no evidence: they are assumed at least
        as large as the 95 % quantile of the other residuals of the term.
        """
        model = self.model
        squares = model.penalty_squares
        unread = model.unread_rows
        widened = np.maximum(1.0, squares)
        for number in np.unique(model.penalty_term):
            chosen = model.penalty_term == number
            # Σ ω x̂²/(s² γ) over the rows of one term
            widened[chosen] = np.maximum(
                widened[chosen], squares[chosen].sum() / max(self.determined(int(number)), 1.0)
            )
            if (chosen & unread).any() and (chosen & ~unread).any():
                far = np.quantile(squares[chosen & ~unread], LEVEL, method="higher") / TWO_SIDED**2
                widened[chosen & unread] = np.maximum(widened[chosen & unread], far)
        return np.asarray(
            widened - model.known_share(None if self.before is None else self.before.variance())
        )

    def reading_deviation(self) -> Array:
        """Return the standard deviation √diag(F S Fᵀ) of the modelled readings f(r̂).

        Shape (frames, rows, columns). F = ∂f/∂u, and S excludes the errors of earlier frames. For
        measured readings S is approximated by s² A⁻¹; only for missing ones it is computed.
        """
        model = self.model
        slopes = self._readings_by_cells[:, model.free]
        variance = model.scale * np.sum((slopes @ self.inverse) * slopes, axis=1)
        if model.at.data.partial:
            missing = np.flatnonzero(np.ravel(model.at.data.given.seen) == 0)
            variance[missing] = sum(
                np.sum((slopes[missing] @ x) * (slopes[missing] @ y), axis=1) for x, y in self._own
            )
        return np.asarray(
            np.sqrt(np.maximum(variance, 0.0)).reshape(model.at.cell_resistance.shape)
        )

    @property
    def shared_variance(self) -> Array:
        """Part of the variance that moves all cells of a frame alike, (free,).

        It is due to shared random errors V.
        """
        frames = self.model.free // self.model.at.cell_resistance[0].size
        common = np.zeros(len(frames))
        if self.drawn is None:
            return common
        answer = self.answer(self.drawn)
        for frame in np.unique(frames):
            common[frames == frame] = common_variance(answer[frames == frame])
        return np.asarray(np.minimum(common, self.variance))

    def answer(self, rows: Array, known: Array | None = None) -> Array:
        """Return the effect on log r, (free, n), of errors shared with earlier estimates.

        The data share these errors with earlier estimates.

        Parameters
        ----------
        rows : array, shape (data rows, n)
            Errors of the data.
        known : array, shape (2, cells, n), or None
            Effect a of the same errors on log r of the last estimate and of the baseline; None for
            no effect.
        """
        # K x − A⁻¹ Zᵀ Ω Z₀ a
        carried = np.zeros(0) if known is None else self.model.carried(known)
        if not carried.any():
            return self.gained(rows)
        back = self.model.penalty_jacobian.T @ (self.model.penalty_curvature[:, None] * carried)
        return self.gained(rows) - self.solved(back[self.model.free])

    @cached_property
    def data_share(self) -> Array:
        """Row sums of the averaging kernel K J, (free,)."""
        everywhere = self.model.over_all(np.ones((len(self.model.free), 1)))
        return self.gained(self.forward(everywhere), fine=True)[:, 0]

    def released(self, cells: NDArray[np.intp]) -> Array:
        """Return the variance of log r of cells (numbers) at a bound.

        Each is released alone among the free cells.
        """
        model = self.model
        chosen = (cells, np.arange(len(cells)))
        # Schur complement of each released cell c: A_cc − A_cf A_ff⁻¹ A_fc, with A = Jᵀ Ω J + Zᵀ Ω
        # Z
        unit = np.zeros((model.at.cell_resistance.size, len(cells)))
        unit[chosen] = 1.0
        penalised = model.penalty_curvature[:, None] * (model.penalty_jacobian @ unit)
        image = self.weighed(self.forward(unit)) + model.penalty_jacobian.T @ penalised
        across = image[model.free]
        left = image[chosen] - np.sum(across * self.solved(across), axis=0)
        return np.asarray(model.scale / np.maximum(left, IGNORANCE * model.scale))


@dataclass(frozen=True, eq=False)
class SampledErrors(DenseErrors):
    """Errors of an estimate from samples, for panels that are too large for matrices.

    Attributes
    ----------
    before : SampledMemory or None
        Samples of the errors of the previous frame and of the baseline, if terms read these.
    samples : int
        Number of samples of the error; standard deviations scatter by 7 %.
    probes : int
        Number of random changes for sums over all rows of a penalty.
    accuracy, fine_accuracy : float
        Accuracy of a solve by conjugate gradients: of a sample, and of a value that is reported
        itself.
    """

    samples: int = 100
    probes: int = 8
    accuracy: float = 1e-3
    fine_accuracy: float = 1e-7

    @cached_property
    def _curvature(self) -> Hessian:
        """Derivatives at the estimate, for products with ∂y/∂u."""
        return Hessian(self.model.at, Smoothing.start(self.model.at))

    def _adjoint(self, rows: Array) -> Array:
        """Return Jᵀ Ω x over all cells for one column x of the data."""
        weights = np.asarray(self.model.through.T @ (self.model.data_curvature * rows))
        return self._curvature.adjoint(weights.reshape(self.model.at.cell_resistance.shape))

    def _forward(self, change: Array) -> Array:
        """Return the change of the data for one change of log r of all cells."""
        return np.asarray(self.model.through @ self._curvature.forward(change).ravel())

    def forward(self, change: Array) -> Array:
        return _by_columns(self._forward, change, len(self.model.noise))

    def weighed(self, rows: Array) -> Array:
        return _by_columns(self._adjoint, rows, self.model.at.cell_resistance.size)

    def solved(self, right: Array, *, fine: bool = False) -> Array:
        accuracy = self.fine_accuracy if fine else self.accuracy
        return _by_columns(
            lambda column: -steihaug(*self._system, column, accuracy).step, right, len(right)
        )

    @cached_property
    def _system(self) -> tuple[Linear, Linear]:
        """Product with A, and preconditioner M⁻¹ ≈ A⁻¹, for vectors over the free cells."""
        model = self.model
        cells = np.zeros(self.model.at.cell_resistance.size)
        free = self.model.free

        def product(search: Array) -> Array:
            cells[free] = search
            image = self._adjoint(self._forward(cells)) + self._rows.T @ (self._rows @ cells)
            return np.asarray(image[free] + model.scale * model.ignorance * search)

        ridge = np.full(len(cells), IGNORANCE * model.scale)
        chosen = np.isin(np.arange(len(cells)), free)
        return product, TwoLevel.of(self._curvature, ridge).over(chosen, model.at.cell_resistance)

    def determined(self, term: int) -> float:
        """Return γ of a term from probes.

        Each term has an equal share of the rank of all penalties.
        """
        rank_of_penalties = min(rank(self.model.at.cost.unweighted), len(self.model.free))
        return rank_of_penalties / len(np.unique(self.model.penalty_term)) - self.used(term)

    def used(self, term: int) -> float:
        """Return tr(A⁻¹ Z_tᵀ Ω Z_t) of a term (number), the mean of Σ ω (Z δ)²/s² over `draws`."""
        of_term = self.model.penalty_term == term
        squares = self.model.penalty_curvature[of_term, None] * self.draws[of_term] ** 2
        return float(np.sum(squares)) / (self.probes * self.model.scale)

    @cached_property
    def draws(self) -> Array:
        """Changes Z δ of the penalties for random δ ~ N(0, s² A⁻¹) of the free cells.

        Shape (penalty rows, probes).
        """
        model = self.model
        random = np.random.default_rng(1)
        # δ = s A⁻¹ (Jᵀ √Ω z₁ + Zᵀ √Ω z₂ + √(ε s²) z₃) with standard normal z
        data = np.sqrt(np.maximum(model.data_curvature, np.finfo(float).tiny))
        right = np.empty((len(model.free), self.probes))
        for probe in range(self.probes):
            rows, pull, ridge = map(
                random.standard_normal, (len(data), self._rows.shape[0], len(model.free))
            )
            drawn = self._adjoint(rows / data) + self._rows.T @ pull
            right[:, probe] = drawn[model.free] + np.sqrt(model.scale * model.ignorance) * ridge
        return np.asarray(
            np.sqrt(model.scale) * (model.penalty_jacobian @ model.over_all(self.solved(right)))
        )

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        """Samples of ε, (samples, free), and an estimate of the diagonal of A⁻¹ Zᵀ Ω Z, (free,)."""
        model = self.model
        random = np.random.default_rng(self.before.frames if self.before else 0)
        pulled = np.zeros(len(model.free))
        samples = np.empty((self.samples, len(model.free)))
        size = np.sqrt(self.widening * model.scale)
        for number in range(self.samples):
            noise = random.standard_normal(len(model.noise)) * model.noise
            pull = random.standard_normal(len(size))
            if self.drawn is not None:
                noise = noise + self.drawn @ random.standard_normal(self.drawn.shape[1])
            # Jᵀ Ω (τ z₁ + V z₃) + s Zᵀ √((C − B) Ω) z₂ + P z₄ − M ε₀
            right = self._adjoint(noise) + self._rows.T @ (size * pull)
            right += model.pulls @ random.standard_normal(model.pulls.shape[1])
            if self.before is not None:
                # M ε₀ = Zᵀ Ω Z₀ ε₀
                known = model.carried(self.before.samples[:, number])
                right -= model.penalty_jacobian.T @ (model.penalty_curvature * known)
            samples[number] = self.solved(right[model.free, None])[:, 0]
            # E[ε·(Zᵀ √Ω z₂)/√(s²(C − B))] = diag(A⁻¹ Zᵀ Ω Z) over the samples
            pulled += samples[number] * (self._rows.T @ (pull / size))[model.free] / self.samples
        return samples, pulled

    @property
    def variance(self) -> Array:
        return np.asarray(np.mean(self._samples[0] ** 2, axis=0))

    @property
    def resolution(self) -> Array:
        """Diagonal of the averaging kernel, clipped to 0 to 1 because samples scatter, (free,)."""
        return np.clip(1 - self._samples[1], 0, 1)

    def reading_deviation(self) -> Array:
        """Return the standard deviation of the modelled readings over the samples.

        Shape (frames, rows, columns).
        """
        squares = np.zeros(self.model.at.cell_resistance.shape)
        for sample in self._samples[0]:
            squares += (
                np.reshape(self._curvature.forward(self.model.over_all(sample)), squares.shape) ** 2
            )
        return np.sqrt(squares / self.samples)

    def memory(self) -> Memory:
        samples = self.model.over_all(self._samples[0].T).T
        if len(self.model.at.cell_resistance) == 2:
            return SampledMemory(samples.reshape(self.samples, 2, -1).swapaxes(0, 1)[::-1])
        if self.before is None:
            return SampledMemory(np.stack([samples, np.zeros_like(samples)]))
        return SampledMemory(np.stack([samples, self.before.samples[1]]), self.before.frames + 1)


def _by_columns(function: Callable[[Array], Array], columns: Array, size: int) -> Array:
    """Return the results (size, n) of a function of single columns for n columns."""
    return (
        np.stack([function(column) for column in columns.T], axis=1)
        if columns.size
        else np.zeros((size, 0))
    )


def errors_of(model: LinearModel, memory: Memory | None, drawn: Array | None = None) -> DenseErrors:
    """Return the errors of an estimate, as matrices or from samples.

    Parameters
    ----------
    model : LinearModel
    memory : Memory or None
        Errors of the previous frame and of the baseline.
    drawn : array, shape (data rows, n), or None
        V, random errors that the readings of a frame share.
    """
    if isinstance(memory, SampledMemory) or model.at.cell_resistance.size > MAX_DENSE:
        return SampledErrors(model, memory if isinstance(memory, SampledMemory) else None, drawn)
    return DenseErrors(model, memory, drawn)


def active_bounds(
    errors: DenseErrors, rows: Array, known: Array
) -> tuple[Array, NDArray[np.intp], Array, Array]:
    """Return the effect of shared errors z on the free cells, and intervals at a bound.

    The intervals are those of the cells at a bound. The distance t_c of a cell from its bound is
    distributed as N(−slope·v, v + |a|²) truncated to t_c ≥ 0, with v its variance among the free
    cells and a the effect of z on it. If |a| > slope·v, the cell is released and moves with the
    free cells. For an open cell t_c is the conductance, in units of a typical cell's.

    Parameters
    ----------
    errors : DenseErrors
    rows : array, shape (data rows, n)
        Effect of z on the data.
    known : array, shape (2, cells, n)
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
    free = model.free
    cells = np.flatnonzero(model.at_lower | model.at_upper)
    # Unknowns: u of cells inside and at a lower bound; conductance over that of a typical cell at
    # an upper bound.
    typical = np.exp(np.log(model.at.cell_resistance).ravel()[free].mean()) if len(free) else 1.0
    stretch = np.where(
        model.at_upper, np.maximum(model.at.cell_resistance.ravel() / typical, 1.0), 1.0
    )
    # Whitened rows: A = Xᵀ X with X = (√Ω J; √Ω Z), and their change Y with z; the effect of z is
    # (Xᵀ X)⁻¹ Xᵀ Y.
    data = np.sqrt(model.data_curvature)[:, None]
    penalties = np.sqrt(model.penalty_curvature)[:, None]
    stacked = (
        np.vstack([errors.sensitivity * data, model.penalty_jacobian.toarray() * penalties])
        * stretch
    )
    moved = np.vstack([rows * data, -model.carried(known) * penalties])
    # Each cell at a bound alone: Schur complement, variance v, slope of −log density, and effect a
    # of z.
    at_bounds = stacked[:, cells]
    inside = stacked[:, free]
    across = errors.inverse @ (inside.T @ at_bounds)
    left = np.maximum(
        np.sum(at_bounds**2, axis=0) - np.sum((inside.T @ at_bounds) * across, axis=0),
        IGNORANCE * model.scale,
    )
    variance = model.scale / left
    slope = np.abs(model.gradient[cells]) * stretch[cells] / (2 * model.scale)
    answer = ((at_bounds - inside @ across).T @ moved) / left[:, None]
    # Cells whose bound z overcomes: solve again with the free ones.
    released = np.sqrt(np.sum(answer**2, axis=1)) > slope * variance
    unbounded = np.concatenate([free, cells[released]])
    matrix = stacked[:, unbounded].T @ stacked[:, unbounded]
    matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
    joint = positive_inverse(matrix) @ (stacked[:, unbounded].T @ moved)
    answer[released] = joint[len(free) :]
    # 95 % quantile of the truncated normal distribution, converted to log r for open cells.
    wide = variance + np.sum(answer**2, axis=1)
    reach = one_sided(slope * variance / wide, wide)[1]
    below = np.where(model.at_upper[cells], np.log1p(stretch[cells] * reach), 0.0)
    return joint[: len(free)], cells, below, np.where(model.at_upper[cells], np.inf, reach)


def positive_inverse(matrix: Array) -> Array:
    """Return A⁻¹ from the upper triangle of A.

    Raises numpy.linalg.LinAlgError if A is not positive definite.
    """
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
    """Return a table T, (n, m) with m ≥ n, swept by its diagonal entry t_pp.

    A table of rows in memory is overwritten.

        T ← T − t_·p t_p·/t_pp,   row and column p over |t_pp|,   t_pp ← −1/t_pp

    Source: Goodnight, The American Statistician 33, 1979 (the sweep operator).
    """
    pivot = table[place, place]
    row = table[place].copy()
    column = table[:, place].copy()
    # dger adds in place, in a fifth of the time of np.outer.
    table = blas.dger(-1 / pivot, row, column, a=table.T, overwrite_a=True).T
    table[place], table[:, place], table[place, place] = (
        row / abs(pivot),
        column / abs(pivot),
        -1 / pivot,
    )
    return table
