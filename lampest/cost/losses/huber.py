"""Huber's loss."""

from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar, Literal

import casadi
import numpy as np

from lampest.cost.losses.loss import Entry, Loss, PenaltyEvidence
from lampest.cost.losses.lowered import Lowered
from lampest.panel.panel import Array


@dataclass(frozen=True)
class Huber(Loss):
    """Σ x² where |x| ≤ corner, Σ (2·corner·|x| − corner²) elsewhere; once differentiable.

    corner has the unit of the term's residual. Raises ValueError unless it is positive and finite.
    Source: Huber, Ann. Math. Statist. 35, 1964.
    """

    enters: ClassVar[Entry] = "split"
    corner: float
    kind: Literal["huber"] = "huber"

    def __post_init__(self) -> None:
        if not (isfinite(self.corner) and self.corner > 0):
            raise ValueError("corner must be positive and finite")

    def cost(self, residual: Any) -> Any:
        """Σ c·(2x − c), c = x held to |c| ≤ corner; symbolic or numeric."""
        inside = casadi.fmin(casadi.fmax(residual, -self.corner), self.corner)
        return casadi.sum1(inside * (2 * residual - inside))

    def lowered(self, residual: casadi.SX, weight: casadi.SX, unit: casadi.SX) -> Lowered:
        """The least of Σ (x − p + q)² + 2·corner·(p + q): what lies beyond the corner goes into p or q."""
        above, below = (casadi.SX.sym(name, residual.shape[0]) for name in ("above", "below"))
        inside = residual - unit * (above - below)
        outside = 2 * self.corner * unit * casadi.sum1(above + below)
        return Lowered(weight * (casadi.sumsqr(inside) + outside), (above, below))

    def curvature(self, residual: Array) -> Array:
        """ω = 1 within the corner, 0 beyond."""
        return np.asarray(np.abs(residual) <= self.corner, dtype=float)

    def steady_pull(self, residual: Array) -> Array:
        """0 within the corner, corner beyond."""
        return np.where(np.abs(residual) > self.corner, self.corner, 0.0)

    def size(self, evidence: PenaltyEvidence) -> float:
        """η = Σ x² of the rows that count: where ω = 0 a residual says nothing of the weight."""
        return evidence.squares
