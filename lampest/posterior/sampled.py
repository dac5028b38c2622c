"""Posterior covariance of log r from samples, for panels that are too large for matrices.

With the symbols of `lampest.posterior.covariance`, a sample of the error of an estimate is

    ε = A⁻¹ (Jᵀ Ω (τ z₁ + V z₃) + s Zᵀ √((C − B) Ω) z₂ + P z₄ − M ε₀)

with standard normal z. A sample costs one solve by conjugate gradients. The covariance of samples
is S but for the prior term ε s⁴. Standard deviations from n samples scatter by 1/√(2n).
`lampest.posterior.track.errors_of` chooses between matrices and samples.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from lampest.panel.panel import Array
from lampest.panel.trust_region import Linear, steihaug
from lampest.posterior.covariance import DenseErrors, Memory
from lampest.posterior.linear import IGNORANCE
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.preconditioners import TwoLevel


@dataclass(frozen=True, eq=False)
class SampledMemory(Memory):
    """Errors of log r of the last estimate and of the baseline, as samples.

    Attributes
    ----------
    samples : array, shape (2, samples, cells)
        Errors of the last estimate (0) and of the baseline (1).
    frames : int
        Number of frames so far, the seed of the next frame's noise.
    """

    samples: Array
    frames: int = 1

    def resting(self) -> "SampledMemory":
        return replace(self, samples=self.samples[[0, 0]])

    def shared(self) -> Array:
        return np.asarray(np.mean(self.samples[0] * self.samples[1], axis=0))

    def variance(self) -> Array:
        return np.asarray(np.mean(self.samples[0] ** 2, axis=0))


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

    exact = False
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
        weights = self.model.through.T @ (self.model.data_curvature * rows)
        return self._curvature.adjoint(weights.reshape(self.model.cells.shape))

    def _forward(self, change: Array) -> Array:
        """Return the change of the data for one change of log r of all cells."""
        return np.asarray(self.model.through @ self._curvature.forward(change).ravel())

    def forward(self, change: Array) -> Array:
        return _by_columns(self._forward, change, len(self.model.noise))

    def weighed(self, rows: Array) -> Array:
        return _by_columns(self._adjoint, rows, self.model.cells.size)

    def solved(self, right: Array, *, fine: bool = False) -> Array:
        accuracy = self.fine_accuracy if fine else self.accuracy
        return _by_columns(
            lambda column: -steihaug(*self._system, column, accuracy).step, right, len(right)
        )

    @cached_property
    def _system(self) -> tuple[Linear, Linear]:
        """Product with A, and preconditioner M⁻¹ ≈ A⁻¹, for vectors over the free cells."""
        model = self.model
        cells = np.zeros(self.model.cells.size)
        free = self.model.free

        def product(search: Array) -> Array:
            cells[free] = search
            image = self._adjoint(self._forward(cells)) + self._rows.T @ (self._rows @ cells)
            return np.asarray(image[free] + model.scale * model.ignorance * search)

        # The Hessian is 2 A.
        ridge = sparse.diags_array(np.full(len(cells), IGNORANCE * model.scale))
        penalties = sparse.csr_array(2 * (self._rows.T @ self._rows) + ridge)
        chosen = np.isin(np.arange(len(cells)), free)
        preconditioner = TwoLevel.of(self._curvature, penalties)
        return product, preconditioner.over(chosen, model.cells)

    def determined(self, term: int) -> float:
        """Return γ of a term from probes; all terms have equal shares of the penalties' rank."""
        return self.share - self.used(term)

    @property
    def share(self) -> float:
        """Each term's share of the penalties' rank."""
        return self.model.penalty_rank / len(np.unique(self.model.penalty_term))

    def used(self, term: int) -> float:
        """Return tr(A⁻¹ Z_tᵀ Ω Z_t) of a term (number), the mean of Σ ω (Z δ)²/s² over `draws`."""
        of_term = self.model.penalty_term == term
        squares = self.model.penalty_curvature[of_term, None] * self.draws[of_term] ** 2
        return float(np.sum(squares)) / (self.probes * self.model.scale)

    @cached_property
    def draws(self) -> Array:
        """Changes Z δ of the penalties for random δ ~ N(0, s² A⁻¹) of the free cells.

        The shape is (penalty rows, probes).
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
                carried = model.carried(self.before.samples[:, number])
                right -= model.penalty_jacobian.T @ (model.penalty_curvature * carried)
            samples[number] = self.solved(right[model.free, None])[:, 0]
            # E[ε·(Zᵀ √Ω z₂)/√(s²(C − B))] = diag(A⁻¹ Zᵀ Ω Z) over the samples
            pulled += samples[number] * (self._rows.T @ (pull / size))[model.free] / self.samples
        return samples, pulled

    @property
    def variance(self) -> Array:
        return np.asarray(np.mean(self._samples[0] ** 2, axis=0))

    @property
    def resolution(self) -> Array:
        """Diagonal of the averaging kernel, clipped because samples scatter, (free,).

        The range is 0 to 1, and to at most one share of a plateau with absolute losses.
        """
        plateaus = self.model.plateaus[self.model.free]
        return np.clip(1 - self._samples[1], 0, plateaus.power(2).sum(axis=1))

    def reading_deviation(self) -> Array:
        """Return the standard deviation of the modelled readings over the samples.

        The shape is (frames, rows, columns).
        """
        samples = self.model.over_all(self._samples[0].T).T
        changes = [self._curvature.forward(sample) for sample in samples]
        return np.asarray(np.sqrt(np.mean(np.square(changes), axis=0)))

    def memory(self) -> Memory:
        samples = self.model.over_all(self._samples[0].T).T
        if len(self.model.cells) == 2:
            return SampledMemory(samples.reshape(self.samples, 2, -1).swapaxes(0, 1)[::-1])
        if self.before is None:
            return SampledMemory(np.stack([samples, np.zeros_like(samples)]))
        return SampledMemory(np.stack([samples, self.before.samples[1]]), self.before.frames + 1)


def _by_columns(function: Callable[[Array], Array], columns: Array, size: int) -> Array:
    """Return the results (size, n) of a function of single columns for n columns."""
    if not columns.size:
        return np.zeros((size, 0))
    return np.stack([function(column) for column in columns.T], axis=1)
