"""A recording's frames in order: absolute methods one by one, relative methods from a joint first pair on."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from lampest.cost import Cost
from lampest.efforts import Converged, Linearised, Region, Scaled, Truncated, TwoPoint
from lampest.estimator import Doubts, Estimator
from lampest.interrupts import delayed_interrupt
from lampest.kirchhoff import uniform_factor
from lampest.panel import Array, Panel
from lampest.problem import Data
from lampest.readings import Readings
from lampest.recording import UNLOADED, Recording
from lampest.region import RegionSolver
from lampest.scene import Faults
from lampest.search import best_solution, evaluated
from lampest.solvers.linearised import LinearisedSolver
from lampest.solvers.newton import Newton
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, Status, approximation


@dataclass(frozen=True, eq=False)
class Step:
    """One solve of a sequence: the last of its frames is the frame's estimate, the first of two the baseline's."""

    solution: Solution
    seconds: float


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Cell resistances of a recording's measured frames.

    frame : (frames) index into the recording. measured : (frames, rows, columns) ohm, series resistance taken off.
    measured_baseline : (rows, columns) ohm, mean of the unloaded frames, or the first frame where there is none.
    sigma, sigma_baseline : standard deviations of the two, or None where unknown.
    baseline, steps : how the baseline and every frame were solved; with `joint_start` the first step holds both.
    """

    recording: Recording
    estimator: Estimator
    frame: NDArray[np.intp]
    measured: Array
    measured_baseline: Array
    sigma: Array | None
    sigma_baseline: Array | None
    baseline_resistance: Array
    baseline: Step
    steps: tuple[Step, ...]
    joint_start: bool

    @property
    def cell_resistance(self) -> Array:
        """(frames, rows, columns) ohm; NaN where a frame failed."""
        return np.stack([step.solution.cell_resistance[-1] for step in self.steps])

    @property
    def relative_change(self) -> Array:
        """100·(r − r_baseline)/r_baseline, (frames, rows, columns) percent."""
        return 100 * (self.cell_resistance / self.baseline_resistance - 1)


def reconstruct(
    recording: Recording, estimator: Estimator, on_frame: Callable[[], None] = lambda: None
) -> Reconstruction:
    """Solve every measured frame of a recording.

    A frame that fails holds NaN and a status; the frames after it continue from the last one that was solved. Raises
    InputError where readings do not exceed the series resistance or the noise is needed and unknown.
    """
    readings = Readings.of(recording)
    stream = first_stream(recording, readings, estimator)
    frames = recording.measured_frames()
    steps: list[Step] = []
    for frame in frames:
        stream, step = stream.push(readings[frame])
        steps.append(step)
        on_frame()
    return Reconstruction(
        recording,
        estimator,
        frames,
        readings.resistance[frames],
        stream.resting.resistance,
        None if readings.sigma is None else readings.sigma[frames],
        stream.resting.sigma,
        stream.baseline_resistance,
        stream.baseline or steps[0],
        tuple(steps),
        estimator.joint_start,
    )


def first_stream(recording: Recording, readings: Readings, estimator: Estimator) -> "Stream":
    """The stream before a recording's first measured frame; the baseline is the mean of the unloaded frames."""
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    resting = readings[unloaded if len(unloaded) else [0]].mean()
    scene = recording.scene
    return Stream.begin(estimator, scene.panel, frame_period(recording), resting, scene.faults)


def frame_period(recording: Recording) -> float:
    """Median time between frames, s."""
    return float(np.median(np.diff(recording.time))) if len(recording.time) > 1 else float("inf")


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
    previous : (rows, columns) ohm, the last estimate, or None.
    anchor : what an effort has prepared from the solved baseline, or None.
    """

    estimator: Estimator
    panel: Panel
    period: float
    resting: Readings
    faults: Faults | None = None
    baseline: Step | None = None
    previous: Array | None = None
    anchor: LinearisedSolver | RegionSolver | None = None

    @classmethod
    def begin(
        cls, estimator: Estimator, panel: Panel, period: float, resting: Readings, faults: Faults | None = None
    ) -> "Stream":
        """Before the first frame; an absolute method solves its baseline now.

        Raises InputError where the noise is needed and unknown, or bounds leave no room.
        """
        stream = cls(estimator, panel, period, resting, faults)
        if estimator.joint_start:
            return stream
        if isinstance(estimator.effort, Linearised | Region):
            return stream._anchored(estimator.effort)
        baseline = stream._solve(*stream.given(resting))
        return replace(stream, baseline=baseline, previous=_estimate(baseline, 0))

    def push(self, readings: Readings) -> tuple["Stream", Step]:
        """Solve one frame's readings (rows, columns); a failed one leaves the stream as it was.

        Raises InputError as `begin`.
        """
        data, start = self.given(readings)
        step = self._solve(data, start)
        found = _estimate(step, -1)
        joint = len(data.measured) == 2
        return replace(
            self, baseline=step if joint else self.baseline, previous=self.previous if found is None else found
        ), step

    def given(self, readings: Readings) -> tuple[Data, Array | None]:
        """What the solve of a frame is given, with the baseline where both are solved jointly, and where it may start.

        The joint pair: paper, equations (15) and (21).
        """
        if self.estimator.joint_start and (self.baseline is None or not self.baseline.solution.solved):
            return self.estimator.data(self.resting.together(readings), None, self.faults), None
        known = None
        if self.estimator.relative:
            known = self._guess(readings.resistance) if self.previous is None else self.previous
        data = self.estimator.data(readings.alone(), known, self.faults)
        return data, None if self.previous is None else self.previous[None]

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline is not solved."""
        found = None if self.baseline is None else _estimate(self.baseline, 0)
        return np.full(self.panel.shape, np.nan) if found is None else found

    def _solve(self, data: Data, previous: Array | None) -> Step:
        with delayed_interrupt():
            doubts = Doubts.of(self.panel, self.faults, data)
            solver = self.estimator.problem(self.panel, len(data.measured), self.period, doubts)
            solver.prepare()
            begin = perf_counter()
            solution = self._solution(solver, data, previous)
            return Step(solution, perf_counter() - begin)

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

    def _anchored(self, effort: Linearised | Region) -> "Stream":
        """The stream after its baseline, solved to an optimum without the terms that compare with an earlier frame."""
        absolute = replace(self.estimator, effort=Converged(), terms=self.estimator.absolute_terms)
        alone = replace(self, estimator=absolute)
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


def _read_off(data: Data, cells: Array) -> Outcome:
    return Outcome(np.clip(cells, data.lower, data.upper), np.zeros(0), Status.APPROXIMATE, 0)


def _truncated(cost: Cost, data: Data, previous: Array | None, steps: int) -> Solution:
    start = data.measured / uniform_factor(*data.measured.shape[1:]) if previous is None else previous
    outcome = Newton(cost, Settings(max_iterations=steps)).solve(data, evaluated(cost, data, start))
    return approximation(cost, data, outcome)
