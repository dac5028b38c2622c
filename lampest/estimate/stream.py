"""Frames as they come: each solved after the last, with the baseline where the method asks for that."""

from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.cost.terms.arrival import common_step
from lampest.estimate.efforts import Converged, Linearised, Region, Scaled, Truncated, TwoPoint
from lampest.estimate.estimator import Doubts, Estimator
from lampest.estimate.oral_disc import OralDiscTracker, disc_solution
from lampest.estimate.weights import with_chosen_weights
from lampest.files.interrupts import delayed_interrupt
from lampest.loads.recognition.direct import OralDiscFit
from lampest.panel.network import uniform_factor
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Faults, Scene
from lampest.panel.systematic import Shared
from lampest.posterior.linear import LinearModel
from lampest.posterior.track import Bars, Track
from lampest.recording.readings import Readings
from lampest.solvers.linearised import LinearisedSolver
from lampest.solvers.newton.newton import Newton
from lampest.solvers.region.region import RegionSolver
from lampest.solvers.search import BROKEN, best_solution, evaluated
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, Status, approximation, failure

UNKNOWN = 10.0  # standard deviation of log r0 where nothing is known of it


@dataclass(frozen=True, eq=False)
class Step:
    """One solve of a sequence: the last of its frames is the frame's estimate, the first of two the baseline's.

    weights : of the terms. bars : the estimate's error bars, or None; they took `bars_seconds`.
    disc : what the cells follow from, where that is a disc.
    """

    solution: Solution
    seconds: float
    weights: tuple[float, ...]
    bars: Bars | None = None
    bars_seconds: float = 0.0
    disc: OralDiscFit | None = None


def _deviation(track: Track | None, step: Step) -> Array | None:
    return None if track is None or step.bars is None else track.deviation


def _estimate(step: Step, frame: int) -> Array | None:
    return step.solution.cell_resistance[frame] if step.solution.solved else None


@dataclass(frozen=True, eq=False)
class Stream:
    """Where a sequence of frames stands. Pushing a frame gives the next stream and how the frame was solved.

    Parameters
    ----------
    estimator, panel : the method and the panel. period : s between frames.
    resting : the unloaded readings (rows, columns). faults : what is known to be broken, or None.
    baseline : how the baseline was solved; None for a relative method until a frame was.
    previous : (rows, columns) ohm, the last estimate, or None. previous_deviation : of its logarithm; None where it
    has no error bars.
    anchor : what an effort has prepared from the solved baseline, or None.
    track : what error bars need of earlier frames; None where there are to be none.
    disc : where the fits of a disc stand, if the unknowns are a disc's.
    """

    estimator: Estimator
    panel: Panel
    period: float
    resting: Readings
    faults: Faults | None = None
    baseline: Step | None = None
    previous: Array | None = None
    previous_deviation: Array | None = None
    anchor: LinearisedSolver | RegionSolver | None = None
    track: Track | None = None
    disc: OralDiscTracker | None = None

    @classmethod
    def begin(cls, estimator: Estimator, scene: Scene, period: float, resting: Readings) -> "Stream":
        """Before the first frame; an absolute method solves its baseline now.

        Raises InputError where the noise is needed and unknown, or bounds leave no room.
        """
        track = Track(Shared.of(scene)) if estimator.barred(resting) else None
        stream = cls(estimator, scene.panel, period, resting, scene.faults, track=track)
        if estimator.unknowns == "oral_disc":
            return stream._with_disc(scene)
        if estimator.joint_start:
            return stream
        if isinstance(estimator.effort, Linearised | Region):
            return stream._anchored(estimator.effort)
        alone = stream._absolute() if estimator.weighs_previous else stream
        baseline = alone._solve(*alone.given(resting))
        with suppress(*BROKEN):
            model = _surroundings(baseline)
            if stream.track is not None and model is not None:
                track = stream.track.resting(model, remembered=estimator.relative)
                stream = replace(stream, track=track, previous_deviation=track.deviation)
        return replace(stream, baseline=baseline, previous=_estimate(baseline, 0))

    def push(self, readings: Readings) -> tuple["Stream", Step]:
        """Solve one frame's readings (rows, columns); a failed one leaves the stream as it was.

        Raises InputError as `begin`.
        """
        if self.disc is not None:
            return self._push_disc(self.disc, readings)
        data, start = self.given(readings)
        step = self._solve(data, start)
        found = _estimate(step, -1)
        track, step = self._barred(step)
        step = replace(step, solution=replace(step.solution, at=None, dual=None))
        return replace(
            self,
            baseline=step if len(data.measured) == 2 else self.baseline,
            previous=self.previous if found is None else found,
            previous_deviation=self.previous_deviation if found is None else _deviation(track, step),
            track=track,
        ), step

    def _with_disc(self, scene: Scene) -> "Stream":
        """The stream with the unloaded panel that a disc's fits need."""
        begin = perf_counter()
        disc = OralDiscTracker.of(scene, self.period, self.resting)
        data, cost = self._judged(self.resting)
        step = Step(disc.resting(cost, data), perf_counter() - begin, tuple(map(float, cost.weights)))
        return replace(self, baseline=step, disc=disc)

    def _judged(self, readings: Readings) -> tuple[Data, Cost]:
        """What cells that were found in another way than by solving are judged by."""
        data = self.estimator.data(readings.alone(), None, self.faults)
        return data, self.estimator.cost(self.panel, 1, Doubts.of(self.panel, self.faults, data))

    def _push_disc(self, disc: OralDiscTracker, readings: Readings) -> tuple["Stream", Step]:
        begin = perf_counter()
        data, cost = self._judged(readings)
        weights = tuple(map(float, cost.weights))
        with delayed_interrupt(), suppress(*BROKEN):
            disc, found = disc.push(readings)
            solution = replace(disc_solution(cost, data, found), at=None, dual=None)
            return replace(self, disc=disc), Step(solution, perf_counter() - begin, weights, disc=found)
        nothing = Outcome(data.measured, np.zeros(0), Status.BREAKDOWN, 0)
        lost = failure(cost, data, Status.BREAKDOWN, float("nan"), nothing)
        return self, Step(lost, perf_counter() - begin, weights)

    def _barred(self, step: Step) -> tuple[Track | None, Step]:
        """The step with error bars, where they are wanted and can be had."""
        model = _surroundings(step)
        if self.track is None or model is None:
            return self.track, step
        begin = perf_counter()
        with suppress(*BROKEN):
            track, bars = self.track.advanced(model)
            return track, replace(step, bars=bars, bars_seconds=perf_counter() - begin)
        return self.track, step

    def given(self, readings: Readings) -> tuple[Data, Array | None]:
        """What the solve of a frame is given, with the baseline where both are solved jointly, and where it may start.

        The joint pair: paper, equations (15) and (21).
        """
        if self.estimator.joint_start and (self.baseline is None or not self.baseline.solution.solved):
            return self.estimator.data(self.resting.together(readings), None, self.faults), None
        known = resting = None
        if self.estimator.relative:
            known = self._guess(readings.resistance) if self.previous is None else self.previous
            resting = None if self.baseline is None else _estimate(self.baseline, 0)
        data = self.estimator.data(readings.alone(), known, self.faults, resting, self._known_deviation())
        if self.estimator.weighs_previous and known is not None:
            values = (readings.side == 0) & (readings.seen > 0)
            expected = data.network(0, known).two_point_resistance()
            data = replace(data, previous=known * common_step(readings.resistance[values], expected[values]))
        return data, None if self.previous is None else self.previous[None]

    def _known_deviation(self) -> Array | None:
        """Of log r0, for terms that read it; an open cell, and one without error bars, is not known at all."""
        if not self.estimator.weighs_previous:
            return None
        if self.previous is None or self.previous_deviation is None:
            return np.full(self.panel.shape, UNKNOWN)
        return np.fmin(self.previous_deviation, UNKNOWN)

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline is not solved."""
        found = None if self.baseline is None else _estimate(self.baseline, 0)
        return np.full(self.panel.shape, np.nan) if found is None else found

    def _solve(self, data: Data, previous: Array | None) -> Step:
        with delayed_interrupt():
            doubts = Doubts.of(self.panel, self.faults, data)
            begin = perf_counter()
            estimator = self.estimator
            if estimator.automatic:
                noisy = self.resting.sigma is not None
                estimator = with_chosen_weights(estimator, self.panel, data, doubts, previous, noisy)
            choice = perf_counter() - begin
            solver = estimator.problem(self.panel, len(data.measured), self.period, doubts)
            solver.prepare()
            begin = perf_counter()
            solution = self._solution(solver, data, previous)
            weights = tuple(float(weight) for weight in solver.cost.weights)
            return Step(solution, choice + perf_counter() - begin, weights)

    def _solution(self, solver: Solver, data: Data, previous: Array | None) -> Solution:
        effort = self.estimator.effort
        if self.anchor is not None and previous is not None:
            return self.anchor.solve(data, previous[0])
        if isinstance(effort, TwoPoint | Scaled):
            return approximation(solver.cost, data, _read_off(data, self._guess(data.measured)))
        if isinstance(effort, Truncated):
            return _truncated(solver.cost, data, previous, effort.steps)
        return best_solution(solver, data, previous)

    def _guess(self, measured: Array) -> Array:
        """What an estimate would be without solving: R_m, or the cell of a uniform panel; same shape, ohm."""
        if isinstance(self.estimator.effort, TwoPoint):
            return measured
        return measured / uniform_factor(*self.panel.shape)

    def _absolute(self) -> "Stream":
        """The stream without the terms that compare with an earlier frame."""
        absolute = replace(self.estimator, effort=Converged(), terms=self.estimator.absolute_terms)
        return replace(self, estimator=absolute)

    def _anchored(self, effort: Linearised | Region) -> "Stream":
        """The stream after its baseline, solved to an optimum without the terms that compare with an earlier frame."""
        alone = self._absolute()
        baseline = alone._solve(*alone.given(self.resting))
        found = _estimate(baseline, 0)
        stream = replace(self, baseline=baseline, previous=found)
        if found is None:
            return stream
        data = self.estimator.data(self.resting.alone(), found if self.estimator.relative else None, self.faults)
        cost = self.estimator.cost(self.panel, 1, Doubts.of(self.panel, self.faults, data))
        here = evaluated(cost, data, found[None])
        settings = self.estimator.solver
        if isinstance(effort, Linearised):
            return replace(stream, anchor=LinearisedSolver(cost, here))
        return replace(stream, anchor=RegionSolver(cost, here, effort.significance, settings))


def _surroundings(step: Step) -> LinearModel | None:
    """What error bars follow from: a verified optimum."""
    solution = step.solution
    if solution.status is not Status.OPTIMUM or solution.at is None or solution.dual is None:
        return None
    return LinearModel(solution.at, solution.dual)


def _read_off(data: Data, cells: Array) -> Outcome:
    return Outcome(np.clip(cells, data.lower, data.upper), np.zeros(0), Status.APPROXIMATE, 0)


def _truncated(cost: Cost, data: Data, previous: Array | None, steps: int) -> Solution:
    start = data.measured / uniform_factor(*data.measured.shape[1:]) if previous is None else previous
    outcome = Newton(cost, Settings(max_iterations=steps)).solve(data, evaluated(cost, data, start))
    return approximation(cost, data, outcome)
