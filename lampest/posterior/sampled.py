"""Posterior covariance of log r from samples, in product form: no matrix over the cells is formed.

A sample is ε = A⁻¹ (Jᵀ Ω (τ z₁ + V z₃) + s Zᵀ √((C − B) Ω) z₂ + Zᵀ H z₅ + W z₄ − M ε₀) with standard normal z, in the
symbols of `lampest.posterior.dense`. It costs one solve by conjugate gradients. Its covariance is S but for the prior
term ε s⁴. Standard deviations from n samples scatter by 1/√(2n).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy import sparse

from lampest.panel.panel import Array
from lampest.panel.trust_region import Linear, steihaug
from lampest.posterior.dense import DenseErrors, Memory, rank
from lampest.posterior.linear import IGNORANCE
from lampest.solvers.hessian import Hessian
from lampest.solvers.preconditioners import TwoLevel
from lampest.solvers.smoothing import Smoothing


@dataclass(frozen=True, eq=False)
class SampledMemory(Memory):
    """Samples of the errors of log r of the last estimate and of the baseline, (samples, cells) each.

    Attributes
    ----------
    frames : int
        Number of frames so far, the seed of the next frame's noise.
    """

    frames: int = 1

    def resting(self) -> Self:
        return replace(self, baseline=self.last)

    def shared(self) -> Array:
        return np.asarray(np.mean(self.last * self.baseline, axis=0))

    def variance(self) -> Array:
        return np.asarray(np.mean(self.last**2, axis=0))


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
        Number of random probes of a trace.
    accuracy, fine_accuracy : float
        Accuracy of a solve by conjugate gradients: of a sample, and of a value that is reported itself.
    """

    samples: int = 100
    probes: int = 8
    accuracy: float = 1e-3
    fine_accuracy: float = 1e-7

    @cached_property
    def _curvature(self) -> Hessian:
        """Derivatives at the estimate, for products with ∂y/∂u."""
        return Hessian(self.model.at, Smoothing.start(self.model.at))

    @cached_property
    def _rows(self) -> sparse.csr_array:
        """√Ω Z over all cells, (penalty rows, cells) sparse."""
        return sparse.csr_array(sparse.diags_array(np.sqrt(self.model.penalty_curvature)) @ self.model.penalty_jacobian)

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

    def solved(self, right: Array) -> Array:
        return _by_columns(self._solved, right, len(right))

    def gained(self, rows: Array, *, fine: bool = False) -> Array:
        right = self.weighed(rows)[self.model.free]
        return _by_columns(
            lambda column: self._solved(column, self.fine_accuracy if fine else self.accuracy), right, len(right)
        )

    @cached_property
    def _system(self) -> tuple[Linear, Linear]:
        """Product with A, and preconditioner M⁻¹ ≈ A⁻¹, for vectors over the free cells."""
        model, whole, free = self.model, np.zeros(self.model.at.cell_resistance.size), self.model.free

        def product(search: Array) -> Array:
            whole[free] = search
            image = self._adjoint(self._forward(whole)) + self._rows.T @ (self._rows @ whole)
            return np.asarray(image[free] + model.scale * model.ignorance * search)

        ridge, chosen = np.full(len(whole), IGNORANCE * model.scale), np.isin(np.arange(len(whole)), free)
        return product, TwoLevel.of(self._curvature, ridge).over(chosen, model.at.cell_resistance)

    def _solved(self, right: Array, accuracy: float | None = None) -> Array:
        """Return A⁻¹ x by conjugate gradients."""
        return -steihaug(*self._system, right, accuracy or self.accuracy).step

    def determined(self, term: int) -> float:
        """Return γ of a term from probes; each term has an equal share of the rank of all penalties."""
        every = min(rank(self.model.at.cost.unweighted), len(self.model.free))
        return every / len(np.unique(self.model.penalty_term)) - self.used(term)

    def used(self, term: int) -> float:
        """Return tr(A⁻¹ Z_tᵀ Ω Z_t) of a term (number), estimated from random probes."""
        random, own = np.random.default_rng(1), self.model.penalty_term == term
        rows, total = self._rows[own], 0.0
        for _ in range(self.probes):
            # Hutchinson's estimate: E pᵀ √Ω Z A⁻¹ Zᵀ √Ω p for random signs p
            right = (rows.T @ random.choice([-1.0, 1.0], int(own.sum())))[self.model.free]
            total += float(right @ self._solved(right))
        return total / self.probes

    @property
    def _frames(self) -> int:
        return 0 if self.before is None else self.before.frames

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        """Samples of ε, (samples, free), and an estimate of the diagonal of A⁻¹ Zᵀ Ω Z, (free,)."""
        model, random = self.model, np.random.default_rng(self._frames)
        pulled, samples = np.zeros(len(model.free)), np.empty((self.samples, len(model.free)))
        size = np.sqrt(self.widening * model.scale)
        curvature = sparse.diags_array(model.penalty_curvature)
        # Ω Z₀, for M ε₀ = Zᵀ Ω Z₀ ε₀
        previous, baseline = curvature @ model.previous_jacobian, curvature @ model.baseline_jacobian
        for number in range(self.samples):
            noise = random.standard_normal(len(model.noise)) * model.noise
            pull = random.standard_normal(len(size))
            if self.drawn is not None:
                noise = noise + self.drawn @ random.standard_normal(self.drawn.shape[1])
            # Jᵀ Ω (τ z₁ + V z₃) + s Zᵀ √((C − B) Ω) z₂ + W z₄ + Zᵀ H z₅ − M ε₀
            right = self._adjoint(noise) + self._rows.T @ (size * pull)
            right += model.weight_pulls @ random.standard_normal(model.weight_pulls.shape[1])
            if model.steady_pull.any():
                right += model.penalty_jacobian.T @ (model.steady_pull * random.standard_normal(len(size)))
            if self.before is not None:
                known = previous @ self.before.last[number] + baseline @ self.before.baseline[number]
                right -= model.penalty_jacobian.T @ known
            samples[number] = self._solved(right[model.free])
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
        """Return the standard deviation of the modelled readings over the samples, (frames, rows, columns)."""
        whole, squares = np.zeros(self.model.at.cell_resistance.size), np.zeros(self.model.at.cell_resistance.shape)
        for sample in self._samples[0]:
            whole[self.model.free] = sample
            squares += np.reshape(self._curvature.forward(whole), squares.shape) ** 2
        return np.sqrt(squares / self.samples)

    def memory(self) -> Memory:
        size = self.model.at.cell_resistance[0].size
        samples = np.zeros((self.samples, self.model.at.cell_resistance.size))
        samples[:, self.model.free] = self._samples[0]
        if len(self.model.at.cell_resistance) == 2:
            return SampledMemory(samples[:, size:], samples[:, :size])
        baseline = np.zeros_like(samples) if self.before is None else self.before.baseline
        return SampledMemory(samples, baseline, self._frames + 1)


def _by_columns(function: Callable[[Array], Array], columns: Array, size: int) -> Array:
    """Return the results (size, n) of a function of single columns for n columns."""
    return np.stack([function(column) for column in columns.T], axis=1) if columns.size else np.zeros((size, 0))
