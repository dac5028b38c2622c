"""Penalty on differences between neighbouring cells."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.cost.terms.term import State, Term, Weight


@dataclass(frozen=True)
class Gradient(Term):
    """∇r in ohm per cell, row part and column part; LSR-∇CR, paper, equation (19)."""

    unit: ClassVar[str] = "ohm per cell"
    kind: Literal["gradient"] = "gradient"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Finite differences of the cell resistance, (2·cells, 1)."""
        return state.gradient(state.cell_resistance)
