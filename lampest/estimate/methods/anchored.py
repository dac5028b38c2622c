"""Methods that prepare something from a solved baseline, which then serves the whole recording."""

from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.methods.method import Method
from lampest.estimate.methods.optimal import OptimalMethod
from lampest.panel.panel import Array
from lampest.solvers.solution import Settings, Solution, Solver
from lampest.solvers.starts import BROKEN, evaluated

if TYPE_CHECKING:
    from lampest.estimate.stream import Stream


class Anchor(Protocol):
    """What is prepared from a baseline."""

    def solve(self, cost: Cost, data: Data, previous: Array) -> Solution:
        """The cells of a frame after the last one, (rows, columns) ohm; cost : the anchor's, as the data ask for it."""


@dataclass(frozen=True)
class AnchoredMethod(Method):
    """The baseline is solved to an optimum, without the terms that compare with an earlier frame."""

    def begin(self, stream: "Stream") -> "Stream":
        """The stream with what is prepared; without it where the baseline has no optimum."""
        alone = stream.without_comparisons()
        alone = replace(alone, estimator=replace(alone.estimator, formulation="reduced"))
        solved = stream.with_baseline(alone.solve(*alone.given(stream.resting)))
        if solved.previous is None:
            return solved
        estimator, scene = stream.estimator, stream.scene
        background = replace(stream.background, previous=solved.previous if estimator.relative else None)
        data = estimator.data(stream.resting.alone(), background)
        cost = estimator.cost(scene, 1, data.partial)
        here = evaluated(cost, data, solved.previous[None])
        return replace(solved, prepared=self.anchor(here, estimator.solver))

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
