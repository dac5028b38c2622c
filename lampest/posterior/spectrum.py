"""A linear model with one penalty of unknown weight λ, solved for all λ at once; and what the rules say of each λ.

With the data's curvature A = Jᵀ Ω J = R Rᵀ and R⁻¹ Zᵀ Z R⁻ᵀ = Q diag(κ) Qᵀ the change of the estimate is p = T q with
T = R⁻ᵀ Q and q(λ) = −f·(b + λd), f = 1/(1 + λκ), where b and d are the slopes of misfit and penalty. Everything that a
rule asks for, determinants and traces too, is a sum over κ.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, eigh, solve_triangular
from scipy.optimize import minimize_scalar

from lampest.panel.panel import Array
from lampest.posterior.dense import DenseErrors, rank
from lampest.posterior.linear import IGNORANCE, LinearModel

Rule = Literal["risk", "evidence", "press"]
POINTS = 80  # of a grid of log λ, between which the least value is searched for
BEYOND, LEAST = 1e4, 1e-12  # times the stiffest and softest direction; of the stiffest, below which there is none


@dataclass(frozen=True, eq=False)
class Spectrum:
    """stiffness : κ, ascending. misfit_slope, penalty_slope : b, d. directions : √Ω J T (data rows, unknowns).

    residual : √Ω·x̂ of the data. penalty : Σ x̂² of the penalty. scale : s². rank : of the penalty.
    volume : log det(A/s²). gram : Tᵀ T. spread : cov(q) at λ = 0, times Tᵀ T element by element.
    """

    stiffness: Array
    misfit_slope: Array
    penalty_slope: Array
    directions: Array
    residual: Array
    penalty: float
    scale: float
    rank: int
    volume: float
    gram: Array
    spread: Array

    @classmethod
    def of(cls, model: LinearModel) -> "Spectrum":
        """Of an estimate with one penalty, which reweighted least squares stand for where its loss is not squared.

        A residual x̂ weighs ½ρ'(x)/x at x = x̂. Under an absolute loss x² = x̂² + v, v the mean variance of residuals
        without a penalty: what stands at 0 would go as far. Raises LinAlgError where data leave it flat.
        """
        size = np.sqrt(model.data_curvature)
        jacobian = DenseErrors(model).jacobian * size[:, None]
        matrix = jacobian.T @ jacobian
        matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
        factor, _ = cho_factor(matrix, lower=True)
        loss, far = model.at.cost.terms[model.penalty_term[0]].loss, model.penalty
        penalties = solve_triangular(factor, model.penalty_jacobian.toarray()[:, model.free].T, lower=True)
        if loss.enters == "dual":
            noisy = solve_triangular(factor, jacobian.T * (size * model.noise), lower=True)
            far = np.sqrt(far**2 + np.sum((noisy.T @ penalties) ** 2) / len(far))
        pull = np.sqrt(loss.stiffness(far))
        penalty, penalties = pull * model.penalty, pull * penalties
        stiffness, vectors = eigh(penalties @ penalties.T)
        back = solve_triangular(factor, vectors, lower=True, trans="T")
        directions, residual = jacobian @ back, size * model.residual
        gram, noise = back.T @ back, directions * (size * model.noise)[:, None]
        return cls(
            np.maximum(stiffness, 0),
            directions.T @ residual,
            vectors.T @ (penalties @ penalty),
            directions,
            residual,
            float(penalty @ penalty),
            model.scale,
            min(rank(model.at.cost.unweighted), len(stiffness)),
            float(np.sum(np.log(np.diag(factor) ** 2 / model.scale))),
            gram,
            (noise.T @ noise) * gram,
        )

    def change(self, weight: float) -> Array:
        """q, from the estimate to the minimum for a weight."""
        return np.asarray(-(self.misfit_slope + weight * self.penalty_slope) / (1 + weight * self.stiffness))

    def misfit(self, weight: float) -> float:
        """ρ = Σ ω x² over the data."""
        residual = self.residual + self.directions @ self.change(weight)
        return float(residual @ residual)

    def penalised(self, weight: float) -> float:
        """η = Σ x² over the penalty."""
        change = self.change(weight)
        return max(self.penalty + float(change @ (2 * self.penalty_slope + self.stiffness * change)), 0.0)

    def evidence(self, weight: float) -> float:
        """(ρ + λη)/s² + log det((A + λ ZᵀZ)/s²) − rank·log(λ/s²): −2·log of the evidence for λ, up to a constant."""
        fit = (self.misfit(weight) + weight * self.penalised(weight)) / self.scale
        volume = self.volume + float(np.sum(np.log1p(weight * self.stiffness)))
        return fit + volume - self.rank * float(np.log(weight / self.scale))

    def press(self, weight: float) -> float:
        """(Σ |e_i/(1 − h_i)|)²: every reading predicted from all others; needs no noise.

        Sizes, not squares: a few readings that no weight explains do not decide.
        """
        residual = self.residual + self.directions @ self.change(weight)
        leverage = self.directions**2 @ (1 / (1 + weight * self.stiffness))
        return float(np.sum(np.abs(residual / np.maximum(1 - leverage, 1e-12))) ** 2)

    def risk(self, weight: float) -> float:
        """An estimate of Σ (log r̂ − log r)²: the noise that is left, and the square of what the penalty pulls away.

        The latter is the mean of the distance to the estimate without a penalty, which is unbiased and noisy (Eldar,
        IEEE Trans. Signal Process. 57, 2009), and what the penalty would do to the present estimate.
        """
        left = 1 / (1 + weight * self.stiffness)
        apart = np.where(self.determined, self.change(weight) + self.misfit_slope, 0.0)
        pulled = np.where(self.determined, weight * self.penalty_slope * left, 0.0)
        everything = np.ones(len(left))
        unbiased = apart @ self.gram @ apart + (2 * left - everything) @ self.spread @ everything
        present = pulled @ self.gram @ pulled + left @ self.spread @ left
        return float(unbiased + present) / 2

    @cached_property
    def determined(self) -> NDArray[np.bool_]:
        """Of whose precision the data make up more than `IGNORANCE` does; all, where there are none."""
        most = np.sum(self.directions**2, axis=0) > 0.5
        return np.asarray(most | ~most.any())

    @property
    def extent(self) -> tuple[float, float]:
        """log of the smallest and of the largest λ that make a difference to what data determine."""
        stiffness = self.stiffness[self.determined]
        seen = stiffness[stiffness > LEAST * stiffness.max()]
        return -float(np.log(BEYOND * seen.max())), float(np.log(BEYOND / seen.min()))


def best_weight(spectra: Sequence[Spectrum], rule: Rule) -> float:
    """The λ that minimises a rule's function over several estimates, among all λ that make a difference to any.

    Functions are summed; those of `press` multiplied, as likelihoods with an unknown variance are.
    """
    together = math.prod if rule == "press" else sum

    extents = [spectrum.extent for spectrum in spectra]

    def value(place: float) -> float:
        places = (float(np.exp(min(max(place, least), most))) for least, most in extents)
        return float(together(getattr(spectrum, rule)(at) for spectrum, at in zip(spectra, places, strict=True)))

    lowest, highest = zip(*extents, strict=True)
    grid = np.linspace(min(lowest), max(highest), POINTS)
    least = int(np.argmin([value(place) for place in grid]))
    between = (grid[max(least - 1, 0)], grid[min(least + 1, POINTS - 1)])
    return float(np.exp(minimize_scalar(value, bounds=between, options={"xatol": 0.01}).x))
