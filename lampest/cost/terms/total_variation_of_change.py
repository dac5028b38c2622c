"""Penalty on the total variation of the change: a load has edges, and the cells' own pattern is none."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.cost.losses import Absolute, AnyLoss
from lampest.cost.terms.term import Reference, State, Term, Weight


@dataclass(frozen=True)
class TotalVariationOfChange(Term):
    """100·log((r/r0)_b/(r/r0)_a) in percent, over all pairs a, b of neighbours; r0 the baseline or the previous frame.

    With its absolute loss the anisotropic total variation of log r/r0. Source: Rudin, Osher & Fatemi, Physica D 60,
    1992.
    """

    needs_previous: ClassVar[bool] = True
    convex_in_log: ClassVar[bool] = True
    unit: ClassVar[str] = "percent"
    weight: Weight = "auto"
    loss: AnyLoss = Absolute()
    kind: Literal["total_variation_of_change"] = "total_variation_of_change"
    reference: Reference = "baseline"

    def residual(self, state: State) -> Any:
        """Logarithmic steps of the change between neighbouring cells, (pairs, 1)."""
        return state.log_steps(state.ratio(self.reference))
