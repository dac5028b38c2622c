"""Choice of weights in a linear model, by risk or evidence.

The risk of one penalty's weight follows from a singular value decomposition that serves all weights
λ.

The data and the other penalties o have the curvature A = Jᵀ Ω J + Σ λ_o Z_oᵀ Z_o. With A = R Rᵀ and
R⁻¹ Zᵀ = Q diag(√κ) Vᵀ, the change of the estimate is p = T q with T = R⁻ᵀ Q and q(λ) = −f·(b + λ
d), f = 1/(1 + λ κ), where b and d are the slopes of everything else and of the penalty. The risk
that the weight minimises is a sum over κ.

The evidence chooses the weights of any number of penalties by a fixed point, λ_t = s² γ_t / η_t.
The loss defines γ and η; for the squared loss γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t) and η_t = Σ x².
Source: MacKay, Neural Computation 4, 1992.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_factor, solve_triangular
from scipy.special import erf

from lampest.cost.losses import PenaltyEvidence
from lampest.cost.terms import term_kind
from lampest.files.errors import InputError
from lampest.panel.panel import Array, Mask
from lampest.panel.trust_region import golden_section
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.linear import IGNORANCE, LinearModel, positive_inverse

if TYPE_CHECKING:
    from lampest.posterior.sampled import SampledErrors

GRID = 80  # points in log λ, between which the minimum is refined
PRECISION = 0.005  # of log λ
# Factor of the range of λ beyond the stiffest and the softest direction; share of the largest κ
# below which κ is zero.
EXTENT_FACTOR = 1e4
NEGLIGIBLE = 1e-24
# iterations of the fixed point; change of log λ at which they end
MAX_ROUNDS = 30
TOLERANCE = 0.01
# Regularisation relative to the mean curvature; mean η of a residual, in its unit, below which
# there are none yet.
RIDGE = 1e-9
MIN_RESIDUAL = 1e-12


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Linear model for all weights of one of its penalties.

    Attributes
    ----------
    stiffness : array, shape (unknowns,)
        κ, descending.
    pull, penalty_slope : array, shape (unknowns,)
        Slopes in the basis T: b_o of the other penalties, and d of this one at λ = 1.
    directions : array, shape (data rows, unknowns)
        √Ω J T.
    penalty : float
        Σ x̂² of the penalty.
    volume : float
        log det(A/s²).
    gram : array, shape (unknowns, unknowns)
        Tᵀ T.
    spread, doubt : array, shape (unknowns, unknowns)
        Elementwise products of Tᵀ T with cov(q) at λ = 0, and with the covariance of T⁻¹ u.
    """

    stiffness: Array
    pull: Array
    penalty_slope: Array
    directions: Array
    penalty: float
    volume: float
    gram: Array
    spread: Array
    doubt: Array

    @classmethod
    def of(
        cls, model: LinearModel, number: int | None = None, covariance: Array | None = None
    ) -> "Spectrum":
        """Return the spectrum of one penalty of a model.

        A loss that is not squared is replaced by reweighted least squares with the weight ½ρ'(x)/x
        at x = x̂. Under an absolute loss x² = x̂² + v, v the mean variance of residuals without a
        penalty. `number` is that of the penalty's term, if there are several, `covariance` that of
        log r, (cells, cells), at the point of linearisation, None if that is exact. Raises
        numpy.linalg.LinAlgError if the cost without this penalty is flat.
        """
        number = model.penalty_term[0] if number is None else number
        size = np.sqrt(model.data_curvature)
        of_term = model.penalty_term == number
        jacobian = DenseErrors(model).jacobian * size[:, None]
        rows = model.penalty_jacobian.toarray()[:, model.free]
        curvature = model.penalty_curvature[~of_term]
        # A = R Rᵀ of the data, the other penalties and the prior precision
        matrix = jacobian.T @ jacobian + (rows[~of_term].T * curvature) @ rows[~of_term]
        matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
        factor = cho_factor(matrix, lower=True)[0]
        # R⁻¹ Zᵀ, with rows of Z weighted by √(½ρ'(x)/x)
        loss = model.at.cost.terms[number].loss
        residual = model.penalty[of_term]
        penalties = solve_triangular(factor, rows[of_term].T, lower=True)
        if loss.enters == "dual":
            noisy = solve_triangular(factor, jacobian.T * (size * model.noise), lower=True)
            variance = np.sum((noisy.T @ penalties) ** 2) / len(residual)
            residual = np.sqrt(residual**2 + variance)
        weight = np.sqrt(loss.stiffness(residual))
        penalty = weight * model.penalty[of_term]
        penalties = weight * penalties
        # R⁻¹ Zᵀ = Q diag(√κ) Vᵀ, T = R⁻ᵀ Q; its square would lose κ below 1e-16 of the largest
        _, triangle = np.linalg.qr(penalties.T)
        vectors, root, _ = np.linalg.svd(triangle.T)
        stiffness = np.zeros(len(vectors))
        stiffness[: len(root)] = root**2
        basis = solve_triangular(factor, vectors, lower=True, trans="T")
        directions = jacobian @ basis
        gram = basis.T @ basis
        noise = directions * (size * model.noise)[:, None]
        # Covariance of T⁻¹ u = Qᵀ Rᵀ u. Absolute losses hold cells where the reference cannot.
        doubt = np.zeros_like(gram)
        back = vectors.T @ np.tril(factor).T
        if covariance is not None and loss.enters != "dual":
            doubt = back @ covariance[np.ix_(model.free, model.free)] @ back.T
        return cls(
            stiffness=stiffness,
            pull=basis.T @ (rows[~of_term].T @ (curvature * model.penalty[~of_term])),
            penalty_slope=vectors.T @ (penalties @ penalty),
            directions=directions,
            penalty=float(penalty @ penalty),
            volume=float(np.sum(np.log(np.diag(factor) ** 2 / model.scale))),
            gram=gram,
            spread=(noise.T @ noise) * gram,
            doubt=doubt * gram,
        )

    def risk(self, weight: float) -> float:
        """Return the expected squared error E Σ (log r̂ − log r)².

        The truth lies near the point of linearisation. The error is ‖T f (b_o + λ d)‖² + tr cov(T f
        q₀) + tr cov(T (1 − f) T⁻¹ u): the squared bias of the penalties, the variance due to noise,
        and the bias due to the uncertainty of the point of linearisation.
        """
        remaining = 1 / (1 + weight * self.stiffness)
        pulled = np.where(
            self.determined, (self.pull + weight * self.penalty_slope) * remaining, 0.0
        )
        lost = np.where(self.determined, 1 - remaining, 0.0)
        return float(
            pulled @ self.gram @ pulled
            + remaining @ self.spread @ remaining
            + lost @ self.doubt @ lost
        )

    def information(self, weight: float) -> float:
        """Return ½ Σ f², the Fisher information of the data on log λ.

        The sum is over the directions with a penalty.
        """
        return float(0.5 * np.sum((1 / (1 + weight * self._effective)) ** 2))

    @property
    def _effective(self) -> Array:
        """κ above rounding in directions that data determine."""
        penalised = self.stiffness > NEGLIGIBLE * self.stiffness.max()
        return np.asarray(self.stiffness[penalised & self.determined])

    @cached_property
    def determined(self) -> Mask:
        """Directions to which data add most of the precision, boolean (unknowns,).

        The rest is that of the other penalties and of IGNORANCE. All directions if there are none.
        """
        # Share of the data in the precision of data, other penalties and ignorance.
        mostly_by_data = np.sum(self.directions**2, axis=0) > 0.5
        return np.asarray(mostly_by_data | ~mostly_by_data.any())

    @property
    def extent(self) -> tuple[float, float]:
        """Logarithms of the least and the largest λ that affect directions the data determine."""
        effective = self._effective
        smallest = -float(np.log(EXTENT_FACTOR * effective.max()))
        return smallest, float(np.log(EXTENT_FACTOR / effective.min()))


def best_weight(spectra: Sequence[Spectrum]) -> float:
    """Return the λ of least risk, summed over spectra, within the range of their extents."""
    extents = [spectrum.extent for spectrum in spectra]

    def value(log_weight: float) -> float:
        pairs = zip(spectra, extents, strict=True)
        return sum(
            spectrum.risk(np.exp(np.clip(log_weight, *extent))) for spectrum, extent in pairs
        )

    lowest, highest = zip(*extents, strict=True)
    # Global minimum on a grid of log λ, refined between its neighbours
    grid = np.linspace(min(lowest), max(highest), GRID)
    least = int(np.argmin([value(place) for place in grid]))
    low = grid[max(least - 1, 0)]
    high = grid[min(least + 1, GRID - 1)]
    return float(np.exp(golden_section(value, low, high, PRECISION)))


def first_weights(
    model: LinearModel, weights: Sequence[float], open_terms: Collection[int]
) -> list[float]:
    """Return weights with the first guess λ_t = s² n/η_t for the open terms (numbers).

    n are their residuals.
    """
    chosen = list(weights)
    for number in open_terms:
        size = model.penalty[model.penalty_term == number]
        rows = len(size)
        if rows == 0:
            name = term_kind(model.at.cost.terms[number])
            raise InputError(
                f"weight: auto finds nothing of {name} on what is left of the panel; give a number"
            )
        evidence = PenaltyEvidence(size, float(np.abs(size).sum()), rows, float)
        total = model.at.cost.terms[number].loss.size(evidence)
        # An estimate that is its own reference has no residuals yet: η = n, as if each were one
        # unit.
        chosen[number] = model.scale * rows / (total if total > MIN_RESIDUAL * rows else rows)
    return chosen


def next_weights(errors: "SampledErrors", open_terms: Collection[int]) -> list[float]:
    """Return the weights after one step of the fixed point at an estimate with sampled errors.

    The step is with sums over random changes. E|x| is the mean of |x̂ + Z δ| over δ ~ N(0, s² A⁻¹).
    With |x̂| alone, a penalty without residuals would have an infinite weight.
    """
    model = errors.model
    weights = list(model.at.weights)
    for number in open_terms:
        of_term = model.penalty_term == number
        residual = model.penalty[of_term]
        magnitude = float(np.abs(residual[:, None] + errors.draws[of_term]).mean(axis=1).sum())
        evidence = PenaltyEvidence(residual, magnitude, errors.share, partial(errors.used, number))
        weights[number] = _weight(model, number, evidence)
    return weights


def settled_weights(
    model: LinearModel, open_terms: Collection[int], rounds: int = MAX_ROUNDS
) -> list[float]:
    """Return the weights at the fixed point while the estimate follows them, by matrices.

    The estimate follows the weights within the linear model. One round is a step of the fixed point
    at the estimate itself, as that of `next_weights`.
    """
    errors = DenseErrors(model)
    weights = list(model.at.weights)
    if not len(model.free):
        return weights
    weighted = errors.jacobian.T * model.data_curvature
    data = weighted @ errors.jacobian
    slope = weighted @ model.residual
    rows = model.penalty_jacobian.toarray()[:, model.free]
    for _ in range(rounds):
        # Estimate for the present weights: p = −A⁻¹ (Jᵀ Ω x̂ + Zᵀ Ω x̂)
        curvature = model.penalty_curvature_for(np.asarray(weights))
        prior = (rows.T * curvature) @ rows
        unit = np.eye(len(data))
        inverse = positive_inverse(data + prior + IGNORANCE * model.scale * unit)
        step = -inverse @ (slope + rows.T @ (curvature * model.penalty))
        # B⁺, by a regularised inverse of the penalties alone
        prior_inverse = positive_inverse(prior + RIDGE * np.trace(prior) / len(prior) * unit)
        # diag(Z A⁻¹ Zᵀ) and diag(Z B⁺ Zᵀ)
        posterior, free = (
            np.sum((rows @ each) * rows, axis=1) for each in (inverse, prior_inverse)
        )
        residual = model.penalty + rows @ step
        previous = weights
        weights = list(weights)
        for number in open_terms:
            inside = (model.penalty_term == number) & (curvature > 0)
            mean = residual[inside]
            size = np.sqrt(np.maximum(model.scale * posterior[inside], np.finfo(float).tiny))
            # tr(B⁺ B_t) and tr(A⁻¹ B_t)
            count, used = (float(curvature[inside] @ form[inside]) for form in (free, posterior))
            # E|x| of x ~ N(mean, size²)
            # size·√(2/π)·exp(−mean²/(2 size²)) + mean·erf(mean/(√2 size))
            spread = size * np.sqrt(2 / np.pi) * np.exp(-0.5 * (mean / size) ** 2)
            magnitude = float((spread + mean * erf(mean / size / np.sqrt(2))).sum())
            evidence = PenaltyEvidence(mean, magnitude, count, partial(float, used))
            weights[number] = _weight(model, number, evidence)
        if np.abs(np.log(np.divide(weights, previous))).max() < TOLERANCE:
            break
    return weights


def _weight(model: LinearModel, term: int, evidence: PenaltyEvidence) -> float:
    """Return s² γ/η of a term (number), with γ at least 1."""
    loss = model.at.cost.terms[term].loss
    determined = max(loss.determined(evidence), 1.0)
    return model.scale * determined / max(loss.size(evidence), np.finfo(float).tiny)
