"""`formulation: oral_disc`: the numbers of a mouth are fitted to the readings, and the cells follow from them."""

from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Literal

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.cost.terms import Term
from lampest.estimate.methods.method import Method
from lampest.estimate.state import S, SequenceState, Step
from lampest.files.errors import InputError
from lampest.files.process import delayed_interrupt
from lampest.loads.pressure import water_pressure
from lampest.loads.recognition.detector import Detector, OralDiscFit, fit_oral_disc
from lampest.loads.recognition.observation import Baseline, Observation, counting
from lampest.loads.recognition.settings import ModelErrors, patch_of
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.multistart import BROKEN
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Outcome, Solution, Solver, Status, approximation, failure


@dataclass(frozen=True, eq=False)
class OralDiscTracker:
    """Of the unloaded readings, prepared for the panel, and the fit before, or None. frames : how many were fitted."""

    baseline: Baseline
    detector: Detector
    frames: int = 0
    last: OralDiscFit | None = None

    @classmethod
    def of(cls, state: SequenceState) -> "OralDiscTracker":
        """Before the first frame. Raises InputError where the noise of the readings is unknown."""
        scene, resting = state.scene, state.resting
        if resting.sigma is None:
            raise InputError("formulation: oral_disc needs the noise: a readout in the scene or sigma in the recording")
        errors = ModelErrors().of_scene(scene, state.reading_error)
        detector = Detector(scene.panel, patch_of(scene.panel))
        try:
            baseline = Baseline.of(resting.value, _sigma(resting), scene, errors, _common(state, resting, True))
        except ValueError as error:
            raise InputError(f"formulation: oral_disc: {error}") from error
        return cls(baseline, detector)

    def push(self, state: SequenceState, readings: Readings) -> tuple["OralDiscTracker", OralDiscFit]:
        """The fit of one frame's readings (rows, columns), begun at the last one or all over the panel."""
        seconds = (self.frames + 1) * state.period if np.isfinite(state.period) else 0.0
        water, common = water_pressure(state.scene.panel, state.scene.water), _common(state, readings, False)
        frame = Observation(readings.value, _sigma(readings), self.baseline, water, seconds, common=common)
        found = fit_oral_disc(self.detector, frame, None if self.last is None else self.last.fit)
        return replace(self, frames=self.frames + 1, last=found), found


def _common(state: SequenceState, readings: Readings, baseline: bool) -> Array | None:
    """What the readings of a frame share by chance."""
    return None if state.frame_noise is None else state.frame_noise.columns(readings.value[None], baseline)


@dataclass(frozen=True)
class OralDiscMethod(Method):
    """The unknowns are the numbers of an oral disc, not the cells; wrong wherever something else is attached.

    >>> lampest.OralDiscMethod().kind
    'oral_disc'
    """

    kind: Literal["oral_disc"] = "oral_disc"

    def check(self, terms: tuple[Term, ...]) -> None:
        """Raise InputError unless the misfit is alone."""
        if not all(term.reads_measurement for term in terms):
            raise InputError("formulation: oral_disc has the term misfit alone; the disc leaves nothing to penalise")

    def check_scene(self, scene: Scene) -> None:
        """Raise InputError unless its readout is two_point, which recognition is about, and nothing is wired."""
        if scene.wiring is not None:
            raise InputError(
                "formulation: oral_disc knows neither lines, contacts nor faults.joined_rows and joined_columns"
            )
        if not isinstance(scene.circuit, TwoPointReadout):
            raise InputError("formulation: oral_disc knows readout.kind: two_point only; nodal and reduced know all")

    def compares(self, terms: tuple[Term, ...]) -> bool:
        """Always: a disc is what has changed."""
        return True

    def begin(self, state: S, solved: Step | None = None) -> S:
        """The state with the unloaded panel that a disc's fits need."""
        begin = perf_counter()
        sequence = OralDiscTracker.of(state)
        data, cost = _judged(state, state.resting)
        solution = _fitted(cost, data, np.exp(sequence.baseline.logarithm), 0)
        baseline = solved or Step(solution, perf_counter() - begin, tuple(map(float, cost.weights)))
        return replace(state.with_baseline(baseline), previous=None, prepared=sequence)

    def push(self, state: S, readings: Readings) -> tuple[S, Step]:
        """The fit of one frame, begun at the last one."""
        begin = perf_counter()
        data, cost = _judged(state, readings)
        weights = tuple(map(float, cost.weights))
        with delayed_interrupt(), suppress(*BROKEN):
            sequence, disc = state.prepared.push(state, readings)
            solver = ProjectedNewton(cost, state.estimator.solver)
            solution = replace(self.solution(solver, data, None, disc), at=None, dual=None)
            return replace(state, prepared=sequence), Step(solution, perf_counter() - begin, weights, disc=disc)
        nothing = Outcome(data.measured, np.zeros(0), Status.BREAKDOWN, 0)
        lost = failure(cost, data, Status.BREAKDOWN, float("nan"), nothing)
        return state, Step(lost, perf_counter() - begin, weights)

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """The cells that follow from a disc, with the cost of the terms there."""
        return _fitted(solver.cost, data, prepared.cell_resistance, prepared.fit.steps)


def _judged(state: SequenceState, readings: Readings) -> tuple[Data, Cost]:
    """What cells that were not solved for are judged by."""
    data = state.estimator.data(readings.alone(), state.background)
    return data, state.estimator.cost(state.scene, 1, data.partial)


def _fitted(cost: Cost, data: Data, cells: Array, steps: int) -> Solution:
    outcome = Outcome(cells[None], np.zeros(len(cost.slope)), Status.FITTED, steps)
    solution = approximation(cost, data, outcome)
    # Of the cells it is no optimum, and how far it is from one says nothing.
    return replace(solution, status=Status.FITTED, kkt_residual=float("nan")) if solution.solved else solution


def _sigma(readings: Readings) -> Array:
    sigma = readings.sigma_of_values
    assert sigma is not None
    return counting(sigma, readings.value)
