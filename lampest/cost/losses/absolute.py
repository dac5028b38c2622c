"""The absolute loss."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import casadi
import numpy as np

from lampest.cost.losses.loss import Entry, Loss, PenaltyEvidence
from lampest.cost.losses.lowered import Lowered
from lampest.panel.panel import Array

MEAN_CURVATURE = float(np.sqrt(2 / np.pi)) / 2  # half the second derivative at 0 of E|x + noise|, in units of 1/noise


@dataclass(frozen=True)
class Absolute(Loss):
    """Σ |x|; has no derivative at 0, so solvers replace it by its dual form max over |z| ≤ 1 of Σ z·x."""

    enters: ClassVar[Entry] = "dual"
    kind: Literal["absolute"] = "absolute"

    def cost(self, residual: Any) -> Any:
        """Σ |x|, symbolic or numeric; for values, not for derivatives."""
        return casadi.sum1(casadi.fabs(residual))

    def lowered(self, residual: casadi.SX, weight: casadi.SX, unit: casadi.SX) -> Lowered:
        """The least of Σ p + q where p − q = x."""
        above, below = (casadi.SX.sym(name, residual.shape[0]) for name in ("above", "below"))
        objective = unit * casadi.dot(weight, above + below)
        return Lowered(objective, (above, below), residual / unit - above + below)

    def data_curvature(self, residual: Array, noise: Array) -> Array:
        """ω of the loss that noise has rounded: √(2/π)/(2τ), half the second derivative of E|x + noise| at 0."""
        return np.asarray(MEAN_CURVATURE / np.maximum(noise, np.finfo(float).tiny))

    def penalty_curvature(self, residual: Array, weight: float, scale: float) -> Array:
        """ω/weight of the normal distribution with the same variance.

        exp(−w|x|/2s²) has the variance 8s⁴/w², a normal density exp(−ωx²/2s²) s²/ω: ω = w²/8s².
        """
        return np.full_like(residual, weight / (8 * scale))

    def steady_pull(self, residual: Array) -> Array:
        """Nothing: the normal distribution stands for all of it."""
        return np.zeros_like(residual)

    def size(self, evidence: PenaltyEvidence) -> float:
        """η = ½ Σ E|x|: the prior is Laplace's."""
        return 0.5 * evidence.magnitude

    def determined(self, evidence: PenaltyEvidence) -> float:
        """All residuals: what data leave open of them is in η already, which is an expectation."""
        return evidence.count
