"""Levenberg and Marquardt's method: the least sum of squares within bounds.

    minimise ½ |f(x)|² over lower ≤ x ≤ upper,   (JᵀJ + μ diag(JᵀJ)) δ = −Jᵀ f

Source: Moré, The Levenberg-Marquardt algorithm, Lecture Notes in Mathematics 630, Springer, 1978.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class SumOfSquares:
    """A sum of squares about one point, from its residual f (n) and Jacobian J (n, unknowns).

    ridge : 1/variance of a step, added to the diagonal of JᵀJ: what no residual sees stays where it is.
    """

    residual: Array
    jacobian: Array
    ridge: float = 0.0

    @cached_property
    def cost(self) -> float:
        """½ |f|²."""
        return float(self.residual @ self.residual) / 2

    @cached_property
    def gradient(self) -> Array:
        """Jᵀ f, (unknowns)."""
        return np.asarray(self.jacobian.T @ self.residual)

    @cached_property
    def normal(self) -> Array:
        """JᵀJ + ridge, (unknowns, unknowns)."""
        normal = self.jacobian.T @ self.jacobian
        normal[np.diag_indices(len(normal))] += self.ridge
        return np.asarray(normal)


class Linearised(Protocol):
    """A sum of squares about one point, however it is made."""

    @property
    def cost(self) -> float: ...

    @property
    def gradient(self) -> Array: ...

    @property
    def normal(self) -> Array: ...


P = TypeVar("P", bound=Linearised)


@dataclass(frozen=True, eq=False)
class Minimum(Generic[P]):
    """Minimum of a sum of squares.

    Attributes
    ----------
    position : array, shape (unknowns)
    at : P
        The sum of squares there.
    evaluations : int
        Of the model, the first included.
    """

    position: Array
    at: P
    evaluations: int


@dataclass(frozen=True, eq=False)
class LevenbergMarquardt:
    """Settings of the loop.

    μ falls to a tenth after a step that gains at least half of the linear model's prediction, and grows tenfold after
    one that gains nothing.

    Attributes
    ----------
    evaluations : int
        Most evaluations of the model.
    settled, share : float
        The loop ends at a gain, made and predicted, of less than `settled`, or of less than `share` of the cost.
    damping : float
        First μ; with 0 the first step is Gauss and Newton's.
    most_damping : float
        μ that ends the loop.
    longest : float or array
        Largest change of an unknown in a step, for all or for each; longer steps are shortened as a whole.
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
    ) -> Minimum[P]:
        """Return the least sum of squares that is reached from `start` (unknowns).

        Raises numpy.linalg.LinAlgError where JᵀJ is singular without damping.

        Parameters
        ----------
        model : callable
            Position → the sum of squares about it; one whose cost is no number is never taken.
        ended : callable
            Whether to end at a point after so many evaluations.
        """
        low, high = (np.broadcast_to(bound, start.shape) for bound in bounds)
        position = np.clip(start, low, high)
        point, count, damping = model(position), 1, self.damping
        while count < self.evaluations and not ended(point, count):
            gradient = point.gradient
            free = ~(((position <= low) & (gradient > 0)) | ((position >= high) & (gradient < 0)))
            if not free.any():
                break
            moved = np.clip(position + self._step(point, free, damping), low, high)
            step = moved - position
            trial, count = model(moved), count + 1
            gain, predicted = point.cost - trial.cost, -float(gradient @ step + step @ point.normal @ step / 2)
            if gain > 0:
                position, point = moved, trial
                damping = max(damping / 10, min(damping, 1e-6)) if gain > predicted / 2 else damping
            else:
                damping = max(10 * damping, 1e-3)
            least = self.settled + self.share * point.cost
            if (predicted < least and not gain >= least) or damping > self.most_damping:
                break
        return Minimum(position, point, count)

    def _step(self, point: Linearised, free: NDArray[np.bool_], damping: float) -> Array:
        """Return the damped step (unknowns), within its longest."""
        damped = point.normal[free][:, free]
        own = damped.diagonal().copy()
        damped[np.diag_indices(len(own))] += damping * np.where(own > 0, own, 1.0)
        step = np.zeros(len(free))
        step[free] = -np.linalg.solve(damped, point.gradient[free])
        return np.asarray(step * min(1.0, float(np.min(self.longest / np.maximum(np.abs(step), 1e-300)))))
