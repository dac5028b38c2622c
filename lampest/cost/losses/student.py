"""Student's loss: heavy tails on both sides."""

from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar, Literal

import casadi
import numpy as np

from lampest.cost.losses.loss import Loss
from lampest.panel.panel import Array


@dataclass(frozen=True)
class Student(Loss):
    """Σ c²·log(1 + (x/c)²), c the corner: x² near 0; far out it hardly grows, so that what is far off hardly pulls.

    −2·log of Student's t with ν degrees of freedom and scale s, where c² = ν s² and weight·c² = ν + 1. It is not convex
    beyond the corner, and brings local minima. corner has the unit of the term's residual. Raises ValueError unless it
    is positive and finite.
    Source: Lange, Little & Taylor, J. Amer. Statist. Assoc. 84, 1989.
    """

    convex: ClassVar[bool] = False
    corner: float
    kind: Literal["student"] = "student"

    def __post_init__(self) -> None:
        if not (isfinite(self.corner) and self.corner > 0):
            raise ValueError("corner must be positive and finite")

    def cost(self, residual: Any) -> Any:
        """The sum, symbolic or numeric."""
        return self.corner**2 * casadi.sum1(casadi.log1p((residual / self.corner) ** 2))

    def curvature(self, residual: Array) -> Array:
        """ω = (1 − q)/(1 + q)², q = (x/c)²; 0 beyond the corner. What follows by default, twenty times as fast."""
        square = (residual / self.corner) ** 2
        return np.asarray(np.maximum(1 - square, 0.0) / (1 + square) ** 2)

    def steady_pull(self, residual: Array) -> Array:
        """√((x/(1 + q))² − (ω x)²)."""
        slope = residual / (1 + (residual / self.corner) ** 2)
        return np.asarray(np.sqrt(np.maximum(slope**2 - (self.curvature(residual) * residual) ** 2, 0.0)))
