"""The data term."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import casadi

from lampest.cost.terms.term import State, Term


@dataclass(frozen=True)
class Misfit(Term):
    """f(r) − R_m in the readout's unit, or (f(r) − R_m)/σ where weighting is 'noise'; paper, equation (11)."""

    reads_measurement: ClassVar[bool] = True
    unit: ClassVar[str] = "ohm"
    kind: Literal["misfit"] = "misfit"
    weight: float = 1.0
    weighting: Literal["plain", "noise"] = "plain"

    def residual(self, state: State) -> Any:
        """Modelled minus measured readings, (cells, 1); of a bound only what breaks it."""
        difference = state.reading - state.measured
        if state.side is not None:
            beyond = state.side * casadi.fmin(state.side * difference, 0)
            difference = state.seen * ((1 - state.side**2) * difference + beyond)
        return difference / state.sigma if self.weighting == "noise" else difference
