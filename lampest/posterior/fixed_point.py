"""Fixed point of the evidence for the weights of any number of penalties, within a linear model or step by step.

λ_t = s² γ_t / η_t. The loss defines γ and η; for the squared loss γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t) and η_t = Σ x².
Source: MacKay, Neural Computation 4, 1992.
"""

from collections.abc import Collection, Sequence
from functools import partial

import numpy as np
from scipy.special import erf

from lampest.cost.losses import PenaltyEvidence
from lampest.cost.terms import term_kind
from lampest.files.errors import InputError
from lampest.posterior.covariance import DenseErrors, SampledErrors, positive_inverse
from lampest.posterior.linear import IGNORANCE, LinearModel, rank

MAX_ROUNDS, TOLERANCE = 30, 0.01  # iterations of the fixed point; change of log λ at which they end
# Regularisation relative to the mean curvature; mean η of a residual, in its unit, below which there are none yet.
RIDGE, MIN_RESIDUAL = 1e-9, 1e-12


def first_weights(model: LinearModel, weights: Sequence[float], open_terms: Collection[int]) -> list[float]:
    """Return weights with the first guess λ_t = s² n/η_t for the open terms (numbers), n their residuals."""
    chosen = list(weights)
    for number in open_terms:
        size = model.penalty[model.penalty_term == number]
        rows = len(size)
        if rows == 0:
            name = term_kind(model.at.cost.terms[number])
            raise InputError(f"weight: auto finds nothing of {name} on what is left of the panel; give a number")
        evidence = PenaltyEvidence(size, float(np.abs(size).sum()), rows, float)
        total = model.at.cost.terms[number].loss.size(evidence)
        # An estimate that is its own reference has no residuals yet: η = n, as if each were one unit.
        chosen[number] = model.scale * rows / (total if total > MIN_RESIDUAL * rows else rows)
    return chosen


def next_weights(model: LinearModel, open_terms: Collection[int]) -> list[float]:
    """Return the weights after one step of the fixed point at an estimate, with traces from random probes."""
    errors, weights = SampledErrors(model), list(model.at.weights)
    share = min(rank(model.at.cost.unweighted), len(model.free)) / len(np.unique(model.penalty_term))
    for number in open_terms:
        residual = model.penalty[model.penalty_term == number]
        evidence = PenaltyEvidence(residual, float(np.abs(residual).sum()), share, partial(errors.used, number))
        weights[number] = _weight(model, number, evidence)
    return weights


def settled_weights(model: LinearModel, open_terms: Collection[int]) -> list[float]:
    """Return the weights at the fixed point while the estimate follows them within the linear model, by matrices."""
    errors, weights = DenseErrors(model), list(model.at.weights)
    if not len(model.free):
        return weights
    weighted = errors.jacobian.T * model.data_curvature
    data, slope = weighted @ errors.jacobian, weighted @ model.residual
    rows = model.penalty_jacobian.toarray()[:, model.free]
    for _ in range(MAX_ROUNDS):
        # Estimate for the present weights: p = −A⁻¹ (Jᵀ Ω x̂ + Zᵀ Ω x̂)
        curvature = model.penalty_curvature_for(np.asarray(weights))
        prior = (rows.T * curvature) @ rows
        inverse = positive_inverse(data + prior + IGNORANCE * model.scale * np.eye(len(data)))
        step = -inverse @ (slope + rows.T @ (curvature * model.penalty))
        # B⁺, by a regularised inverse of the penalties alone
        alone = positive_inverse(prior + RIDGE * np.trace(prior) / len(prior) * np.eye(len(prior)))
        residual, before = model.penalty + rows @ step, weights
        weights = list(weights)
        for number in open_terms:
            own = model.penalty_term == number
            # diag(Z A⁻¹ Zᵀ) and diag(Z B⁺ Zᵀ) over the rows of the term
            posterior, free = (
                np.einsum("ij,jk,ik->i", rows[own], matrix, rows[own], optimize=True) for matrix in (inverse, alone)
            )
            inside = curvature[own] > 0
            mean = residual[own][inside]
            size = np.sqrt(np.maximum(model.scale * posterior[inside], np.finfo(float).tiny))
            # E|x| of x ~ N(mean, size²): size·√(2/π)·exp(−mean²/(2 size²)) + mean·erf(mean/(√2 size))
            folded = size * np.sqrt(2 / np.pi) * np.exp(-0.5 * (mean / size) ** 2) + mean * erf(
                mean / size / np.sqrt(2)
            )
            # tr(B⁺ B_t) and tr(A⁻¹ B_t)
            count, used = (float(np.sum(curvature[own] * part)) for part in (free, posterior))
            evidence = PenaltyEvidence(mean, float(folded.sum()), count, partial(float, used))
            weights[number] = _weight(model, number, evidence)
        if max(abs(np.log(weight / earlier)) for weight, earlier in zip(weights, before, strict=True)) < TOLERANCE:
            break
    return weights


def _weight(model: LinearModel, term: int, evidence: PenaltyEvidence) -> float:
    """Return s² γ/η of a term (number), with γ at least 1."""
    loss = model.at.cost.terms[term].loss
    return model.scale * max(loss.determined(evidence), 1.0) / max(loss.size(evidence), np.finfo(float).tiny)
