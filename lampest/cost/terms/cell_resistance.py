"""Tikhonov's penalty on the size of the cell resistances."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.cost.terms.term import State, Term, Weight


@dataclass(frozen=True)
class CellResistance(Term):
    """r in ohm; LSR-CR, paper, equation (13)."""

    unit: ClassVar[str] = "ohm"
    kind: Literal["cell_resistance"] = "cell_resistance"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Cell resistance, (cells, 1)."""
        return state.cell_resistance
