"""Methods that prepare something from a solved baseline, which then serves the whole recording."""

from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.methods.method import Method
from lampest.estimate.methods.optimal import OptimalMethod
from lampest.estimate.state import S
from lampest.panel.panel import Array
from lampest.solvers.linearised import LinearisedSolver
from lampest.solvers.multistart import BROKEN, evaluated
from lampest.solvers.region.region import RegionSolver
from lampest.solvers.solution import Settings, Solution, Solver


class Anchor(Protocol):
    """What is prepared from a baseline."""

    def solve(self, cost: Cost, data: Data, previous: Array) -> Solution:
        """The cells of a frame after the last one, (rows, columns) ohm; cost : the anchor's, as the data ask for it."""


@dataclass(frozen=True)
class AnchoredMethod(Method):
    """The baseline is solved to an optimum, without the terms that compare with an earlier frame."""

    def begin(self, state: S) -> S:
        """The state with what is prepared; without it where the baseline has no optimum."""
        alone, reduced = state.without_comparisons(), OptimalMethod("reduced")
        solved = state.with_baseline(reduced.solve(alone, *reduced.given(alone, state.resting)))
        if solved.previous is None:
            return solved
        objective = state.estimator
        background = replace(state.background, previous=solved.previous if objective.relative else None)
        data = objective.data(state.resting.alone(), background)
        cost = objective.cost(state.scene, 1, data.partial)
        here = evaluated(cost, data, solved.previous[None])
        return replace(solved, prepared=self.anchor(here, objective.solver))

    @abstractmethod
    def anchor(self, baseline: Evaluation, settings: Settings) -> Anchor:
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
    """log r = log r_b − H_b⁻¹ ∇φ(r_b): one Newton step from the baseline, whose factor serves the whole recording."""

    kind: Literal["linearised"] = "linearised"

    def anchor(self, baseline: Evaluation, settings: Settings) -> Anchor:
        """The baseline's factor."""
        return LinearisedSolver(baseline)


@dataclass(frozen=True)
class RegionMethod(AnchoredMethod):
    """Only cells that changed are unknown, all others keep their baseline value.

    The region is the rectangle round the readings that stand out from the baseline's by more than `significance` times
    their noise; it grows until what is left outside is noise. Raises ValueError unless significance is positive.
    """

    kind: Literal["region"] = "region"
    significance: float = 6.0

    def __post_init__(self) -> None:
        if not 0 < self.significance < float("inf"):
            raise ValueError("significance must be positive and finite")

    def anchor(self, baseline: Evaluation, settings: Settings) -> Anchor:
        """The baseline's network."""
        return RegionSolver(baseline, self.significance, settings)
