"""The fixed point of the evidence for the weights of any penalties, within a linear model or step by step.

λ_t = s² γ_t / η_t. What counts as γ and as η is the loss's to say; of the squared one γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t)
and η_t = Σ x². Source: MacKay, Neural Computation 4, 1992.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import erf

from lampest.cost.losses import Loss, PenaltyEvidence
from lampest.cost.terms import term_kind
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.posterior.dense import DenseErrors, positive_inverse, rank
from lampest.posterior.linear import IGNORANCE, LinearModel, penalty_curvature_of
from lampest.posterior.sampled import SampledErrors

MOST_ROUNDS, SETTLED = 30, 0.01  # of the fixed point; of log λ
FLAT, NOTHING = 1e-9, 1e-12  # of the mean curvature, a ridge; of a residual's unit, below which there are none yet


def first_weights(model: LinearModel, weights: Sequence[float], open_terms: Collection[int]) -> list[float]:
    """λ_t = s² n / η_t: what n residuals of that size suggest, for the terms whose weights are open."""
    chosen = list(weights)
    for number in open_terms:
        size = model.penalty[model.penalty_term == number]
        rows = len(size)
        if rows == 0:
            name = term_kind(model.at.cost.terms[number])
            raise InputError(f"weight: auto finds nothing of {name} on what is left of the panel; give a number")
        evidence = PenaltyEvidence(size, float(np.abs(size).sum()), rows, float)
        total = model.at.cost.terms[number].loss.size(evidence)
        # An estimate that is its own reference has no residuals yet: as if each were of its unit's size.
        chosen[number] = model.scale * rows / (total if total > NOTHING * rows else rows)
    return chosen


def next_weights(model: LinearModel, open_terms: Collection[int]) -> list[float]:
    """One step of the fixed point at an estimate, traces from probes."""
    errors, weights = SampledErrors(model), list(model.at.cost.weights)
    share = min(rank(model.at.cost.unweighted), len(model.free)) / len(np.unique(model.penalty_term))
    for number in open_terms:
        residual = model.penalty[model.penalty_term == number]
        evidence = PenaltyEvidence(residual, float(np.abs(residual).sum()), share, partial(errors.used, number))
        weights[number] = settled_weight(model.scale, model.at.cost.terms[number].loss, evidence)
    return weights


def settled_weight(scale: float, loss: Loss, evidence: PenaltyEvidence) -> float:
    """s² γ/η, as if at least one residual were determined."""
    return scale * max(loss.determined(evidence), 1.0) / max(loss.size(evidence), np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """The linear model of one estimate, as matrices over the cells; open_terms : whose weights are sought."""

    model: LinearModel
    open_terms: tuple[int, ...]

    def weights(self) -> list[float]:
        """Where the weights settle while the estimate follows them within the linear model."""
        errors, model = DenseErrors(self.model), self.model
        weighted = errors.jacobian.T * model.data_curvature
        data, slope = weighted @ errors.jacobian, weighted @ model.residual
        rows = model.penalty_jacobian.toarray()[:, model.free]
        weights = list(model.at.cost.weights)
        if not len(model.free):
            return weights
        for _ in range(MOST_ROUNDS):
            curvature = penalty_curvature_of(model, np.asarray(weights))
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
            posterior = np.einsum("ij,jk,ik->i", rows[own], inverse, rows[own], optimize=True)
            free = np.einsum("ij,jk,ik->i", rows[own], alone, rows[own], optimize=True)
            inside = curvature[own] > 0
            residual = size[own][inside]
            magnitude = float(folded(residual, self.model.scale * posterior[inside]).sum())
            count, used = (float(np.sum(curvature[own] * part)) for part in (free, posterior))
            evidence = PenaltyEvidence(residual, magnitude, count, partial(float, used))
            loss = self.model.at.cost.terms[number].loss
            new[number] = settled_weight(self.model.scale, loss, evidence)
        return new


def folded(mean: Array, variance: Array) -> Array:
    """E|x| of normal x, any shape."""
    size = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    away = mean / size
    return np.asarray(size * np.sqrt(2 / np.pi) * np.exp(-0.5 * away**2) + mean * erf(away / np.sqrt(2)))
