"""Posterior covariance of log r as matrices over the cells.

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

With C = 1 and equal noise of all data, S is the Laplace approximation s² A⁻¹. Panels that are too
large for matrices have the same S from samples (`lampest.posterior.sampled`).

The error of a cell at a bound is not Gaussian: the distance of the cell from its bound has a normal
distribution that is truncated at 0. An error of all readings may move a cell off its bound; the
cell then counts as free.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, ClassVar

import numpy as np
from scipy import sparse
from scipy.linalg import blas

from lampest.files.levels import TWO_SIDED
from lampest.panel.compiled import with_entries
from lampest.panel.panel import Array, Numbers
from lampest.posterior.certainty import Certainty, common_variance
from lampest.posterior.interval import LEVEL, one_sided
from lampest.posterior.linear import IGNORANCE, LinearModel, positive_inverse
from lampest.solvers.hessian import block_diagonal


class Memory(ABC):
    """Errors of the last estimate and of the baseline, for the error bars of the next frame.

    Terms that compare a frame with the previous one, or with the unloaded panel, carry them into
    the next estimate. Small panels keep their covariance as a matrix, large ones samples.
    """

    @abstractmethod
    def resting(self) -> "Memory":
        """Return the memory with the last estimate as the baseline."""

    @abstractmethod
    def shared(self) -> Array:
        """Return the covariance of the last estimate and the baseline, cell by cell, (cells,)."""

    @abstractmethod
    def variance(self) -> Array:
        """Return the variance of the last estimate, (cells,)."""


@dataclass(frozen=True, eq=False)
class DenseMemory(Memory):
    """Errors of log r of the last estimate and of the baseline, as matrices.

    Attributes
    ----------
    blocks : array, shape (2, 2, cells, cells)
        S₀, the joint covariance of the last estimate (0) and the baseline (1).
    """

    blocks: Array

    def resting(self) -> "DenseMemory":
        return DenseMemory(np.broadcast_to(self.blocks[0, 0], self.blocks.shape))

    def shared(self) -> Array:
        return np.diag(self.blocks[0, 1])

    def variance(self) -> Array:
        return np.diag(self.blocks[0, 0])


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
    exact : bool
        Whether all sums over cells are exact; those of samples are not.
    """

    exact: ClassVar[bool] = True
    model: LinearModel
    before: Any = None
    drawn: Array | None = None

    @cached_property
    def sensitivity(self) -> Array:
        """Sensitivity ∂x/∂u of the data over all cells, (data rows, frames · cells)."""
        return np.asarray(self.model.through @ self._readings_by_cells)

    @cached_property
    def _readings_by_cells(self) -> Array:
        """F, the sensitivity ∂f/∂u of the readings over all cells, (readings, cells)."""
        return block_diagonal([network.sensitivity() for network in self.model.at.networks])

    @cached_property
    def jacobian(self) -> Array:
        """J, the sensitivity over the free cells, (data rows, free)."""
        return self.sensitivity[:, self.model.free]

    def forward(self, change: Array) -> Array:
        """Return the change of the data, (data rows, n), for changes of log r of all cells.

        The changes of log r have shape (cells, n).
        """
        return self.sensitivity @ change

    def weighed(self, rows: Array) -> Array:
        """Return Jᵀ Ω x over all cells, (cells, n), for data x (data rows, n)."""
        return self.sensitivity.T @ (self.model.data_curvature[:, None] * rows)

    def solved(self, right: Array, *, fine: bool = False) -> Array:
        """Return A⁻¹ x, (free, n); `fine` requests the accuracy of reported values."""
        return self.inverse @ right

    def gained(self, rows: Array, *, fine: bool = False) -> Array:
        """Return K x, (free, n), for data x (data rows, n)."""
        return self.solved(self.weighed(rows)[self.model.free], fine=fine)

    @cached_property
    def _rows(self) -> sparse.csc_array:
        """√Ω Z over all cells, (penalty rows, cells) sparse."""
        rows = self.model.penalty_jacobian
        return with_entries(rows, rows.data * np.sqrt(self.model.penalty_curvature)[rows.indices])

    @cached_property
    def _free_rows(self) -> sparse.csc_array:
        """√Ω Z over the free cells, (penalty rows, free) sparse."""
        free = self.model.free
        return self._rows if len(free) == self._rows.shape[1] else self._rows[:, free]

    @cached_property
    def normal(self) -> Array:
        """Upper triangle of A = Jᵀ Ω J + Zᵀ Ω Z + ε s², (free, free)."""
        matrix = blas.dsyrk(1.0, (self.jacobian * np.sqrt(self.model.data_curvature)[:, None]).T)
        matrix += (self._free_rows.T @ self._free_rows).toarray()
        matrix[np.diag_indices(len(matrix))] += self.model.ignorance * self.model.scale
        return np.asarray(matrix)

    @cached_property
    def inverse(self) -> Array:
        """A⁻¹, (free, free). Raises numpy.linalg.LinAlgError if A is not positive definite."""
        return positive_inverse(self.normal) if len(self.model.free) else np.zeros((0, 0))

    @cached_property
    def _by_readings(self) -> Array:
        """F A⁻¹, (readings, free)."""
        return self._readings_by_cells[:, self.model.free] @ self.inverse

    @cached_property
    def _gain(self) -> Array:
        """Gain K = A⁻¹ Jᵀ Ω, (free, data rows)."""
        rows = self.model.through @ self._by_readings
        return np.asarray((rows * self.model.data_curvature[:, None]).T)

    @cached_property
    def _pulls(self) -> Array:
        """A⁻¹ Zᵀ √Ω, (free, penalty rows)."""
        return np.asarray((self._free_rows @ self.inverse).T)

    def determined(self, term: int) -> float:
        """Return the number of residuals of a term (number) that the data determine.

        γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t), B_t = Z_tᵀ Ω Z_t, B the sum over terms. For a single term
        tr(B⁺ B_t) is the rank of B_t.
        """
        of_term = self.model.penalty_term == term
        # tr(A⁻¹ B_t) = Σ over the rows of term t of diag(√Ω Z A⁻¹ Zᵀ √Ω)
        entries = self._free_rows.tocoo()
        chosen = of_term[entries.row]
        pulls = self._pulls[entries.col[chosen], entries.row[chosen]]
        used = float(entries.data[chosen] @ pulls)
        if of_term.all():
            return self.model.penalty_rank - used
        # tr(B⁺ B_t) in the same way
        rows = self._free_rows[of_term].toarray()
        square = (self._free_rows.T @ self._free_rows).toarray()
        inverse = np.linalg.pinv(square, hermitian=True)
        return float(np.sum((rows @ inverse) * rows)) - used

    @cached_property
    def _carried(self) -> list[tuple[int, Array]]:
        """Pairs of a number and −A⁻¹ M, (free, cells).

        The matrix is the effect of errors of the previous frame (0), the baseline (1).
        """
        size = np.sqrt(self.model.penalty_curvature)[:, None]
        return [
            (number, -self._pulls @ (rows.toarray() * size))
            for number, rows in enumerate(self.model.known_jacobians)
            if rows.nnz
        ]

    @cached_property
    def _own(self) -> list[tuple[Array, Array]]:
        """Pairs (X, d), (free, n) and (n,), with S = Σ X diag(d) Xᵀ without earlier frames."""
        model = self.model
        parts = [
            (self._gain, model.noise**2),
            (self.inverse, model.scale**2 * model.ignorance),
        ]
        if len(model.penalty_term):
            pulled = (model.pulls[model.free].T @ self.inverse).T
            parts += [
                (self._pulls, model.scale * self.widening),
                (pulled, np.ones(pulled.shape[1])),
            ]
        if self.drawn is not None:
            shared = self._gain @ self.drawn
            parts.append((shared, np.ones(shared.shape[1])))
        return parts

    @cached_property
    def _inherited(self) -> list[tuple[Array, Array]]:
        """Pairs (X, Y), (free, n) each, with (A⁻¹ M) S₀ (A⁻¹ M)ᵀ = Σ X Yᵀ, by blocks of S₀."""
        if self.before is None:
            return []
        pairs = product(self._carried, repeat=2)
        blocks = self.before.blocks
        return [(first @ blocks[row, column], second) for (row, first), (column, second) in pairs]

    @cached_property
    def variance(self) -> Array:
        """Diagonal of S, (free,)."""
        own = sum(np.square(rows) @ size for rows, size in self._own)
        return np.asarray(own + sum(np.sum(x * y, axis=1) for x, y in self._inherited))

    @cached_property
    def covariance(self) -> Array:
        """S over all cells, (frames · cells, frames · cells); zero for cells that are not free."""
        matrix = np.zeros((self.model.cells.size,) * 2)
        own = sum((rows * size) @ rows.T for rows, size in self._own)
        inherited = sum(x @ y.T for x, y in self._inherited)
        matrix[np.ix_(self.model.free, self.model.free)] = own + inherited
        return matrix

    def memory(self) -> Memory:
        """Return the errors of the last frame and of the baseline for the next frame.

        The baseline is the first of two frames that are solved together.
        """
        size = self.model.cells[0].size
        if len(self.model.cells) == 2:
            return DenseMemory(self.covariance.reshape(2, size, 2, size).swapaxes(1, 2)[::-1, ::-1])
        blocks = np.zeros((2, 2, size, size))
        blocks[0, 0] = self.covariance
        if self.before is not None:
            blocks[1, 1] = self.before.blocks[1, 1]
            for number, carried in self._carried:
                blocks[0, 1, self.model.free] += carried @ self.before.blocks[number, 1]
            blocks[1, 0] = blocks[0, 1].T
        return DenseMemory(blocks)

    @cached_property
    def resolution(self) -> Array:
        """Diagonal of the averaging kernel ∂(estimate)/∂(cells), (free,).

        The kernel is K J. With absolute losses, the estimate moves along `LinearModel.plateaus`
        alone, and a loss of constant slope does not hold it.
        """
        model = self.model
        if not model.absolute.any():
            return np.asarray(np.einsum("ij,ji->i", self._gain, self.jacobian))
        basis = model.plateaus[model.free].toarray()
        data = self.jacobian * np.sqrt(model.data_curvature)[:, None]
        smooth = self._free_rows[~model.absolute] @ basis
        along = data @ basis
        normal = along.T @ along + smooth.T @ smooth
        normal[np.diag_indices(len(normal))] += IGNORANCE * model.scale
        return np.asarray(np.sum(basis * (data.T @ (along @ positive_inverse(normal))), axis=1))

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
        # ω x̂²/s²; 0 of sites, which fit the data
        squares = model.penalty_curvature * model.penalty**2 / model.scale
        if model.sites is not None:
            squares[model.sites.rows] = 0.0
        unread = model.unread_rows
        widened = np.maximum(1.0, squares)
        for number in np.unique(model.penalty_term):
            chosen = model.penalty_term == number
            # Σ ω x̂²/(s² γ) over the rows of one term
            mean = squares[chosen].sum() / max(self.determined(int(number)), 1.0)
            widened[chosen] = np.maximum(widened[chosen], mean)
            blind = chosen & unread
            read = chosen & ~unread
            if blind.any() and read.any():
                far = np.quantile(squares[read], LEVEL, method="higher") / TWO_SIDED**2
                widened[blind] = np.maximum(widened[blind], far)
        # B, the previous frame's share of the variance, of terms that weigh its error
        weighing = np.array([term.weighs_previous for term in model.at.cost.terms])
        if self.before is not None and weighing.any():
            share = model.known_jacobians[0].power(2) @ self.before.variance()
            widened -= weighing[model.penalty_term] * np.minimum(share, 1.0)
        return widened

    def reading_deviation(self) -> Array:
        """Return the standard deviation √diag(F S Fᵀ) of the modelled readings f(r̂).

        The shape is (frames, rows, columns). F is ∂f/∂u, and S excludes the errors of earlier
        frames. For measured readings S is approximated by s² A⁻¹; only for missing ones it is
        computed.
        """
        model = self.model
        slopes = self._readings_by_cells[:, model.free]
        variance = model.scale * np.sum(self._by_readings * slopes, axis=1)
        if model.at.data.partial:
            missing = np.flatnonzero(np.ravel(model.at.data.given.seen) == 0)
            variance[missing] = sum(
                np.square(slopes[missing] @ rows) @ size for rows, size in self._own
            )
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)).reshape(model.cells.shape))

    @property
    def shared_variance(self) -> Array:
        """Part of the variance that moves all cells of a frame alike, (free,); the effect of V."""
        frames = self.model.free // self.model.cells[0].size
        common = np.zeros(len(frames))
        if self.drawn is None:
            return common
        answer = self.answer(self.drawn)
        for frame in np.unique(frames):
            common[frames == frame] = common_variance(answer[frames == frame])
        return np.minimum(common, self.variance)

    def answer(self, rows: Array, previous: Array | None = None) -> Array:
        """Return the effect on log r, (free, n), of errors shared with earlier estimates.

        The data share these errors with earlier estimates.

        Parameters
        ----------
        rows : array, shape (data rows, n)
            Errors of the data.
        previous : array, shape (2, cells, n), or None
            Effect a of the same errors on log r of the last estimate and of the baseline; None for
            no effect.
        """
        # K x − A⁻¹ Zᵀ Ω Z₀ a
        carried = np.zeros(0) if previous is None else self.model.carried(previous)
        if not carried.any():
            return self.gained(rows)
        back = self.model.penalty_jacobian.T @ (self.model.penalty_curvature[:, None] * carried)
        return self.gained(rows) - self.solved(back[self.model.free])

    @cached_property
    def data_share(self) -> Array:
        """Row sums of the averaging kernel K J, (free,)."""
        everywhere = self.model.over_all(np.ones((len(self.model.free), 1)))
        return self.gained(self.forward(everywhere), fine=True)[:, 0]

    def released(self, cells: Numbers) -> Array:
        """Return the variance of log r of cells (numbers) at a bound.

        Each cell is released from its bound alone, and joins the free cells.
        """
        model = self.model
        chosen = (cells, np.arange(len(cells)))
        # Schur complement of each released cell c: A_cc − A_cf A_ff⁻¹ A_fc, with A = Jᵀ Ω J + Zᵀ Ω
        # Z
        unit = np.zeros((model.cells.size, len(cells)))
        unit[chosen] = 1.0
        penalised = model.penalty_curvature[:, None] * (model.penalty_jacobian @ unit)
        image = self.weighed(self.forward(unit)) + model.penalty_jacobian.T @ penalised
        across = image[model.free]
        complement = image[chosen] - np.sum(across * self.solved(across), axis=0)
        return np.asarray(model.scale / np.maximum(complement, IGNORANCE * model.scale))


def active_bounds(
    errors: DenseErrors, rows: Array, previous: Array
) -> tuple[Array, Numbers, Array, Array]:
    """Return the effect of shared errors z on the free cells, and intervals of those at a bound.

    The distance t_c of a cell from its bound is distributed as N(−slope·v, v + |a|²) truncated to
    t_c ≥ 0, with v its variance among the free cells and a the effect of z on it. If |a| > slope·v,
    the cell is released and moves with the free cells. For an open cell t_c is the conductance, in
    units of a typical cell's.

    `rows`, (data rows, n), is the effect of z on the data, `previous`, (2, cells, n), that on log r
    of the last estimate and of the baseline.

    Returns
    -------
    answer : array, shape (free, n)
        Effect of z on log r of the free cells.
    cells : array of int, shape (k,)
    below, above : array, shape (k,)
        Numbers of the cells at a bound, and extent of their 95 % intervals, in log r.

    Raises numpy.linalg.LinAlgError if the cost is flat.
    """
    model = errors.model
    free = model.free
    cells = np.flatnonzero(model.at_lower | model.at_upper)
    # Unknowns: u of cells inside and at a lower bound, relative conductance at an upper bound.
    resistance = model.cells.ravel()
    typical = np.exp(np.log(resistance)[free].mean()) if len(free) else 1.0
    stretch = np.where(model.at_upper, np.maximum(resistance / typical, 1.0), 1.0)
    # X = (√Ω J; √Ω Z) with A = Xᵀ X, and its change Y with z, whose effect is A⁻¹ Xᵀ Y
    data = np.sqrt(model.data_curvature)[:, None]
    penalties = np.sqrt(model.penalty_curvature)[:, None]
    slopes = np.vstack([errors.sensitivity * data, model.penalty_jacobian.toarray() * penalties])
    slopes = slopes * stretch
    changes = np.vstack([rows * data, -model.carried(previous) * penalties])
    # Each cell at a bound alone: Schur complement, variance v, slope of −log density, and effect a
    # of z.
    of_held = slopes[:, cells]
    of_free = slopes[:, free]
    across = errors.inverse @ (of_free.T @ of_held)
    complement = np.sum(of_held**2, axis=0) - np.sum((of_free.T @ of_held) * across, axis=0)
    precision = np.maximum(complement, IGNORANCE * model.scale)
    variance = model.scale / precision
    slope = np.abs(model.gradient[cells]) * stretch[cells] / (2 * model.scale)
    answer = ((of_held - of_free @ across).T @ changes) / precision[:, None]
    # Cells whose bound z overcomes: solve again with the free ones.
    released = np.sqrt(np.sum(answer**2, axis=1)) > slope * variance
    unbounded = slopes[:, np.concatenate([free, cells[released]])]
    matrix = unbounded.T @ unbounded
    matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
    joint = positive_inverse(matrix) @ (unbounded.T @ changes)
    answer[released] = joint[len(free) :]
    # 95 % quantile of the truncated normal distribution, converted to log r for open cells.
    total = variance + np.sum(answer**2, axis=1)
    reach = one_sided(slope * variance / total, total)[1]
    below = np.where(model.at_upper[cells], np.log1p(stretch[cells] * reach), 0.0)
    above = np.where(model.at_upper[cells], np.inf, reach)
    return joint[: len(free)], cells, below, above


def answer_to_scatter(errors: DenseErrors, scatter: float) -> Array:
    """Return the effect on log r of the scatter that the penalties do not expect, (free, cells).

    Films scatter by s from cell to cell. Where noise hides this scatter, the chosen weight of a
    penalty of differences follows the coarse pattern of the panel alone. It then expects neighbours
    that are more alike than those of films, and the prior covariance P⁻¹ of the penalty is less
    than s² I in some directions.

    With P = Σ ω_k v_k v_kᵀ the precision of the penalties on the cells of a frame, the scatter
    beyond them is Σ v_k w_k, w_k ~ N(0, max(s² − 1/ω_k, 0)). It is the same in all frames. The
    estimate follows it but for A⁻¹ Zᵀ Ω (Z + Z₀) w. Penalties that compare frames are not violated.

    Parameters
    ----------
    errors : DenseErrors
    scatter : float
        s, of log r.
    """
    model = errors.model
    cells = model.cells[0].size
    frames = model.cells.size // cells
    jacobian = model.penalty_jacobian
    of_frame = jacobian[:, -cells:].toarray()
    curvature = model.penalty_curvature[:, None]
    precision, basis = np.linalg.eigh(of_frame.T @ (curvature / model.scale * of_frame))
    expected = 1 / np.maximum(precision, np.finfo(float).tiny)
    root = basis * np.sqrt(np.maximum(scatter**2 - expected, 0.0))
    violated = jacobian @ np.tile(root, (frames, 1)) + model.carried(np.stack([root, root]))
    return -errors.solved((jacobian.T @ (curvature * violated))[model.free])
