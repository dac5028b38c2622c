"""Posterior of a Gaussian unknown by linear readings, d = A z + noise.

The unknown is z ~ N(0, P), the noise N(0, C). With the covariance S = A P Aᵀ + C of d

    mean = P Aᵀ S⁻¹ d,   cov = P − P Aᵀ S⁻¹ A P.

Independent sets of readings of one z ~ N(0, 1) add their information Λ = Σ Aᵀ C⁻¹ A and
v = Σ Aᵀ C⁻¹ d:

    cov = (1 + Λ)⁻¹,   mean = cov v,   −2 ln p(d) = Σ (dᵀ C⁻¹ d + ln|C|) + ln|1 + Λ| − vᵀ cov v.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky

from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Conditioned:
    """An unknown conditioned on one set of readings.

    Attributes
    ----------
    prior : array, shape (n, n)
        P, which may be singular.
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
        prior : array, shape (n, n)
            P.
        """
        across = prior @ columns.T
        return cls(prior, across, cholesky(columns @ across + noise, lower=True))

    def mean(self, change: Array) -> Array:
        """Return the posterior mean (n,), given d (readings,)."""
        return np.asarray(self.across @ cho_solve((self.root, True), change))

    @property
    def covariance(self) -> Array:
        """The posterior covariance, (n, n)."""
        return np.asarray(self.prior - self.across @ cho_solve((self.root, True), self.across.T))


@dataclass(frozen=True, eq=False)
class Information:
    """Information of independent sets of readings on one z ~ N(0, 1).

    Attributes
    ----------
    precision : array, shape (n, n)
        Λ.
    pull : array, shape (n,)
        v.
    cost : float
        Σ (dᵀ C⁻¹ d + ln|C|).
    """

    precision: Array
    pull: Array
    cost: float = 0.0

    @classmethod
    def of(cls, columns: Array, noise: Array, change: Array) -> "Information":
        """Return the information of readings d with the columns A and the noise C."""
        weighted = np.linalg.solve(noise, np.column_stack([columns, change]))
        return cls(
            columns.T @ weighted[:, :-1],
            columns.T @ weighted[:, -1],
            float(change @ weighted[:, -1] + np.linalg.slogdet(noise)[1]),
        )

    def __add__(self, other: "Information") -> "Information":
        """Return the information of both sets."""
        return Information(
            self.precision + other.precision, self.pull + other.pull, self.cost + other.cost
        )

    def share(self, share: float) -> "Information":
        """Return a share of the information."""
        return Information(share * self.precision, share * self.pull, share * self.cost)

    @property
    def covariance(self) -> Array:
        """The posterior covariance (1 + Λ)⁻¹, (n, n)."""
        return np.asarray(np.linalg.inv(np.eye(len(self.pull)) + self.precision))

    @property
    def mean(self) -> Array:
        """The posterior mean, (n,)."""
        return np.asarray(np.linalg.solve(np.eye(len(self.pull)) + self.precision, self.pull))

    @property
    def evidence_cost(self) -> float:
        """−2 ln p(d) of all sets, up to a constant."""
        volume = float(np.linalg.slogdet(np.eye(len(self.pull)) + self.precision)[1])
        return self.cost + volume - float(self.pull @ self.mean)
