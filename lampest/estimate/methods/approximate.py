"""Methods that do less than an optimum: nothing, a few steps, or what a solved baseline prepares for all frames."""

from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.state import S, Step
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.solvers.linearised import LinearisedSolver
from lampest.solvers.multistart import BROKEN, evaluated
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.region import RegionSolver
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, Status, approximation


@dataclass(frozen=True)
class AnchoredMethod(Method):
    """The baseline is solved to an optimum, without the terms that compare with an earlier frame."""

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
        return replace(found, prepared=self.anchor(here, objective.solver))

    @abstractmethod
    def anchor(self, baseline: Evaluation, settings: Settings) -> LinearisedSolver | RegionSolver:
        """What serves the recording; baseline : the cost at the solved baseline, given its readings."""

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """What the anchor makes of a frame; a full solve where there is none, or a baseline with holes gives none."""
        if prepared is not None and previous is not None:
            with suppress(*BROKEN):
                solution: Solution = prepared.solve(solver.cost, data, previous[0])
                return solution
        return OptimalMethod("reduced").solution(solver, data, previous, None)


@dataclass(frozen=True)
class LinearisedMethod(AnchoredMethod):
    """log r = log r_b − H_b⁻¹ ∇φ(r_b): one Newton step from the baseline, whose factor serves the whole recording.

    >>> lampest.LinearisedMethod().kind
    'linearised'
    """

    kind: Literal["linearised"] = "linearised"

    def anchor(self, baseline: Evaluation, settings: Settings) -> LinearisedSolver:
        """The baseline's factor."""
        return LinearisedSolver(baseline)


@dataclass(frozen=True)
class RegionMethod(AnchoredMethod):
    """Only cells that changed are unknown, all others keep their baseline value.

    The region is the rectangle round the readings that stand out from the baseline's by more than `significance` times
    their noise; it grows until what is left outside is noise. Raises ValueError unless significance is positive.

    >>> lampest.RegionMethod().kind
    'region'
    """

    kind: Literal["region"] = "region"
    significance: float = 6.0

    def __post_init__(self) -> None:
        if not 0 < self.significance < float("inf"):
            raise ValueError("significance must be positive and finite")

    def begin(self, state: S, solved: Step | None = None) -> S:
        """As all anchored methods. Raises InputError where crossings have no cell: blocks are rectangles of them."""
        if not state.scene.panel.present.all():
            raise InputError("formulation: region needs a cell at every crossing of its panel; take reduced")
        return super().begin(state, solved)

    def anchor(self, baseline: Evaluation, settings: Settings) -> RegionSolver:
        """The baseline's network."""
        return RegionSolver(baseline, self.significance, settings)


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
