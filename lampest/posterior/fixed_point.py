"""The fixed point of the evidence for the weights of any penalties, within a linear model or step by step.

Squared and Huber losses: λ_t = s² γ_t / η_t with γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t) and η_t = Σ x²; absolute losses, whose
prior is Laplace's: λ_t = 2 s² rank / Σ E|x|. Source: MacKay, Neural Computation 4, 1992.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from lampest.cost.losses import Absolute
from lampest.panel.panel import Array
from lampest.posterior.dense import IGNORANCE, DenseErrors, positive_inverse, rank
from lampest.posterior.linear import LinearModel, penalty_bend
from lampest.posterior.sampled import SampledErrors

MOST_ROUNDS, SETTLED, FLAT, NOTHING = 30, 0.01, 1e-9, 1e-12


def first_weights(model: LinearModel, weights: Sequence[float], open_terms: Collection[int]) -> list[float]:
    """λ_t = s² n / Σ x²: what n residuals of that size suggest, for the terms whose weights are open."""
    chosen = list(weights)
    for number in open_terms:
        size = model.penalty[model.penalty_term == number]
        absolute = isinstance(model.at.cost.terms[number].loss, Absolute)
        total = 0.5 * float(np.abs(size).sum()) if absolute else float(size @ size)
        # An estimate that is its own reference has no residuals yet: as if each were of its unit's size.
        chosen[number] = model.scale * len(size) / (total if total > NOTHING * len(size) else len(size))
    return chosen


def next_weights(model: LinearModel, open_terms: Collection[int]) -> list[float]:
    """One step of the fixed point at an estimate, traces from probes."""
    errors, weights = SampledErrors(model), list(model.at.cost.weights)
    share = min(rank(model.at.cost.unweighted), len(model.free)) / len(np.unique(model.penalty_term))
    for number in open_terms:
        own = model.penalty_term == number
        size = float(np.sum(model.penalty[own] ** 2))
        if isinstance(model.at.cost.terms[number].loss, Absolute):
            weights[number] = 2 * model.scale * share / max(float(np.abs(model.penalty[own]).sum()), 1e-300)
        else:
            weights[number] = model.scale * max(share - errors.used(number), 1.0) / max(size, 1e-300)
    return weights


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """The linear model of one estimate, as matrices over the cells; open_terms : whose weights are sought."""

    model: LinearModel
    open_terms: tuple[int, ...]

    def weights(self) -> list[float]:
        """Where the weights settle while the estimate follows them within the linear model."""
        errors, model = DenseErrors(self.model), self.model
        bent = errors.jacobian.T * model.data_curvature
        data, slope = bent @ errors.jacobian, bent @ model.residual
        rows = model.penalty_jacobian.toarray()[:, model.free]
        weights = list(model.at.cost.weights)
        if not len(model.free):
            return weights
        for _ in range(MOST_ROUNDS):
            curvature = penalty_bend(model, np.asarray(weights))
            prior = (rows.T * curvature) @ rows
            inverse = positive_inverse(data + prior + IGNORANCE * model.scale * np.eye(len(data)))
            step = -inverse @ (slope + rows.T @ (curvature * model.penalty))
            ridge = FLAT * np.trace(prior) / len(prior) * np.eye(len(prior))
            alone = positive_inverse(prior + ridge)
            new = self._updated(weights, rows, curvature, model.penalty + rows @ step, inverse, alone)
            moved = max(abs(np.log(one / other)) for one, other in zip(new, weights, strict=True))
            weights = new
            if moved < SETTLED:
                break
        return weights

    def _updated(
        self, weights: list[float], rows: Array, curvature: Array, size: Array, inverse: Array, alone: Array
    ) -> list[float]:
        new = list(weights)
        for number in self.open_terms:
            own = self.model.penalty_term == number
            bent = np.einsum("ij,jk,ik->i", rows[own], inverse, rows[own], optimize=True)
            free = np.einsum("ij,jk,ik->i", rows[own], alone, rows[own], optimize=True)
            if isinstance(self.model.at.cost.terms[number].loss, Absolute):
                expected = float(folded(size[own], self.model.scale * bent).sum())
                count = float(np.sum(curvature[own] * free))
                new[number] = 2 * self.model.scale * max(count, 1.0) / max(expected, 1e-300)
            else:
                inside = curvature[own] > 0
                count = float(np.sum(curvature[own] * (free - bent)))
                total = float(np.sum(size[own][inside] ** 2))
                new[number] = self.model.scale * max(count, 1.0) / max(total, 1e-300)
        return new


def folded(mean: Array, variance: Array) -> Array:
    """E|x| of normal x, any shape."""
    size = np.sqrt(np.maximum(variance, 1e-300))
    away = mean / size
    return np.asarray(size * np.sqrt(2 / np.pi) * np.exp(-0.5 * away**2) + mean * erf(away / np.sqrt(2)))
