"""The one penalty of an estimator, on the frame of a recording from which its weight is chosen."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.cost.terms import Term, term_kind
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import named_method
from lampest.estimate.sequence import deciding_data, deciding_frame, resting_readings
from lampest.estimate.weights import WeightSearch
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.track import MOST_DENSE
from lampest.recording.recording import Recording
from lampest.runs.config import Case
from lampest.solvers.multistart import best_solution
from lampest.solvers.solution import Solution


@dataclass(frozen=True, eq=False)
class WeightSubject:
    """One case.

    recording, name : of the recording and of the estimator. frame : index into the recording. noisy : whether σ is
    known. cost, data : of the solves; the last of their frames is the measured one. truth : log r (rows, columns) of
    that frame, NaN in cells that are known to be broken; None where it is unknown.
    """

    recording: str
    name: str
    estimator: Estimator
    scene: Scene
    frame: int
    noisy: bool
    cost: Cost
    data: Data
    truth: Array | None

    @classmethod
    def of(cls, case: Case, recording: Recording) -> "WeightSubject | None":
        """The recording's strongest frame; with the baseline where terms compare it with that. None without a frame of
        which enough was read.
        """
        readings, scene = recording.readings(), recording.scene
        resting = resting_readings(recording, readings)
        frame = deciding_frame(recording, readings, resting)
        if frame is None:
            return None
        data = deciding_data(case.estimator, scene, resting, readings[frame])
        truth = None
        if recording.truth_cell_resistance is not None:
            truth = np.log(recording.truth_cell_resistance[frame])
            truth[scene.broken] = np.nan
        cost = case.estimator.cost(scene, len(data.measured), data.partial)
        return cls(
            case.recording, case.name, case.estimator, scene, frame, readings.sigma is not None, cost, data, truth
        )

    @cached_property
    def penalty(self) -> int:
        """The penalty's number among the terms."""
        return next(number for number, term in enumerate(self.cost.terms) if not term.reads_measurement)

    @property
    def given(self) -> float | None:
        """The penalty's weight if the estimator has a number for it."""
        weight = self.cost.terms[self.penalty].weight
        return None if weight == "auto" else float(weight)

    @property
    def search(self) -> WeightSearch:
        """What chooses weights for these data."""
        return WeightSearch(self.cost, self.data, self.estimator.solver)

    def with_weight(self, weight: float) -> Cost:
        """The cost with a weight of the penalty."""
        return self.search.weighted(
            [float(term.weight) if term.reads_measurement else weight for term in self.cost.terms]
        )

    def solution(self, weight: float, start: Array | None) -> Solution:
        """The estimate for a weight, begun from one near it (frames, rows, columns) ohm, or from all starts."""
        solver = named_method("reduced").solver(self.with_weight(weight), self.scene, self.estimator.solver, 1.0)
        return best_solution(solver, self.data, start)

    @property
    def count(self) -> int:
        """The number of readings that are values."""
        return int(np.sum(self.data.plain))

    @property
    def misfit_unit(self) -> str:
        """The unit of the misfit's residuals."""
        term = self.cost.terms[1 - self.penalty]
        return "1" if getattr(term, "weighting", "plain") == "noise" else term.unit

    @property
    def penalty_unit(self) -> str:
        """The unit of the penalty's residuals."""
        return self.cost.terms[self.penalty].unit

    @property
    def kind(self) -> str:
        """The word that names the penalty."""
        return term_kind(self.cost.terms[self.penalty])

    @property
    def weight_unit(self) -> str:
        """The unit of λ: the misfit's, squared, over the penalty's, squared."""
        if self.misfit_unit == self.penalty_unit:
            return "1"
        return f"{squared(self.misfit_unit)}/{squared(self.penalty_unit)}"


def squared(unit: str) -> str:
    """The square of a unit, in ASCII."""
    if unit == "1":
        return "1"
    return f"({unit})^2" if " " in unit else f"{unit}^2"


def why_not(estimator: Estimator, readings: int) -> str | None:
    """Why an estimator cannot be tuned on so many readings in one solve; None where it can."""
    terms: tuple[Term, ...] = estimator.terms
    misfits = sum(term.reads_measurement for term in terms)
    if misfits != 1 or len(terms) != 2:
        penalties = len(terms) - misfits
        return f"it has {penalties} penalty terms, not one" if penalties else "it has no penalty to weigh"
    if not all(term.loss.squared for term in terms):
        return "a loss is not squared"
    if readings > MOST_DENSE:
        return f"one solve has {readings} readings, more than {MOST_DENSE}"
    return None
