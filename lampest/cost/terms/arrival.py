"""Arrival cost: the previous frame, weighed cell by cell by how well it is known."""

from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar, Literal

import casadi

from lampest.cost.losses import AnyLoss, Huber
from lampest.cost.terms.term import State, Term


@dataclass(frozen=True)
class Arrival(Term):
    """(log r − log r0)/√(sd0² + q²), r0 the previous frame and sd0 the standard deviation of its logarithm.

    walk_percent : q, the standard deviation of a cell's own change from one frame to the next, in percent. A step that
    the readings have in common is no cell's own: r0 takes it before (`Readout.common_step`).

    A random walk of log r whose past is summed up in one frame: the arrival cost of moving-horizon estimation with a
    horizon of one frame, an extended Kalman filter with bounds. Of the covariance it reads the diagonal. Where readings
    say little the previous frame is trusted, and where it was uncertain itself they are. Huber's loss lets cells jump
    when a load sets in. Nothing is left to choose: with misfit.weighting: noise a weight of one is right, with plain
    readings that all have the noise σ, one of σ² ohm². The baseline is solved alone, by the other terms. Raises
    ValueError unless q is positive and finite.
    Sources: Rao, Rawlings & Mayne, IEEE Trans. Automat. Contr. 48, 2003 (arrival cost); Huber, Ann. Math. Statist. 35,
    1964; Masreliez & Martin, IEEE Trans. Automat. Contr. 22, 1977 (robust Kalman filter).
    """

    needs_previous: ClassVar[bool] = True
    weighs_previous: ClassVar[bool] = True
    convex_in_log: ClassVar[bool] = True
    unit: ClassVar[str] = "standard deviations"
    weight: float = 1.0
    loss: AnyLoss = Huber(corner=1.25)
    kind: Literal["arrival"] = "arrival"
    walk_percent: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (isfinite(self.walk_percent) and self.walk_percent > 0):
            raise ValueError("walk_percent must be positive and finite")

    def residual(self, state: State) -> Any:
        """Change in units of its standard deviation, (cells, 1)."""
        variance = state.previous_deviation**2 + (self.walk_percent / 100) ** 2
        return casadi.log(state.ratio("previous")) / casadi.sqrt(variance)
