"""What a loss says of itself. `cost` is enough; all else follows from it by default, for the losses that are smooth.

Losses are sums of one even function ρ of every residual, zero at 0, and scaled so that the squared one is ρ = x²,
without a half: where a factor of two would stand elsewhere, here is half a derivative.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal, Protocol

import casadi
import numpy as np

from lampest.cost.losses.lowered import Lowered
from lampest.panel.panel import Array

Entry = Literal["whole", "split", "dual"]
# Off the bound p, q ≥ 0 by as much as IPOPT would push them (bound_push, by default 0.01).
INSIDE = 0.01


class PenaltyEvidence(Protocol):
    """What the evidence for a penalty's weight counts, over the rows where the penalty bends; x̂ at an estimate."""

    @property
    def residual(self) -> Array:
        """x̂ (rows)."""

    @property
    def squares(self) -> float:
        """Σ x̂²."""

    @property
    def magnitude(self) -> float:
        """Σ E|x|, x scattered about x̂ as the estimate is uncertain."""

    @property
    def count(self) -> float:
        """tr(B⁺ B_t): how many residuals there are, those counted once that follow from others."""

    @property
    def determined(self) -> float:
        """γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t): how many of them data determine."""


@dataclass(frozen=True)
class Loss(ABC):
    """Σ ρ(x) over the residuals of a term.

    enters : how solvers take it. 'whole', as it is: its second derivative exists but for single points. 'split': its
    second derivative jumps, and an interior-point method takes `lowered` instead. 'dual': it is Σ |x|, and its duals z
    stand for its derivative. squared : whether it is Σ x², so that the cost is one of least squares. convex : whether ρ
    is; where it is not the cost may have several minima, and an estimate is one of them.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    enters: ClassVar[Entry] = "whole"
    squared: ClassVar[bool] = False
    convex: ClassVar[bool] = True

    @abstractmethod
    def cost(self, residual: Any) -> Any:
        """Σ ρ(x), one number, of a column of residuals; symbolic or numeric."""

    def lowered(self, residual: casadi.SX, weight: casadi.SX, unit: casadi.SX) -> Lowered:
        """weight·cost as an interior-point method takes it.

        weight : (1, 1), or of every row where the loss enters through duals. unit : of the split, that of residuals.
        """
        return Lowered(weight * self.cost(residual))

    def split_start(self, residual: Array) -> tuple[Array, Array]:
        """(p, q) where an interior-point method begins, for residuals in the split's unit: x's parts, a little more."""
        return np.maximum(residual, 0) + INSIDE, np.maximum(-residual, 0) + INSIDE

    def curvature(self, residual: Array) -> Array:
        """ω = ½ρ''(x) (rows), for which the cost near x bends as Σ ω x² does; 0 where it bends the other way.

        This is what an estimate's first-order answer to noise needs, where weights ½ρ'/x of reweighted least squares
        would leave residuals beyond a corner as stiff as their mean slope.
        """
        return np.maximum(_halves(self, residual)[1], 0.0)

    def stiffness(self, residual: Array) -> Array:
        """½ρ'(x)/x (rows): the weights of reweighted least squares, ½ρ'' at 0."""
        slope, bend = _halves(self, residual)
        nothing = residual == 0
        return np.where(nothing, bend, slope / np.where(nothing, 1.0, residual))

    def data_curvature(self, residual: Array, noise: Array) -> Array:
        """ω of data rows with the noise τ (rows)."""
        return self.curvature(residual)

    def penalty_curvature(self, residual: Array, weight: float, scale: float) -> Array:
        """ω of penalty rows per weight, with s² = scale."""
        return self.curvature(residual)

    def steady_pull(self, residual: Array) -> Array:
        """√((½ρ'(x))² − (ω x)²) (rows): what pulls at an estimate beyond what its curvature accounts for."""
        slope, bend = _halves(self, residual)
        return np.sqrt(np.maximum(slope**2 - (np.maximum(bend, 0.0) * residual) ** 2, 0.0))

    def size(self, evidence: PenaltyEvidence) -> float:
        """η of the evidence's fixed point λ = s² γ/η: Σ ½ x ρ'(x).

        Whatever ρ is, a prior exp(−λρ(x)/2s²) has E[x ρ'(x)] = 2s²/λ, by parts: each residual that data determine
        counts once.
        """
        return float(np.sum(evidence.residual * _halves(self, evidence.residual)[0]))

    def determined(self, evidence: PenaltyEvidence) -> float:
        """γ of the same."""
        return evidence.determined


def _halves(loss: Loss, residual: Array) -> tuple[Array, Array]:
    """(½ρ', ½ρ'') of every residual (rows)."""
    slope, bend = _derivatives(loss)(residual[None])
    return np.asarray(slope).ravel(), np.asarray(bend).ravel()


@lru_cache(maxsize=64)
def _derivatives(loss: Loss) -> casadi.Function:
    """x → (½ρ', ½ρ''); CasADi maps it over the columns of what it is given."""
    x = casadi.SX.sym("x")
    slope = casadi.gradient(loss.cost(x), x) / 2
    return casadi.Function("halves", [x], [slope, casadi.gradient(slope, x)])
