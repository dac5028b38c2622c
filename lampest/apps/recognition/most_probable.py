"""Most probable states under Gaussian priors, and the readings that contradict them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, lapack

from lampest.files.levels import SIGNIFICANT
from lampest.panel.panel import Array, Numbers
from lampest.posterior.gaussian import Conditioned, posterior_covariance

# Of ln r: the longest Gauss-Newton step.
MAX_STEP = 1.5
OUTLIER_SHARE = 0.03  # largest share of outliers among the readings


@dataclass(frozen=True, eq=False)
class Whitening:
    """Lower triangular root L of a covariance C of the readings, which whitens residuals.

    Attributes
    ----------
    root : array, shape (readings, readings)
        L.
    """

    root: Array

    @classmethod
    def of(cls, covariance: Array) -> "Whitening":
        """Return the whitening of C, (readings, readings)."""
        return cls(cholesky(covariance, lower=True))

    @property
    def matrix(self) -> Array:
        """L⁻¹, (readings, readings)."""
        return self @ np.eye(len(self.root))

    @cached_property
    def volume(self) -> float:
        """½ ln det C."""
        return float(np.log(np.diag(self.root)).sum())

    def __matmul__(self, vectors: Array) -> Array:
        """Return L⁻¹ v, errors of unit variance."""
        return np.asarray(lapack.dtrtrs(self.root, vectors, lower=1)[0])


class MostProbable(NamedTuple):
    """The minimum x of (y − f(x))ᵀ C⁻¹ (y − f(x)) + (x − mean)ᵀ P⁻¹ (x − mean).

    f is linearised near it.

    Attributes
    ----------
    state : array, shape (n,)
        x.
    conditioned : Conditioned
        x − mean, given the readings with the Jacobian A of f.
    slope, noise : array, shapes (readings, n) and (readings, readings)
        A and C.
    apart : array, shape (readings,)
        y − f(mean) by the linearised f.
    """

    state: Array
    conditioned: Conditioned
    slope: Array
    noise: Array
    apart: Array

    @property
    def whitening(self) -> Whitening:
        """Root of A P Aᵀ + C."""
        return Whitening(self.conditioned.root)

    @property
    def covariance(self) -> Array:
        """Posterior covariance of x, (n, n)."""
        return posterior_covariance(self.slope, self.noise, self.conditioned.prior)

    @property
    def misfit(self) -> float:
        """The minimum of the linearised cost: |root⁻¹ apart|²."""
        errors = self.whitening @ self.apart
        return float(errors @ errors)


def most_probable(
    model: Callable[[Array], tuple[Array, Array, Array]],
    start: Array,
    mean: Array,
    prior: Array,
    settled: float,
) -> MostProbable:
    """Return the most probable point, by at most twelve Gauss-Newton steps.

    The steps are in the space of the readings.

    Parameters
    ----------
    model : callable
        Returns y − f(x), A = ∂f/∂x and C, given x.
    start, mean : array, shape (n,)
        Initial x, and mean of the prior.
    prior : array, shape (n, n) or (n,)
        P, which may be singular; the variances of independent components alone.
    settled : float
        Largest component of the last step.
    """
    state = start
    for _ in range(12):
        residual, slope, noise = model(state)
        conditioned = Conditioned.on(slope, noise, prior)
        innovation = residual + slope @ (state - mean)
        # x = mean + P Aᵀ (A P Aᵀ + C)⁻¹ (y − f(x₀) + A (x₀ − mean))
        step = np.clip(mean + conditioned.mean(innovation) - state, -MAX_STEP, MAX_STEP)
        state = state + step
        if np.abs(step).max() < settled:
            break
    return MostProbable(state, conditioned, slope, noise, innovation)


def outliers(whitening: Whitening, residual: Array) -> Numbers:
    """Return the numbers of the readings that deviate from their prediction by all other readings.

    z_i = (C⁻¹e)_i/√(C⁻¹)_ii is the leave-one-out residual over its standard deviation. The largest
    one above SIGNIFICANT is removed before the next is determined, OUTLIER_SHARE of the readings at
    most.

    Parameters
    ----------
    whitening : Whitening
        Root of C.
    residual : array, shape (readings,)
        e.
    """
    inverse = whitening.matrix
    precision = inverse.T @ inverse
    pull = precision @ residual
    fitting = np.ones(len(residual), dtype=bool)
    for _ in range(max(1, int(OUTLIER_SHARE * len(residual)))):
        # z²
        score = np.divide(pull**2, np.diag(precision), out=np.zeros(len(pull)), where=fitting)
        worst = np.argmax(score)
        if score[worst] <= SIGNIFICANT**2:
            break
        fitting[worst] = False
        # marginalise reading w: C⁻¹ ← C⁻¹ − C⁻¹_·w C⁻¹_w·/C⁻¹_ww
        column = precision[:, worst] / precision[worst, worst]
        pull = pull - column * pull[worst]
        precision = precision - np.outer(column, precision[worst])
    return np.flatnonzero(~fitting)
