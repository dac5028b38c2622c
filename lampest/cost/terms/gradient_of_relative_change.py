"""Penalty on differences between neighbouring cells' relative changes."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.cost.terms.term import State, Term, Weight


@dataclass(frozen=True)
class GradientOfRelativeChange(Term):
    """∇(100·(r − r0)/r0) in percent per cell; LSR-∇ΔCR, paper, equations (21) and (23)."""

    needs_previous: ClassVar[bool] = True
    unit: ClassVar[str] = "percent per cell"
    kind: Literal["gradient_of_relative_change"] = "gradient_of_relative_change"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Finite differences of the relative change, (2·cells, 1)."""
        return state.gradient(state.relative_change())
