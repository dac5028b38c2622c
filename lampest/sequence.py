"""A recording's frames in order: absolute methods one by one, relative methods from a joint first pair on."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from lampest.estimator import Estimator
from lampest.kirchhoff import uniform_factor
from lampest.panel import Array
from lampest.problem import Cost, Data, Evaluation
from lampest.recording import MEASURED, UNLOADED, Recording
from lampest.solvers.convex import convex_start
from lampest.solvers.solution import Solution, check


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
    sequence = _Sequence(estimator, recording, resting, resting_sigma)
    frames = np.flatnonzero(recording.role == MEASURED)
    baseline = None if estimator.relative else sequence.single(resting, resting_sigma, None)
    previous = None if baseline is None else _estimate(baseline, 0)
    base_estimate = previous
    steps: list[Step] = []
    for frame in frames:
        frame_sigma = None if sigma is None else sigma[frame]
        if estimator.relative and base_estimate is None:
            step = sequence.joint(network[frame], frame_sigma)
            base_estimate, baseline = _estimate(step, 0), step
        else:
            step = sequence.single(network[frame], frame_sigma, previous)
        steps.append(step)
        found = _estimate(step, -1)
        previous = previous if found is None else found
        on_frame()
    if baseline is None:
        baseline = sequence.joint(resting, resting_sigma)
        base_estimate = _estimate(baseline, 0)
    nothing = np.full(resting.shape, np.nan)
    return Reconstruction(
        recording,
        estimator,
        frames,
        network[frames],
        resting,
        nothing if base_estimate is None else base_estimate,
        baseline,
        tuple(steps),
        estimator.relative,
    )


def _estimate(step: Step, frame: int) -> Array | None:
    return step.solution.cell_resistance[frame] if step.solution.solved else None


@dataclass(frozen=True, eq=False)
class _Sequence:
    """The solves that a sequence is made of."""

    estimator: Estimator
    recording: Recording
    resting: Array
    resting_sigma: Array | None

    def single(self, measured: Array, sigma: Array | None, previous: Array | None) -> Step:
        """One frame; starts at the cheapest of the convex estimate, the previous frame and a uniform panel."""
        known = previous if self.estimator.relative else None
        data = self.estimator.data(measured[None], None if sigma is None else sigma[None], known)
        return self._solve(data, [] if previous is None else [previous[None]])

    def joint(self, measured: Array, sigma: Array | None) -> Step:
        """The baseline and a frame together; paper, equations (15) and (21)."""
        both = None if sigma is None or self.resting_sigma is None else np.stack([self.resting_sigma, sigma])
        return self._solve(self.estimator.data(np.stack([self.resting, measured]), both), [])

    def _solve(self, data: Data, starts: list[Array]) -> Step:
        solver = self.estimator.problem(self.recording.scene.panel, len(data.measured))
        solver.prepare()
        begin = perf_counter()
        outcome = solver.solve(data, best_start(solver.cost, data, starts))
        solution = check(solver.cost, data, outcome)
        return Step(solution, perf_counter() - begin)


def best_start(cost: Cost, data: Data, starts: list[Array]) -> Evaluation:
    """The start of least cost among those given, the convex estimate of every frame, and r = R_m·MN/(M + N − 1)."""
    convex = np.stack([convex_start(*pair) for pair in zip(data.measured, data.upper, strict=True)])
    uniform = data.measured / uniform_factor(*data.measured.shape[1:])
    evaluations = [cost.evaluate(data, np.clip(start, data.lower, data.upper)) for start in (*starts, convex, uniform)]
    return min(evaluations, key=lambda evaluation: evaluation.objective)
