"""How a residual becomes a cost. To add a loss: write its class here, before `AnyLoss`, and name it there.

Losses are sums of one even function ρ of every residual, zero at 0; the squared one is ρ = x², without a half. `cost`
is enough: all else follows from it by default, for smooth losses.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import Annotated, Any, ClassVar, Literal

import casadi
import numpy as np

from lampest.files.typed import ByKind, Validated
from lampest.panel.compiled import guarded
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Lowered:
    """weight·loss of a column of residuals x as the least of `objective` over p, q ≥ 0 where `equation` is 0.

    split : p and q, (rows, 1) each, in a unit that makes them of order one, or (). equation : (rows, 1), x in that unit
    − p + q, whose multipliers are weight·unit·z, z the duals; None unless the loss enters through duals.
    """

    objective: casadi.SX
    split: tuple[casadi.SX, ...] = ()
    equation: casadi.SX | None = None


Entry = Literal["whole", "split", "dual"]


@dataclass(frozen=True, eq=False)
class PenaltyEvidence:
    """What the evidence for a penalty's weight counts, over its rows with curvature.

    residual : x̂ (rows) at an estimate. magnitude : Σ E|x|, x scattered about x̂ as the estimate is uncertain. count :
    tr(B⁺ B_t), how many residuals there are, dependent ones counted once. trace : gives tr(A⁻¹ B_t), which probes cost.
    """

    residual: Array
    magnitude: float
    count: float
    trace: Callable[[], float]

    @property
    def squares(self) -> float:
        """Σ x̂²."""
        return float(np.sum(self.residual**2))

    @property
    def determined(self) -> float:
        """γ_t = tr(B⁺ B_t) − tr(A⁻¹ B_t): how many of them data determine."""
        return self.count - self.trace()


@dataclass(frozen=True)
class Loss(Validated):
    """Σ ρ(x) over the residuals of a term.

    enters : how solvers take it. 'whole': as it is. 'split': its second derivative jumps, and an interior-point method
    takes `lowered` instead. 'dual': it is Σ |x|, and its duals z stand for its derivative. squared : whether it is
    Σ x². convex : whether ρ is; where it is not, the cost may have several minima.

    >>> issubclass(lampest.Huber, lampest.Loss)
    True
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    enters: ClassVar[Entry] = "whole"
    squared: ClassVar[bool] = False
    convex: ClassVar[bool] = True

    @abstractmethod
    def cost(self, residual: Any) -> Any:
        """Σ ρ(x), one number, of a column of residuals; symbolic or numeric."""

    def lowered(self, residual: casadi.SX, weight: casadi.SX, unit: casadi.SX) -> Lowered:
        """weight·cost as an interior-point method takes it; weight (1, 1), or of every row; unit : of the split."""
        return Lowered(weight * self.cost(residual))

    def curvature(self, residual: Array) -> Array:
        """ω = ½ρ''(x) (rows), 0 where it is negative: near x the cost has the second derivative of Σ ω x²."""
        return np.asarray(np.maximum(_halves(self, residual)[1], 0.0))

    def stiffness(self, residual: Array) -> Array:
        """½ρ'(x)/x (rows): the weights of reweighted least squares, ½ρ'' at 0."""
        slope, second = _halves(self, residual)
        nothing = residual == 0
        return np.where(nothing, second, slope / np.where(nothing, 1.0, residual))

    def data_curvature(self, residual: Array, noise: Array) -> Array:
        """ω of data rows with the noise τ (rows)."""
        return self.curvature(residual)

    def penalty_curvature(self, residual: Array, weight: float, scale: float) -> Array:
        """ω of penalty rows per weight, with s² = scale."""
        return self.curvature(residual)

    def steady_pull(self, residual: Array) -> Array:
        """√((½ρ'(x))² − (ω x)²) (rows): the part of the slope that the curvature ω does not account for."""
        slope, second = _halves(self, residual)
        return np.asarray(np.sqrt(np.maximum(slope**2 - (np.maximum(second, 0.0) * residual) ** 2, 0.0)))

    def size(self, evidence: PenaltyEvidence) -> float:
        """η of the evidence's fixed point λ = s² γ/η: Σ ½ x ρ'(x); a prior exp(−λρ(x)/2s²) has E[x ρ'(x)] = 2s²/λ."""
        return float(np.sum(evidence.residual * _halves(self, evidence.residual)[0]))

    def determined(self, evidence: PenaltyEvidence) -> float:
        """γ of the same."""
        return evidence.determined


@guarded
def _halves(loss: "Loss", residual: Array) -> tuple[Array, Array]:
    """(½ρ', ½ρ'') of every residual (rows)."""
    slope, second = _derivatives(loss)(residual[None])
    return np.asarray(slope).ravel(), np.asarray(second).ravel()


@lru_cache(maxsize=64)
def _derivatives(loss: Loss) -> casadi.Function:
    """x → (½ρ', ½ρ''); CasADi maps it over the columns of what it is given."""
    x = casadi.SX.sym("x")
    slope = casadi.gradient(loss.cost(x), x) / 2
    return casadi.Function("halves", [x], [slope, casadi.gradient(slope, x)])


@dataclass(frozen=True)
class Squared(Loss):
    """Σ x²; the loss of the paper's equations (11)-(24).

    >>> lampest.Misfit().loss == lampest.Squared()
    True
    """

    squared: ClassVar[bool] = True
    kind: Literal["squared"] = "squared"

    def cost(self, residual: Any) -> Any:
        """Σ x², symbolic or numeric."""
        return casadi.sumsqr(residual)


def _check_corner(corner: float) -> None:
    if not (isfinite(corner) and corner > 0):
        raise ValueError("corner must be positive and finite")


@dataclass(frozen=True)
class Huber(Loss):
    """Σ x² where |x| ≤ corner, Σ (2·corner·|x| − corner²) elsewhere; once differentiable.

    corner has the unit of the term's residual. Raises ValueError unless it is positive and finite.
    Source: Huber, Ann. Math. Statist. 35, 1964.

    >>> lampest.Misfit(loss=lampest.Huber(corner=3.0)).loss.corner
    3.0
    """

    enters: ClassVar[Entry] = "split"
    corner: float
    kind: Literal["huber"] = "huber"

    def __post_init__(self) -> None:
        _check_corner(self.corner)

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

    def size(self, evidence: PenaltyEvidence) -> float:
        """η = Σ x² of the rows that count: where ω = 0 a residual does not inform the weight."""
        return evidence.squares


@dataclass(frozen=True)
class Absolute(Loss):
    """Σ |x|; has no derivative at 0, so solvers replace it by its dual form max over |z| ≤ 1 of Σ z·x.

    >>> lampest.Misfit(loss=lampest.Absolute()).loss.kind
    'absolute'
    """

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
        """ω = √(2/π)/(2τ), half the second derivative of E|x + noise| at 0."""
        return np.asarray(np.sqrt(2 / np.pi) / 2 / np.maximum(noise, np.finfo(float).tiny))

    def penalty_curvature(self, residual: Array, weight: float, scale: float) -> Array:
        """ω/weight of the normal distribution with the variance 8s⁴/w² of exp(−w|x|/2s²): w/8s²."""
        return np.full_like(residual, weight / (8 * scale))

    def steady_pull(self, residual: Array) -> Array:
        return np.zeros_like(residual)

    def size(self, evidence: PenaltyEvidence) -> float:
        """η = ½ Σ E|x|: the prior is Laplace's."""
        return 0.5 * evidence.magnitude

    def determined(self, evidence: PenaltyEvidence) -> float:
        """All residuals: η is an expectation, which has the share that data leave open already."""
        return evidence.count


@dataclass(frozen=True)
class Student(Loss):
    """Σ c²·log(1 + (x/c)²), c the corner: x² near 0, logarithmic far out, so that outliers have little influence.

    −2·log of Student's t with ν degrees of freedom and scale s, where c² = ν s² and weight·c² = ν + 1; not convex
    beyond the corner, which has the unit of the term's residual. Raises ValueError unless it is positive and finite.
    Source: Lange, Little & Taylor, J. Amer. Statist. Assoc. 84, 1989.

    >>> lampest.Misfit(loss=lampest.Student(corner=3.0)).loss.corner
    3.0
    """

    convex: ClassVar[bool] = False
    corner: float
    kind: Literal["student"] = "student"

    def __post_init__(self) -> None:
        _check_corner(self.corner)

    def cost(self, residual: Any) -> Any:
        return self.corner**2 * casadi.sum1(casadi.log1p((residual / self.corner) ** 2))


AnyLoss = Annotated[Squared | Huber | Absolute | Student, ByKind("lampest.losses")]
