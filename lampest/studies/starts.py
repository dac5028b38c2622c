"""`lampest study starts`: how often a sequence's own start reaches the best minimum that random starts find."""

from dataclasses import dataclass

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import named_method
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.runs.config import Case, Run, read_run
from lampest.solvers.multistart import evaluated, solved_from
from lampest.solvers.solution import Status
from lampest.studies.study import Cases, Screen, Study, of_cases, screen_table


@dataclass(frozen=True)
class Tally:
    """Of one case: frames solved, frames at the best known objective, the worst excess, and distinct minima in a frame.

    A frame is at the best known objective φ where no random start ended more than 1e-6 below it, in units of φ plus the
    cost of a cell without a model. random_solved : of `random` solves from random starts.
    """

    recording: str
    estimator: str
    frames: int
    best: int
    worst_excess: float
    most_minima: int
    random_solved: int
    random: int


def tally(case: Case, random_starts: int, seed: int) -> Tally:
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
        if step.solution.status in (Status.UNREAD, Status.UNRESTED):
            continue
        estimator = case.estimator.with_weights(step.weights)  # those of `weight: auto` are the frame's
        others, own = _objectives(estimator, recording, data, random_starts, generator)
        ended += len(others)
        found = step.solution.objective if step.solution.solved else float("inf")
        least = min([found, *others])
        excess.append((found - least) / (least + own))
        ordered = np.sort(np.array([found, *others]) / (least + own))
        ordered = ordered[np.isfinite(ordered)]
        minima.append(int(1 + np.sum(np.diff(ordered) > 1e-6)) if len(ordered) else 0)
    at_best = sum(value <= 1e-6 for value in excess)
    worst, most = max(excess, default=0.0), max(minima, default=0)
    tried = random_starts * len(excess)
    return Tally(case.recording, case.name, len(excess), at_best, worst, most, ended, tried)


def _objectives(
    estimator: Estimator, recording: Recording, data: Data, count: int, generator: np.random.Generator
) -> tuple[list[float], float]:
    """(where solves from random starts end, the cost of a cell if f(r) were zero, at the least cells)."""
    cost = estimator.cost(recording.scene, len(data.measured), data.partial)
    solver = named_method("reduced").solver(cost, recording.scene, estimator.solver, 1.0)
    found = []
    for _ in range(count):
        start: Array = data.apparent_resistance * np.exp(generator.uniform(0, np.log(60), data.measured.shape))
        solution = solved_from(solver, evaluated(cost, data, start))
        if solution.solved:
            found.append(solution.objective)
    at = evaluated(cost, data, data.lower)
    return found, at.cost_scale - at.objective


SCREEN: Screen = {
    "recording": "{recording}",
    "estimator": "{estimator}",
    "frames at the best": "{best}/{frames}",
    "worst excess [%]": lambda one: f"{100 * one.worst_excess:.2g}",
    "most minima": "{most_minima}",
    "random solved": "{random_solved}/{random}",
}


def starts_study(random: int, seed: int) -> Study[Run, Cases[Tally]]:
    """The study with so many random starts for every frame."""
    return Study(
        "starts",
        "cases",
        "table1.yaml",
        read_run,
        lambda run, on_step: of_cases(lambda case: [tally(case, random, seed)], run, on_step),
        rows=lambda cases: cases.found,
        tables=lambda cases: [("", screen_table(cases.found, SCREEN))],
    )
