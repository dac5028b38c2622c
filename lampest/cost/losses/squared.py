"""The squared loss."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import casadi
import numpy as np

from lampest.cost.losses.loss import Loss, PenaltyEvidence
from lampest.panel.panel import Array


@dataclass(frozen=True)
class Squared(Loss):
    """Σ x²; the loss of the paper's equations (11)-(24)."""

    squared: ClassVar[bool] = True
    kind: Literal["squared"] = "squared"

    def cost(self, residual: Any) -> Any:
        """Σ x², symbolic or numeric."""
        return casadi.sumsqr(residual)

    def curvature(self, residual: Array) -> Array:
        """ω = 1."""
        return np.ones_like(residual)

    def steady_pull(self, residual: Array) -> Array:
        """Nothing: curvature explains the whole slope."""
        return np.zeros_like(residual)

    def size(self, evidence: PenaltyEvidence) -> float:
        """η = Σ x²."""
        return evidence.squares
