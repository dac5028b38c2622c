"""
Your own penalty
================

A term is a residual. This one expects the whole panel to have one mean of ln r. Derivatives are
made by CasADi.
"""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

import lampest


@dataclass(frozen=True)
class CommonLevel(lampest.Term):
    """ln r − mean(ln r): one residual for each cell."""

    unit: ClassVar[str] = "1"
    kind = "common_level"

    def residual(self, state: lampest.State) -> ca.MX:
        level = ca.log(ca.vec(state.cell_resistance))
        return level - ca.sum1(level) / level.numel()


recording = lampest.datasets.load("rod")
estimate = lampest.reconstruct(
    recording, [lampest.Misfit(), CommonLevel(weight=1.0)], formulation="reduced"
)
print(estimate.status[-1])
figure = estimate.plot()
figure
