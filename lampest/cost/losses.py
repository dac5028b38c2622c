"""Losses: even functions ρ of residuals, summed.

To add a loss, write its class before `AnyLoss`, and name it there. Every loss is zero at 0; the
squared one is ρ = x², without a half. For smooth losses `cost` is enough: all other methods follow
from it.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal

import casadi
import numpy as np

from lampest.files.typed import ByKind, Configuration, check_positive_fields
from lampest.panel.compiled import guarded
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Lowered:
    """Form of weight·loss of residuals x for a nonlinear program.

    weight·loss is the minimum of `objective` over p, q ≥ 0 subject to `equation` = 0.

    Attributes
    ----------
    objective : casadi.SX
        Cost, a scalar.
    split : tuple of casadi.SX
        p and q, (rows, 1) each, in a unit in which they are of order one, or ().
    equation : casadi.SX, shape (rows, 1), or None
        x/unit − p + q, with multipliers weight·unit·z, z the duals; None unless the loss enters
        through duals.
    """

    objective: casadi.SX
    split: tuple[casadi.SX, ...] = ()
    equation: casadi.SX | None = None


Entry = Literal["whole", "split", "dual"]


@dataclass(frozen=True, eq=False)
class PenaltyEvidence:
    """Statistics of a penalty for the evidence of its weight λ, over its rows with curvature.

    Attributes
    ----------
    residual : array, shape (rows,)
        x̂ at an estimate.
    magnitude : float
        Σ E|x|, x distributed about x̂ with the uncertainty of the estimate.
    count : float
        tr(B⁺ B_t), the number of independent residuals.
    trace : callable
        Returns tr(A⁻¹ B_t), which is costly.
    """

    residual: Array
    magnitude: float
    count: float
    trace: Callable[[], float]


@dataclass(frozen=True)
class Loss(Configuration):
    """Sum Σ ρ(x) over the residuals of a term.

    Attributes
    ----------
    enters : {'whole', 'split', 'dual'}
        Form in which solvers take the loss. 'whole': directly. 'split': an interior-point method
        takes `lowered`, because the second derivative jumps. 'dual': Σ |x|, with duals z in place
        of its derivative.
    squared : bool
        Whether the loss is Σ x².
    convex : bool
        Whether ρ is convex; else the cost may have several minima.

    >>> issubclass(lampest.Huber, lampest.Loss)
    True
    """

    enters: ClassVar[Entry] = "whole"
    squared: ClassVar[bool] = False
    convex: ClassVar[bool] = True

    @abstractmethod
    def cost(self, residual: Any) -> Any:
        """Return Σ ρ(x), one number, of a column of residuals; symbolic or numeric."""

    def lowered(self, residual: casadi.SX, weight: casadi.SX, unit: casadi.SX) -> Lowered:
        """Return weight·cost for an interior-point method.

        Parameters
        ----------
        residual : casadi.SX, shape (rows, 1)
        weight : casadi.SX, shape (1, 1) or (rows, 1)
        unit : casadi.SX, shape (1, 1)
            Unit of the split parts p and q.
        """
        return Lowered(weight * self.cost(residual))

    def curvature(self, residual: Array) -> Array:
        """Return the curvature ω = max(½ρ''(x), 0), (rows,).

        Near x, Σ ω x² has the second derivative of the loss.
        """
        return np.asarray(np.maximum(_halves(self, residual)[1], 0.0))

    def stiffness(self, residual: Array) -> Array:
        """Return weights ½ρ'(x)/x of iteratively reweighted least squares, (rows,); ½ρ'' at 0."""
        slope, second = _halves(self, residual)
        # ½ρ'(x)/x → ½ρ''(0) for x → 0
        zero = residual == 0
        return np.where(zero, second, slope / np.where(zero, 1.0, residual))

    def data_curvature(self, residual: Array, noise: Array) -> Array:
        """Return the curvature ω of data rows with the noise τ, (rows,)."""
        return self.curvature(residual)

    def penalty_curvature(self, residual: Array, weight: float, scale: float) -> Array:
        """Return the curvature ω of penalty rows divided by their weight, for scale s², (rows,)."""
        return self.curvature(residual)

    def steady_pull(self, residual: Array) -> Array:
        """Return √((½ρ'(x))² − (ω x)²), the slope not due to the curvature ω, (rows,)."""
        slope, second = _halves(self, residual)
        return np.asarray(
            np.sqrt(np.maximum(slope**2 - (np.maximum(second, 0.0) * residual) ** 2, 0.0))
        )

    def size(self, evidence: PenaltyEvidence) -> float:
        """Return η = Σ ½ x ρ'(x) of the fixed point λ = s² γ/η.

        A prior exp(−λρ(x)/2s²) has E[x ρ'(x)] = 2s²/λ.
        """
        return float(np.sum(evidence.residual * _halves(self, evidence.residual)[0]))

    def determined(self, evidence: PenaltyEvidence) -> float:
        """Return γ = tr(B⁺ B_t) − tr(A⁻¹ B_t), the number of residuals that the data determine.

        The number γ enters the fixed point λ = s² γ/η.
        """
        return evidence.count - evidence.trace()


@guarded
def _halves(loss: "Loss", residual: Array) -> tuple[Array, Array]:
    """Return (½ρ', ½ρ'') of every residual, (rows,) each."""
    if loss.squared:
        return residual, np.ones_like(residual)
    # One evaluation of (½ρ', ½ρ'') for all residuals: CasADi maps the function over the columns of
    # (1, rows).
    slope, second = _derivatives(loss)(residual[None])
    return np.asarray(slope).ravel(), np.asarray(second).ravel()


@lru_cache(maxsize=64)
def _derivatives(loss: Loss) -> casadi.Function:
    """Return the function x → (½ρ', ½ρ''), which CasADi maps over columns."""
    x = casadi.SX.sym("x")
    slope = casadi.gradient(loss.cost(x), x) / 2
    return casadi.Function("halves", [x], [slope, casadi.gradient(slope, x)])


@dataclass(frozen=True)
class Squared(Loss):
    """Squares Σ x²; the loss of the paper's equations (11)-(24).

    >>> lampest.Misfit().loss == lampest.Squared()
    True
    """

    squared = True
    kind: Literal["squared"] = "squared"

    def cost(self, residual: Any) -> Any:
        """Return Σ x², symbolic or numeric."""
        return casadi.sumsqr(residual)


@dataclass(frozen=True)
class Huber(Loss):
    """Σ x² where |x| ≤ corner, Σ (2·corner·|x| − corner²) elsewhere; once differentiable.

    corner has the unit of the term's residual. Raises ValueError unless it is positive and finite.
    Source: Huber, Ann. Math. Statist. 35, 1964.

    >>> lampest.Misfit(loss=lampest.Huber(corner=3.0)).loss.corner
    3.0
    """

    enters = "split"
    corner: float
    kind: Literal["huber"] = "huber"

    def __post_init__(self) -> None:
        check_positive_fields(self, "corner")

    def cost(self, residual: Any) -> Any:
        """Return Σ c·(2x − c), c = x clipped to |c| ≤ corner; symbolic or numeric."""
        # c·(2x − c) is x² for |x| ≤ corner, and 2·corner·|x| − corner² beyond.
        inside = casadi.fmin(casadi.fmax(residual, -self.corner), self.corner)
        return casadi.sum1(inside * (2 * residual - inside))

    def lowered(self, residual: casadi.SX, weight: casadi.SX, unit: casadi.SX) -> Lowered:
        """Return min over p, q ≥ 0 of Σ (x − p + q)² + 2·corner·(p + q).

        The variables p and q are the excess of x over the corner, above and below.
        """
        above, below = (casadi.SX.sym(name, residual.shape[0]) for name in ("above", "below"))
        inside = residual - unit * (above - below)
        outside = 2 * self.corner * unit * casadi.sum1(above + below)
        return Lowered(weight * (casadi.sumsqr(inside) + outside), (above, below))

    def size(self, evidence: PenaltyEvidence) -> float:
        """Return η = Σ x² over rows with curvature.

        A residual with ω = 0 does not inform the weight.
        """
        return float(np.sum(evidence.residual**2))


@dataclass(frozen=True)
class Absolute(Loss):
    """Σ |x|, which has no derivative at 0.

    Solvers therefore replace it by its dual form max over |z| ≤ 1 of Σ z·x.

    >>> lampest.Misfit(loss=lampest.Absolute()).loss.kind
    'absolute'
    """

    enters = "dual"
    kind: Literal["absolute"] = "absolute"

    def cost(self, residual: Any) -> Any:
        """Return Σ |x|, symbolic or numeric; for values, not for derivatives."""
        return casadi.sum1(casadi.fabs(residual))

    def lowered(self, residual: casadi.SX, weight: casadi.SX, unit: casadi.SX) -> Lowered:
        """Return min over p, q ≥ 0 of Σ (p + q) subject to p − q = x."""
        above, below = (casadi.SX.sym(name, residual.shape[0]) for name in ("above", "below"))
        objective = unit * casadi.dot(weight, above + below)
        return Lowered(objective, (above, below), residual / unit - above + below)

    def data_curvature(self, residual: Array, noise: Array) -> Array:
        """Return ω = √(2/π)/(2τ), half the second derivative of E|x + noise| at 0."""
        # d²E|x + n|/dx² = 2·density(n = −x), which is √(2/π)/τ at 0 for normal n
        return np.asarray(np.sqrt(2 / np.pi) / 2 / np.maximum(noise, np.finfo(float).tiny))

    def penalty_curvature(self, residual: Array, weight: float, scale: float) -> Array:
        """Return ω/weight = w/8s², w the weight and s² the scale.

        The normal distribution with this curvature has the variance 8s⁴/w² of exp(−w|x|/2s²).
        """
        return np.full_like(residual, weight / (8 * scale))

    def steady_pull(self, residual: Array) -> Array:
        """Return zeros: ω accounts for the whole slope."""
        return np.zeros_like(residual)

    def size(self, evidence: PenaltyEvidence) -> float:
        """Return η = ½ Σ E|x|: the prior is Laplace's."""
        return 0.5 * evidence.magnitude

    def determined(self, evidence: PenaltyEvidence) -> float:
        """Return the number of all residuals.

        The expectation η already contains the part that data leave open.
        """
        return evidence.count


@dataclass(frozen=True)
class Student(Loss):
    """Σ c²·log(1 + (x/c)²), c the corner.

    The loss is close to x² near 0 and grows logarithmically beyond the corner, so that outliers
    have little influence. For c² = ν s² and weight·c² = ν + 1, weight·loss is −2·log of Student's t
    with ν degrees of freedom and scale s. The loss is not convex beyond the corner, which has the
    unit of the term's residual.
    Raises ValueError unless the corner is positive and finite.
    Source: Lange, Little & Taylor, J. Amer. Statist. Assoc. 84, 1989.

    >>> lampest.Misfit(loss=lampest.Student(corner=3.0)).loss.corner
    3.0
    """

    convex = False
    corner: float
    kind: Literal["student"] = "student"

    def __post_init__(self) -> None:
        check_positive_fields(self, "corner")

    def cost(self, residual: Any) -> Any:
        """Return Σ c²·log(1 + (x/c)²), symbolic or numeric."""
        return self.corner**2 * casadi.sum1(casadi.log1p((residual / self.corner) ** 2))


AnyLoss = Annotated[Squared | Huber | Absolute | Student, ByKind("lampest.losses")]
