"""The same errors from samples, in product form: no matrix over the cells is ever formed.

ε = A⁻¹ (Jᵀ Ω (τ z₁ + V z₃) + s Zᵀ √((C − B) Ω) z₂ + Zᵀ H z₂ − M ε₀), z normal: each sample costs one solve by conjugate
gradients and has the covariance S of `lampest.posterior.dense`. Standard deviations from n samples scatter by 1/√(2n).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.panel.panel import Array
from lampest.panel.trust_region import Linear, steihaug
from lampest.posterior.dense import rank
from lampest.posterior.linear import IGNORANCE, LinearModel, least_widening
from lampest.solvers.hessian import Hessian
from lampest.solvers.preconditioners import TwoLevel
from lampest.solvers.smoothing import Smoothing

SAMPLES, PROBES = 100, 8  # of the error, which standard deviations of 7 % suffice for; of a trace
ACCURACY, FINE = 1e-3, 1e-7  # of a solve by conjugate gradients: of a sample, and of what is reported itself


@dataclass(frozen=True, eq=False)
class SampledMemory:
    """Samples of the errors of log r, (samples, cells): of the last estimate, and of the baseline's.

    drawn : how many frames they are made of; every frame's noise must be a new one.
    """

    last: Array
    baseline: Array
    drawn: int = 1

    def resting(self) -> "SampledMemory":
        """The same, with the last estimate as the baseline."""
        return replace(self, baseline=self.last)

    def shared(self) -> Array:
        """Their covariance, cell by cell."""
        return np.asarray(np.mean(self.last * self.baseline, axis=0))


@dataclass(frozen=True, eq=False)
class SampledErrors:
    """model : the estimate's surroundings. before : samples of the previous frame's error, if it is read.

    drawn : (data rows, n) what one chance moves together in the frames that are solved, or None.
    """

    model: LinearModel
    before: SampledMemory | None = None
    drawn: Array | None = None

    @cached_property
    def _curvature(self) -> Hessian:
        return Hessian(self.model.at, Smoothing.start(self.model.at))

    @cached_property
    def _penalties(self) -> sparse.csr_array:
        """√Ω Z, all cells."""
        return sparse.csr_array(sparse.diags_array(np.sqrt(self.model.penalty_curvature)) @ self.model.penalty_jacobian)

    def _forward(self, change: Array) -> Array:
        return np.asarray(self.model.through @ self._curvature.forward(change).ravel())

    def _adjoint(self, rows: Array) -> Array:
        weights = np.asarray(self.model.through.T @ rows).reshape(self.model.at.cell_resistance.shape)
        return self._curvature.adjoint(weights)

    def _data(self, change: Array) -> Array:
        """Jᵀ Ω J p."""
        return self._adjoint(self.model.data_curvature * self._forward(change))

    @cached_property
    def _system(self) -> tuple[Linear, Linear]:
        """A, and what approximates A⁻¹, on vectors over the free cells."""
        model, whole, free = self.model, np.zeros(self.model.at.cell_resistance.size), self.model.free

        def product(search: Array) -> Array:
            whole[free] = search
            image = self._data(whole) + self._penalties.T @ (self._penalties @ whole)
            return np.asarray(image[free] + model.scale * model.ignorance * search)

        ridge, chosen = np.full(len(whole), IGNORANCE * model.scale), np.isin(np.arange(len(whole)), free)
        return product, TwoLevel.of(self._curvature, ridge).over(chosen, model.at.cell_resistance)

    def _solved(self, right: Array, accuracy: float = ACCURACY) -> Array:
        return -steihaug(*self._system, right, accuracy).step

    @cached_property
    def _widened(self) -> Array:
        """C − B, as in the closed form, with γ from probes."""
        model = self.model
        squares, widened = model.penalty_squares, least_widening(model)
        terms = np.unique(model.penalty_term)
        for number in terms:
            own = model.penalty_term == number
            alone = min(rank(model.at.cost.unweighted), len(model.free)) / len(terms)
            widened[own] = np.maximum(widened[own], squares[own].sum() / max(alone - self.used(int(number)), 1.0))
        known = None if self.before is None else np.mean(self.before.last**2, axis=0)
        return np.asarray(widened - model.known_share(known))

    def used(self, term: int) -> float:
        """tr(A⁻¹ Z_tᵀ Ω Z_t) of one term (its number), from probes."""
        random, own = np.random.default_rng(1), self.model.penalty_term == term
        rows, total = self._penalties[own], 0.0
        for _ in range(PROBES):
            right = (rows.T @ random.choice([-1.0, 1.0], int(own.sum())))[self.model.free]
            total += float(right @ self._solved(right))
        return total / PROBES

    @property
    def _drawn_before(self) -> int:
        return 0 if self.before is None else self.before.drawn

    @cached_property
    def _drawn(self) -> tuple[Array, Array]:
        """(samples of ε, the diagonal of A⁻¹ Zᵀ Ω Z), over the free cells."""
        model, random = self.model, np.random.default_rng(self._drawn_before)
        pulled, samples = np.zeros(len(model.free)), np.empty((SAMPLES, len(model.free)))
        size = np.sqrt(self._widened * model.scale)
        curvature = sparse.diags_array(model.penalty_curvature)
        previous, baseline = curvature @ model.previous_jacobian, curvature @ model.baseline_jacobian
        for number in range(SAMPLES):
            noise = random.standard_normal(len(model.noise)) * model.noise
            pull = random.standard_normal(len(size))
            if self.drawn is not None:
                noise = noise + self.drawn @ random.standard_normal(self.drawn.shape[1])
            right = self._adjoint(model.data_curvature * noise) + self._penalties.T @ (size * pull)
            right += model.penalty_jacobian.T @ (model.steady_pull * pull)
            if self.before is not None:
                known = previous @ self.before.last[number] + baseline @ self.before.baseline[number]
                right -= model.penalty_jacobian.T @ known
            samples[number] = self._solved(right[model.free])
            pulled += samples[number] * (self._penalties.T @ (pull / size))[model.free] / SAMPLES
        return samples, pulled

    @property
    def shared_variance(self) -> Array:
        """What V moves, as `DenseErrors.shared_variance`; no more than all."""
        if self.drawn is None:
            return np.zeros(len(self.model.free))
        nothing = np.zeros((self.model.at.cell_resistance[0].size, self.drawn.shape[1]))
        return np.asarray(np.minimum(np.sum(self.answer(self.drawn, nothing, nothing) ** 2, axis=1), self.variance))

    @property
    def variance(self) -> Array:
        """The diagonal of S over the free cells."""
        return np.asarray(np.mean(self._drawn[0] ** 2, axis=0))

    def answer(self, rows: Array, last: Array, baseline: Array) -> Array:
        """What errors of the data (rows, n), the same as those that earlier estimates have (cells, n), do to log r."""
        model, answers = self.model, np.empty((len(self.model.free), rows.shape[1]))
        known = model.previous_jacobian @ last + model.baseline_jacobian @ baseline
        back = model.penalty_jacobian.T @ (model.penalty_curvature[:, None] * known)
        for number in range(rows.shape[1]):
            right = self._adjoint(model.data_curvature * rows[:, number]) - back[:, number]
            answers[:, number] = self._solved(right[model.free])
        return answers

    @property
    def resolution(self) -> Array:
        """The diagonal of the averaging kernel, held within 0 and 1 against the scatter of the samples."""
        return np.clip(1 - self._drawn[1], 0, 1)

    @cached_property
    def data_share(self) -> Array:
        """The row sums of the averaging kernel."""
        everywhere = np.zeros(self.model.at.cell_resistance.size)
        everywhere[self.model.free] = 1.0
        return self._solved(self._data(everywhere)[self.model.free], FINE)

    def released(self, cells: NDArray[np.intp]) -> Array:
        """Variance of cells (numbers) that stand at a bound if each alone were free among the free ones."""
        variance = np.empty(len(cells))
        for place, cell in enumerate(cells):
            unit = np.zeros(self.model.at.cell_resistance.size)
            unit[cell] = 1.0
            image = self._data(unit) + self._penalties.T @ (self._penalties @ unit)
            across = image[self.model.free]
            left = image[cell] - across @ self._solved(across)
            variance[place] = self.model.scale / max(left, IGNORANCE * self.model.scale)
        return variance

    def memory(self) -> SampledMemory:
        """What the next frame must know of the last one here; of two frames the first is the baseline."""
        size = self.model.at.cell_resistance[0].size
        samples = np.zeros((SAMPLES, self.model.at.cell_resistance.size))
        samples[:, self.model.free] = self._drawn[0]
        if len(self.model.at.cell_resistance) == 2:
            return SampledMemory(samples[:, size:], samples[:, :size])
        baseline = np.zeros_like(samples) if self.before is None else self.before.baseline
        return SampledMemory(samples, baseline, self._drawn_before + 1)
