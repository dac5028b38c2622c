"""Methods that do less than an optimum: nothing, a few steps, or what a solved baseline prepares for all frames."""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.state import S, Step
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.solvers.linearised import LinearisedSolver
from lampest.solvers.multistart import BROKEN, evaluated
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, Status, approximation


@dataclass(frozen=True)
class LinearisedMethod(Method):
    """log r = log r_b − H_b⁻¹ ∇φ(r_b): one Newton step from the baseline, whose factor serves the whole recording.

    The baseline is solved to an optimum, without the terms that compare with an earlier frame.

    >>> lampest.LinearisedMethod().kind
    'linearised'
    """

    kind: Literal["linearised"] = "linearised"

    def begin(self, state: S, solved: Step | None = None) -> S:
        """The state with what is prepared; without it where the baseline has no optimum."""
        alone, reduced = state.without_comparisons(), OptimalMethod("reduced")
        found = state.with_baseline(solved or reduced.solve(alone, *reduced.given(alone, state.resting)))
        if found.previous is None:
            return found
        objective = state.estimator
        background = replace(state.background, previous=found.previous if objective.relative else None)
        data = objective.data(state.resting.alone(), background)
        cost = objective.cost(state.scene, 1, data.partial)
        here = evaluated(cost, data, found.previous[None])
        return replace(found, prepared=LinearisedSolver(here))

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """One step; a full solve where the baseline has no optimum, or one with holes gives no step."""
        if prepared is not None and previous is not None:
            with suppress(*BROKEN):
                solution: Solution = prepared.solve(solver.cost, data, previous[0])
                return solution
        return OptimalMethod("reduced").solution(solver, data, previous, None)


@dataclass(frozen=True)
class TruncatedMethod(Method):
    """The first `steps` Newton steps of the reduced formulation from the previous frame.

    Raises ValueError unless there is at least one.

    >>> lampest.TruncatedMethod().kind
    'truncated'
    """

    kind: Literal["truncated"] = "truncated"
    steps: int = 2

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError("steps must be at least 1")

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """Wherever the steps lead."""
        start = evaluated(solver.cost, data, data.uniform_start if previous is None else previous)
        outcome = ProjectedNewton(solver.cost, Settings(max_iterations=self.steps)).solve(data, start)
        return approximation(solver.cost, data, outcome)


@dataclass(frozen=True)
class UncorrectedMethod(Method):
    """naive : each reading as if its cell were alone (r = R_m, or what a naive divider gives). scaled : as if all were
    alike (r = R_m·MN/(M + N − 1) of two-point readings). Costs nothing.

    >>> lampest.UncorrectedMethod().kind
    'naive'
    """

    kind: Literal["naive", "scaled"] = "naive"

    def guess(self, readout: Readout, measured: Array) -> Array:
        """The estimate itself."""
        return readout.apparent_resistance(measured) if self.kind == "naive" else readout.uniform_start(measured)

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """The cells that are read off, put within the bounds."""
        cells = np.clip(self.guess(data.readout, data.measured), data.lower, data.upper)
        return approximation(solver.cost, data, Outcome(cells, np.zeros(len(solver.cost.slope)), Status.APPROXIMATE, 0))
