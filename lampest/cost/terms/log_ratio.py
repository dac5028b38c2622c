"""Penalty on the logarithm of the change; against the baseline it is a prior mean."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import casadi

from lampest.cost.losses import Absolute, AnyLoss
from lampest.cost.terms.term import Reference, State, Term, Weight


@dataclass(frozen=True)
class LogRatio(Term):
    """100·log(r/r0) in percent, r0 the baseline or the previous frame; weighs suction and pressure alike.

    Convex in log r, which the relative change is not: of a frame with a known r0 only one minimum was ever found.
    Against the baseline and squared it is a Gaussian prior of log r with the baseline as its mean; with its absolute
    loss few cells change, by any amount. Source: Tarantola, Inverse Problem Theory, 2005 (positive parameters by
    their logarithms).
    """

    needs_previous: ClassVar[bool] = True
    convex_in_log: ClassVar[bool] = True
    unit: ClassVar[str] = "percent"
    weight: Weight = "auto"
    loss: AnyLoss = Absolute()
    kind: Literal["log_ratio"] = "log_ratio"
    reference: Reference = "baseline"

    def residual(self, state: State) -> Any:
        """Logarithmic change, (cells, 1)."""
        return 100 * casadi.log(state.ratio(self.reference))
