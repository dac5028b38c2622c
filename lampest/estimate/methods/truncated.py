"""A few Newton steps from the previous frame."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.cost.problem import Data
from lampest.estimate.methods.method import Method
from lampest.panel.panel import Array
from lampest.solvers.newton.newton import Newton
from lampest.solvers.solution import Settings, Solution, Solver, approximation
from lampest.solvers.starts import evaluated


@dataclass(frozen=True)
class TruncatedMethod(Method):
    """The first `steps` Newton steps of the reduced formulation from the previous frame.

    Raises ValueError unless there is at least one.
    """

    joint: ClassVar[bool] = True
    kind: Literal["truncated"] = "truncated"
    steps: int = 2

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError("steps must be at least 1")

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """Wherever the steps lead."""
        start = evaluated(solver.cost, data, data.uniform_start if previous is None else previous)
        outcome = Newton(solver.cost, Settings(max_iterations=self.steps)).solve(data, start)
        return approximation(solver.cost, data, outcome)
