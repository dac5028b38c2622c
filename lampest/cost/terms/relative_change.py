"""Penalty on the change from the previous frame."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.cost.terms.term import State, Term, Weight


@dataclass(frozen=True)
class RelativeChange(Term):
    """100·(r − r0)/r0 in percent; LSR-ΔCR, paper, equations (15) and (17)."""

    needs_previous: ClassVar[bool] = True
    unit: ClassVar[str] = "percent"
    kind: Literal["relative_change"] = "relative_change"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Relative change against the previous frame, (cells, 1)."""
        return state.relative_change()
