"""Posterior of a Gaussian unknown by linear readings, d = A z + noise.

The unknown is z ~ N(0, P), the noise N(0, C). With the covariance S = A P Aᵀ + C of d

    mean = P Aᵀ S⁻¹ d,   cov = P − P Aᵀ S⁻¹ A P.

Independent sets of readings of one z ~ N(0, 1) add their information Λ = Σ Aᵀ C⁻¹ A and
v = Σ Aᵀ C⁻¹ d:

    cov = (1 + Λ)⁻¹,   mean = cov v.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Conditioned:
    """An unknown conditioned on one set of readings.

    Attributes
    ----------
    prior : array, shape (n, n) or (n,)
        P, which may be singular; the variances of independent unknowns alone.
    across : array, shape (n, readings)
        P Aᵀ.
    root : array, shape (readings, readings)
        Lower Cholesky factor of S.
    """

    prior: Array
    across: Array
    root: Array

    @classmethod
    def on(cls, columns: Array, noise: Array, prior: Array) -> "Conditioned":
        """Return an unknown of this prior, conditioned on readings.

        Parameters
        ----------
        columns : array, shape (readings, n)
            A.
        noise : array, shape (readings, readings)
            C.
        prior : array, shape (n, n) or (n,)
            P, or its diagonal.
        """
        across = (columns * prior).T if prior.ndim == 1 else prior @ columns.T
        return cls(prior, across, cholesky(columns @ across + noise, lower=True))

    def mean(self, change: Array) -> Array:
        """Return the posterior mean (n,), given d (readings,)."""
        return np.asarray(self.across @ cho_solve((self.root, True), change))

    @property
    def covariance(self) -> Array:
        """The posterior covariance, (n, n)."""
        prior = np.diag(self.prior) if self.prior.ndim == 1 else self.prior
        white = solve_triangular(self.root, self.across.T, lower=True, check_finite=False)
        return np.asarray(prior - white.T @ white)


def posterior_covariance(columns: Array, noise: Array, prior: Array) -> Array:
    """Return the covariance L (1 + Lᵀ Aᵀ C⁻¹ A L)⁻¹ Lᵀ of an unknown given readings, P = L Lᵀ.

    P − P Aᵀ S⁻¹ A P of a wide prior is a difference of nearly equal numbers. Here all summands are
    positive: relative errors are those of rounding, however much the readings determine.

    Parameters
    ----------
    columns : array, shape (readings, n)
        A.
    noise : array, shape (readings, readings)
        C, positive definite.
    prior : array, shape (n, n) or (n,)
        P, which may be singular, or its diagonal.
    """
    root = np.diag(np.sqrt(prior)) if prior.ndim == 1 else lower_root(prior)
    white = solve_triangular(cholesky(noise, lower=True), columns @ root, lower=True)
    # 1 + white ᵀwhite = RᵀR without forming the square, whose small eigenvalues would be rounding
    triangle = np.linalg.qr(np.vstack([white, np.eye(len(root))]), mode="r")
    scaled = solve_triangular(triangle, root.T, trans="T")
    return np.asarray(scaled.T @ scaled)


@dataclass(frozen=True, eq=False)
class Information:
    """Information of independent sets of readings on one z ~ N(0, 1).

    Attributes
    ----------
    precision : array, shape (n, n)
        Λ.
    pull : array, shape (n,)
        v.
    """

    precision: Array
    pull: Array

    def __add__(self, other: "Information") -> "Information":
        """Return the information of both sets."""
        return Information(self.precision + other.precision, self.pull + other.pull)

    def share(self, share: float) -> "Information":
        """Return a share of the information."""
        return Information(share * self.precision, share * self.pull)

    @property
    def covariance(self) -> Array:
        """The posterior covariance (1 + Λ)⁻¹, (n, n)."""
        return np.linalg.inv(np.eye(len(self.pull)) + self.precision)

    @property
    def mean(self) -> Array:
        """The posterior mean, (n,)."""
        return np.linalg.solve(np.eye(len(self.pull)) + self.precision, self.pull)


def forms_over_scales(square: Array, vectors: Array, scales: Array) -> tuple[Array, Array]:
    """Return Bᵀ V⁻¹ B and ln |V| of V = 1 + s² S for several scales s.

    The eigenvalues of S serve all scales.

    Parameters
    ----------
    square : array, shape (n, n)
        S, symmetric and not negative.
    vectors : array, shape (n, k)
        B.
    scales : array, shape (scales,)
        s.

    Returns
    -------
    forms : array, shape (scales, k, k)
    volumes : array, shape (scales,)
    """
    values, basis = np.linalg.eigh(square)
    turned = basis.T @ vectors
    # Rounding may have made eigenvalues negative.
    weights = 1 + np.square(scales)[:, None] * np.maximum(values, 0.0)
    return (turned.T / weights[:, None]) @ turned, np.log(weights).sum(axis=1)


def lower_root(square: Array) -> Array:
    """Return a lower triangular root of a symmetric matrix.

    Its negative eigenvalues count as zero.
    """
    values, vectors = np.linalg.eigh((square + square.T) / 2)
    return np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1].T
