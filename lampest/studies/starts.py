"""How often the sequence's own start reaches the best known minimum: the same solves from random starts."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.runs.config import Case
from lampest.solvers.newton.newton import Newton
from lampest.solvers.search import solved_from
from lampest.solvers.solution import Status
from lampest.solvers.starts import evaluated

SAME = 1e-6
FARTHEST = 60.0


@dataclass(frozen=True)
class Tally:
    """Of one case: frames solved, frames at the best known objective, the worst excess, and distinct minima in a frame.

    A frame is at the best known objective φ where no random start ended more than 1e-6 below it, in units of φ plus the
    cost of a cell without a model.
    """

    recording: str
    estimator: str
    frames: int
    best: int
    worst_excess: float
    most_minima: int
    random_solved: int
    random: int


def tally(case: Case, random_starts: int, seed: int, on_frame: Callable[[], None] = lambda: None) -> Tally:
    """Replay a case's sequence; solve each frame also from `random_starts` starts r = R_m·exp(uniform(0, ln 60)).

    Frames of which too little was read to be solved are left out.
    """
    recording = Recording.load(case.path)
    readings = recording.readings()
    stream = first_stream(recording, readings, case.estimator)
    generator = np.random.default_rng(seed)
    excess, minima, ended = [], [], 0
    for frame in recording.measured_frames():
        data, _ = stream.given(readings[frame])
        stream, step = stream.push(readings[frame])
        on_frame()
        if step.solution.status in (Status.UNREAD, Status.UNRESTED):
            continue
        estimator = case.estimator.with_weights(step.weights)  # those of `weight: auto` are the frame's
        others = _objectives(estimator, recording, data, random_starts, generator)
        ended += len(others)
        found = step.solution.objective if step.solution.solved else float("inf")
        least = min([found, *others])
        size = least + _size(estimator, recording, data)
        excess.append((found - least) / size)
        minima.append(_distinct(np.array([found, *others]) / size))
    at_best = sum(value <= SAME for value in excess)
    tried = random_starts * len(excess)
    worst, most = max(excess, default=0.0), max(minima, default=0)
    return Tally(case.recording, case.name, len(excess), at_best, worst, most, ended, tried)


def _objectives(
    estimator: Estimator, recording: Recording, data: Data, count: int, generator: np.random.Generator
) -> list[float]:
    cost = _cost(estimator, recording, data)
    found = []
    for _ in range(count):
        start: Array = data.apparent_resistance * np.exp(generator.uniform(0, np.log(FARTHEST), data.measured.shape))
        solution = solved_from(Newton(cost, estimator.solver), evaluated(cost, data, start))
        if solution.solved:
            found.append(solution.objective)
    return found


def _cost(estimator: Estimator, recording: Recording, data: Data) -> Cost:
    return estimator.cost(recording.scene, len(data.measured), data.partial)


def _size(estimator: Estimator, recording: Recording, data: Data) -> float:
    """The cost of a cell if f(r) were zero, at the least cells that the bounds allow."""
    at = evaluated(_cost(estimator, recording, data), data, data.lower)
    return at.cost_scale - at.objective


def _distinct(objectives: Array) -> int:
    """Number of objectives that differ by more than 1e-6."""
    ordered = np.sort(objectives[np.isfinite(objectives)])
    return int(1 + np.sum(np.diff(ordered) > SAME)) if len(ordered) else 0
