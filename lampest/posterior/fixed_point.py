"""The fixed point of the evidence for the weights of any penalties, within a linear model or step by step.

λ_t = s² γ_t / η_t. What counts as γ and as η is the loss's to say; of the squared one γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t)
and η_t = Σ x². Source: MacKay, Neural Computation 4, 1992.
"""

from collections.abc import Collection, Sequence
from functools import partial

import numpy as np
from scipy.special import erf

from lampest.cost.losses import PenaltyEvidence
from lampest.cost.terms import term_kind
from lampest.files.errors import InputError
from lampest.posterior.dense import DenseErrors, positive_inverse, rank
from lampest.posterior.linear import IGNORANCE, LinearModel, penalty_curvature_of
from lampest.posterior.sampled import SampledErrors

MAX_ROUNDS, TOLERANCE = 30, 0.01  # of the fixed point; of log λ
# Of the mean curvature, a ridge; of a residual's unit, below which there are none yet.
RIDGE, MIN_RESIDUAL = 1e-9, 1e-12


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
        chosen[number] = model.scale * rows / (total if total > MIN_RESIDUAL * rows else rows)
    return chosen


def next_weights(model: LinearModel, open_terms: Collection[int]) -> list[float]:
    """One step of the fixed point at an estimate, traces from probes."""
    errors, weights = SampledErrors(model), list(model.at.weights)
    share = min(rank(model.at.cost.unweighted), len(model.free)) / len(np.unique(model.penalty_term))
    for number in open_terms:
        residual = model.penalty[model.penalty_term == number]
        evidence = PenaltyEvidence(residual, float(np.abs(residual).sum()), share, partial(errors.used, number))
        weights[number] = _weight(model, number, evidence)
    return weights


def settled_weights(model: LinearModel, open_terms: Collection[int]) -> list[float]:
    """Return where the open weights settle while the estimate follows them within the linear model, by matrices."""
    errors, weights = DenseErrors(model), list(model.at.weights)
    if not len(model.free):
        return weights
    weighted = errors.jacobian.T * model.data_curvature
    data, slope = weighted @ errors.jacobian, weighted @ model.residual
    rows = model.penalty_jacobian.toarray()[:, model.free]
    for _ in range(MAX_ROUNDS):
        curvature = penalty_curvature_of(model, np.asarray(weights))
        prior = (rows.T * curvature) @ rows
        inverse = positive_inverse(data + prior + IGNORANCE * model.scale * np.eye(len(data)))
        step = -inverse @ (slope + rows.T @ (curvature * model.penalty))
        alone = positive_inverse(prior + RIDGE * np.trace(prior) / len(prior) * np.eye(len(prior)))
        residual, before = model.penalty + rows @ step, weights
        weights = list(weights)
        for number in open_terms:
            own = model.penalty_term == number
            posterior, free = (
                np.einsum("ij,jk,ik->i", rows[own], matrix, rows[own], optimize=True) for matrix in (inverse, alone)
            )
            inside = curvature[own] > 0
            mean = residual[own][inside]
            size = np.sqrt(np.maximum(model.scale * posterior[inside], np.finfo(float).tiny))
            # E|x| of normal x.
            folded = size * np.sqrt(2 / np.pi) * np.exp(-0.5 * (mean / size) ** 2) + mean * erf(
                mean / size / np.sqrt(2)
            )
            count, used = (float(np.sum(curvature[own] * part)) for part in (free, posterior))
            evidence = PenaltyEvidence(mean, float(folded.sum()), count, partial(float, used))
            weights[number] = _weight(model, number, evidence)
        if max(abs(np.log(weight / earlier)) for weight, earlier in zip(weights, before, strict=True)) < TOLERANCE:
            break
    return weights


def _weight(model: LinearModel, term: int, evidence: PenaltyEvidence) -> float:
    """s² γ/η, as if at least one residual were determined."""
    loss = model.at.cost.terms[term].loss
    return model.scale * max(loss.determined(evidence), 1.0) / max(loss.size(evidence), np.finfo(float).tiny)
