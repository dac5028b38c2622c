"""Losses: how a residual becomes a cost. All are scaled so that a squared loss is Σ x², without a half."""

from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any, ClassVar, Literal

import casadi

from lampest.files.tagged import ByKind


@dataclass(frozen=True)
class Squared:
    """Σ x²; the loss of the paper's equations (11)-(24)."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["squared"] = "squared"

    def cost(self, residual: Any) -> Any:
        """The scalar loss of a column of residuals; symbolic or numeric."""
        return casadi.sumsqr(residual)


@dataclass(frozen=True)
class Huber:
    """Σ x² where |x| ≤ corner, Σ (2·corner·|x| − corner²) elsewhere; once differentiable.

    corner has the unit of the term's residual. Raises ValueError unless it is positive and finite.
    Source: Huber, Ann. Math. Statist. 35, 1964.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    corner: float
    kind: Literal["huber"] = "huber"

    def __post_init__(self) -> None:
        if not (isfinite(self.corner) and self.corner > 0):
            raise ValueError("corner must be positive and finite")

    def cost(self, residual: Any) -> Any:
        """The scalar loss of a column of residuals; symbolic or numeric."""
        inside = casadi.fmin(casadi.fmax(residual, -self.corner), self.corner)
        return casadi.sum1(inside * (2 * residual - inside))


@dataclass(frozen=True)
class Absolute:
    """Σ |x|; has no derivative at 0, so solvers replace it by its dual form max over |z| ≤ 1 of Σ z·x."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["absolute"] = "absolute"

    def cost(self, residual: Any) -> Any:
        """The scalar loss of a column of residuals; for values, not for derivatives."""
        return casadi.sum1(casadi.fabs(residual))


Loss = Annotated[Squared | Huber | Absolute, ByKind()]
