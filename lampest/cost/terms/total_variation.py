"""Penalty on the total variation of the cells: edges cost their height, however steep they are."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.cost.losses import Absolute, AnyLoss
from lampest.cost.terms.term import State, Term, Weight


@dataclass(frozen=True)
class TotalVariation(Term):
    """100·log(r_b/r_a) in percent, over all pairs a, b of neighbours.

    With its absolute loss this is the anisotropic total variation of log r. In log r a fall to a tenth and a rise to
    tenfold are edges of one height, and forward differences see a cell that stands out alone, which central ones do
    not. Source: Rudin, Osher & Fatemi, Physica D 60, 1992.
    """

    convex_in_log: ClassVar[bool] = True
    unit: ClassVar[str] = "percent"
    weight: Weight = "auto"
    loss: AnyLoss = Absolute()
    kind: Literal["total_variation"] = "total_variation"

    def residual(self, state: State) -> Any:
        """Logarithmic steps between neighbouring cells, (pairs, 1)."""
        return state.log_steps(state.cell_resistance)
