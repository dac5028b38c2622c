"""Levenberg–Marquardt method for nonlinear least squares within bounds.

    minimise ½ |f(x)|² over lower ≤ x ≤ upper,   (JᵀJ + μ diag(JᵀJ)) δ = −Jᵀ f

Source: Moré, The Levenberg-Marquardt algorithm, Lecture Notes in Mathematics 630, Springer, 1978.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from lampest.panel.panel import Array, Mask

LEAST_DAMPING = 1e-6  # μ that good steps reach; smaller ones change nothing
FIRST_DAMPING = 1e-3  # least μ after a failed step
MIN_LENGTH = 1e-300  # of a step, so that nothing is divided by zero


@dataclass(frozen=True, eq=False)
class SumOfSquares:
    """Linearised sum of squares about one point.

    Attributes
    ----------
    residual : array, shape (n,)
        f.
    jacobian : array, shape (n, unknowns)
        J.
    ridge : float
        1/variance of a step, added to the diagonal of JᵀJ. Unknowns that no residual depends on
        keep their values.
    """

    residual: Array
    jacobian: Array
    ridge: float = 0.0

    @cached_property
    def cost(self) -> float:
        """Cost ½ |f|²."""
        return float(self.residual @ self.residual) / 2

    @cached_property
    def gradient(self) -> Array:
        """Gradient Jᵀ f, (unknowns,)."""
        return self.jacobian.T @ self.residual

    @cached_property
    def normal(self) -> Array:
        """Normal matrix JᵀJ + ridge·1, (unknowns, unknowns)."""
        normal = self.jacobian.T @ self.jacobian
        normal[np.diag_indices(len(normal))] += self.ridge
        return normal


class Linearised(Protocol):
    """Interface of a linearised sum of squares; see `SumOfSquares`."""

    @property
    def cost(self) -> float:
        """Cost, half the sum of squares."""

    @property
    def gradient(self) -> Array:
        """Its gradient, (unknowns,)."""

    @property
    def normal(self) -> Array:
        """Normal matrix, (unknowns, unknowns)."""


P = TypeVar("P", bound=Linearised)


@dataclass(frozen=True, eq=False)
class LevenbergMarquardt:
    """Levenberg–Marquardt method with its settings.

    μ falls to a tenth after a step that gains more than half of the linear model's prediction. A
    step that gains nothing multiplies μ by ten.

    Attributes
    ----------
    evaluations : int
        Maximum number of evaluations of the model.
    settled, share : float
        The iteration ends if actual and predicted gain are both less than `settled` plus `share` of
        the cost.
    damping : float
        First μ; with 0 the first step is a Gauss–Newton step.
    most_damping : float
        μ beyond which the iteration ends.
    longest : float or array
        Largest change of an unknown in a step, for all or for each; longer steps are shortened as a
        whole.
    """

    evaluations: int
    settled: float
    share: float = 0.0
    damping: float = 1e-3
    most_damping: float = 1e8
    longest: float | Array = np.inf

    def minimum(
        self,
        model: Callable[[Array], P],
        start: Array,
        bounds: tuple[Array | float, Array | float] = (-np.inf, np.inf),
        ended: Callable[[P, int], bool] = lambda at, evaluations: False,
    ) -> tuple[Array, P]:
        """Return the minimum that is reached from `start`, and the model there.

        Raises numpy.linalg.LinAlgError if JᵀJ is singular without damping.

        Parameters
        ----------
        model : callable
            Function position → linearised sum of squares. A point whose cost is NaN is never
            accepted.
        start : array, shape (unknowns,)
        bounds : tuple of array or float
            Lower and upper bounds of the unknowns.
        ended : callable
            Function (point, number of evaluations) → whether to end the iteration.

        Returns
        -------
        position : array, shape (unknowns,)
        point : linearised sum of squares
            The model at the position.
        """
        low, high = (np.broadcast_to(bound, start.shape) for bound in bounds)
        position = np.clip(start, low, high)
        point = model(position)
        count = 1
        damping = self.damping
        while count < self.evaluations and not ended(point, count):
            gradient = point.gradient
            free = ~(((position <= low) & (gradient > 0)) | ((position >= high) & (gradient < 0)))
            if not free.any():
                break
            step = _damped_step(point, free, damping, self.longest)
            moved = np.clip(position + step, low, high)
            step = moved - position
            trial = model(moved)
            count = count + 1
            # Actual gain, and the linear model's: −gᵀδ − ½ δᵀJᵀJ δ
            gain = point.cost - trial.cost
            predicted = -float(gradient @ step + step @ point.normal @ step / 2)
            if gain > 0:
                position = moved
                point = trial
                if gain > predicted / 2:
                    damping = max(damping / 10, min(damping, LEAST_DAMPING))
            else:
                damping = max(10 * damping, FIRST_DAMPING)
            least = self.settled + self.share * point.cost
            if (predicted < least and not gain >= least) or damping > self.most_damping:
                break
        return position, point


def _damped_step(point: Linearised, free: Mask, damping: float, longest: Array | float) -> Array:
    """Return −(JᵀJ + μ diag(JᵀJ))⁻¹ Jᵀf of the free unknowns, shortened to `longest`."""
    from scipy.linalg import lapack  # not by readouts, which a recording loads

    damped = point.normal.copy() if free.all() else point.normal[np.ix_(free, free)]
    scale = damped.diagonal()
    damped[np.diag_indices(len(damped))] += damping * np.where(scale > 0, scale, 1.0)
    step = np.zeros(len(free))
    # LAPACK has the columns in memory: it takes the transposed of a matrix without turning it.
    _, solution, failed = lapack.dposv(damped.T, point.gradient[free])
    if failed:  # not positive definite in double precision
        solution = np.linalg.solve(damped, point.gradient[free])
    step[free] = -solution
    share = np.min(longest / np.maximum(np.abs(step), MIN_LENGTH))
    return step * min(1.0, float(share))
