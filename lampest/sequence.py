"""A recording's frames in order: absolute methods one by one, relative methods from a joint first pair on."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from lampest.cost import Cost
from lampest.estimator import Estimator
from lampest.kirchhoff import uniform_factor
from lampest.panel import Array, Panel
from lampest.problem import Data, Evaluation
from lampest.recording import UNLOADED, Recording
from lampest.solvers.convex import convex_start
from lampest.solvers.newton import Newton
from lampest.solvers.solution import VERIFIED, Settings, Solution, Solver, Status, check
from lampest.terms.misfit import Misfit

POLISHED = 0.1 * VERIFIED
LAST_STEPS = Settings(max_iterations=20)


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
    baseline, steps : how the baseline and every frame were solved; with `joint_start` the first step holds both.
    """

    recording: Recording
    estimator: Estimator
    frame: NDArray[np.intp]
    measured: Array
    measured_baseline: Array
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
    network = recording.network_resistance()
    sigma = recording.sigma_or_none()
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    if len(unloaded) == 0:
        unloaded = np.array([0])
    resting = network[unloaded].mean(axis=0)
    resting_sigma = None if sigma is None else np.sqrt(np.sum(sigma[unloaded] ** 2, axis=0)) / len(unloaded)
    stream = Stream.begin(estimator, recording.scene.panel, frame_period(recording), resting, resting_sigma)
    frames = recording.measured_frames()
    steps: list[Step] = []
    for frame in frames:
        stream, step = stream.push(network[frame], None if sigma is None else sigma[frame])
        steps.append(step)
        on_frame()
    return Reconstruction(
        recording,
        estimator,
        frames,
        network[frames],
        resting,
        stream.baseline_resistance,
        stream.baseline or steps[0],
        tuple(steps),
        estimator.relative,
    )


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
    resting, resting_sigma : (rows, columns) ohm, the unloaded readings and their σ or None.
    baseline : how the baseline was solved; None for a relative method until a frame was.
    previous : (rows, columns) ohm, the last estimate, or None.
    """

    estimator: Estimator
    panel: Panel
    period: float
    resting: Array
    resting_sigma: Array | None
    baseline: Step | None = None
    previous: Array | None = None

    @classmethod
    def begin(
        cls, estimator: Estimator, panel: Panel, period: float, resting: Array, resting_sigma: Array | None
    ) -> "Stream":
        """Before the first frame; an absolute method solves its baseline now.

        Raises InputError where the noise is needed and unknown, or bounds leave no room.
        """
        stream = cls(estimator, panel, period, resting, resting_sigma)
        if estimator.relative:
            return stream
        baseline = stream._single(resting, resting_sigma)
        return replace(stream, baseline=baseline, previous=_estimate(baseline, 0))

    def push(self, measured: Array, sigma: Array | None) -> tuple["Stream", Step]:
        """Solve one frame, (rows, columns) ohm, series resistance taken off; a failed one leaves the stream as it was.

        Raises InputError as `begin`.
        """
        joint = self.estimator.relative and (self.baseline is None or not self.baseline.solution.solved)
        step = self._joint(measured, sigma) if joint else self._single(measured, sigma)
        found = _estimate(step, -1)
        return replace(
            self, baseline=step if joint else self.baseline, previous=self.previous if found is None else found
        ), step

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline is not solved."""
        found = None if self.baseline is None else _estimate(self.baseline, 0)
        return np.full(self.panel.shape, np.nan) if found is None else found

    def _single(self, measured: Array, sigma: Array | None) -> Step:
        """One frame; starts from the previous one where that is known."""
        known = self.previous if self.estimator.relative else None
        data = self.estimator.data(measured[None], None if sigma is None else sigma[None], known)
        return self._solve(data, None if self.previous is None else self.previous[None])

    def _joint(self, measured: Array, sigma: Array | None) -> Step:
        """The baseline and a frame together; paper, equations (15) and (21)."""
        both = None if sigma is None or self.resting_sigma is None else np.stack([self.resting_sigma, sigma])
        return self._solve(self.estimator.data(np.stack([self.resting, measured]), both), None)

    def _solve(self, data: Data, previous: Array | None) -> Step:
        solver = self.estimator.problem(self.panel, len(data.measured), self.period)
        solver.prepare()
        begin = perf_counter()
        solution = best_solution(solver, data, previous)
        return Step(solution, perf_counter() - begin)


def best_solution(solver: Solver, data: Data, previous: Array | None) -> Solution:
    """The solution from the cheapest start; where the cost has several minima and the solve was hard, of all starts.

    Starts are the previous estimate, r = R_m·MN/(M + N − 1), and the convex one where it is near the answer: without a
    previous frame, or without a penalty. A solve is hard that fails, takes many iterations or has no previous frame;
    then the reduced solver tries all starts, and `solver` goes on from the best of them.
    """
    relative = any(term.needs_previous for term in solver.cost.terms)
    plain = all(isinstance(term, Misfit) for term in solver.cost.terms)
    starts = [data.measured / uniform_factor(*data.measured.shape[1:])]
    starts += [convex(data)] if previous is None or plain else []
    starts += [] if previous is None else [previous]
    points = sorted((evaluated(solver.cost, data, start) for start in starts), key=lambda point: point.objective)
    found = solved(solver, points[0])
    if found.solved and not (relative and (previous is None or found.iterations > solver.easy)):
        return found
    points += [evaluated(solver.cost, data, convex(data))] if len(starts) < 3 and previous is not None else []
    scouts = [solved(Newton(solver.cost, solver.settings), point) for point in points]
    best = min((scout for scout in scouts if scout.solved), key=lambda scout: scout.objective, default=found)
    if found.solved and not best.objective < found.objective * (1 - 1e-9):
        return found
    if isinstance(solver, Newton) or best is found:
        return best
    return solved(solver, evaluated(solver.cost, data, best.cell_resistance))


def convex(data: Data) -> Array:
    """The convex start of every frame."""
    return np.stack([convex_start(*pair) for pair in zip(data.measured, data.upper, strict=True)])


def evaluated(cost: Cost, data: Data, start: Array) -> Evaluation:
    """The cost at a start that is put within the bounds."""
    return Evaluation.at(cost, data, np.clip(start, data.lower, data.upper))


def solved(solver: Solver, start: Evaluation) -> Solution:
    """Solve from one start, and, where an interior-point method stopped short of its bounds, take the last steps."""
    outcome = solver.solve(start.data, start)
    solution = check(start, outcome)
    if solution.kkt_residual <= POLISHED or isinstance(solver, Newton) or outcome.status is not Status.OPTIMUM:
        return solution
    near = evaluated(solver.cost, start.data, outcome.cell_resistance)
    finished = Newton(solver.cost, LAST_STEPS).solve(start.data, near)
    polished = check(start, replace(finished, iterations=outcome.iterations))
    return polished if polished.solved else solution
