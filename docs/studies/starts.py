"""How often a sequence's own start reaches the best minimum that random starts find.

Run it with: python -m docs.studies.starts [RUN] [--random 20] [--seed 0] [--out DIR] [--set
PATH=VALUE]
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from docs.studies import script
from docs.studies.cases import Cases, of_cases
from lampest.apps.studies.study import Study
from lampest.estimate.methods import named_method
from lampest.estimate.sequence import first_stream
from lampest.recording.recording import Recording
from lampest.report.compare import Columns
from lampest.runs.config import Case, Run, read_run
from lampest.solvers.multistart import evaluated, solved_from
from lampest.solvers.solution import Status


@dataclass(frozen=True)
class Tally:
    """Counts of one case: frames solved, frames at the best known objective, and distinct minima.

    A frame is at the best known objective φ where no random start ended more than 1e-6 below it, in
    units of φ plus the cost of a cell without a model. worst : the largest excess. random_solved :
    of `random` solves from random starts.
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
    """Count the frames with enough readings for a solve."""
    excess = []
    minima = []
    ended = 0
    for results, objectives, unit in _objectives(case, random_starts, np.random.default_rng(seed)):
        least = min([results, *objectives])
        ended = ended + len(objectives)
        excess.append((results - least) / (least + unit))
        ordered = np.sort(np.array([results, *objectives]) / (least + unit))
        ordered = ordered[np.isfinite(ordered)]
        minima.append(int(1 + np.sum(np.diff(ordered) > 1e-6)) if len(ordered) else 0)
    at_best = sum(value <= 1e-6 for value in excess)
    worst = max(excess, default=0.0)
    most = max(minima, default=0)
    return Tally(
        case.recording,
        case.name,
        len(excess),
        at_best,
        worst,
        most,
        ended,
        random_starts * len(excess),
    )


def _objectives(
    case: Case, count: int, generator: np.random.Generator
) -> Iterator[tuple[float, list[float], float]]:
    """Yield the objective of each frame of a case's sequence, infinite where its solve failed.

    The second value lists the objectives from random starts r = R_m·exp(uniform(0, ln 60)). The
    third is the cost of a cell if f(r) were zero, at the least cells.
    """
    recording = Recording.load(case.path)
    readings = recording.readings()
    stream = first_stream(recording, readings, case.estimator)
    for frame in recording.measured_frames():
        data, _ = stream.data_and_start(readings[frame])
        stream, step = stream.push(readings[frame])
        if step.solution.status in (Status.UNREAD, Status.UNRESTED):
            continue
        # Weights of `weight: auto` are the frame's.
        cost = case.estimator.with_weights(step.weights).cost(
            recording.scene, len(data.measured), partial=data.partial
        )
        solver = named_method("reduced").solver(cost, recording.scene, case.estimator.solver, 1.0)
        places = (
            np.exp(generator.uniform(0, np.log(60), data.measured.shape)) for _ in range(count)
        )
        ends = [
            solved_from(solver, evaluated(cost, data, data.apparent_resistance * place))
            for place in places
        ]
        least = evaluated(cost, data, data.lower)
        results = step.solution.objective if step.solution.solved else np.inf
        yield (
            results,
            [end.objective for end in ends if end.solved],
            least.cost_scale - least.objective,
        )


SCREEN: Columns = {
    "recording": "{recording}",
    "estimator": "{estimator}",
    "frames at the best": "{best}/{frames}",
    "worst excess [%]": lambda record: f"{100 * record.worst_excess:.2g}",
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
        rows=lambda cases: cases.measured,
        sheets=lambda cases: [("", cases.measured, SCREEN)],
    )


if __name__ == "__main__":
    parser = script.parser_of(__doc__)
    parser.add_argument("--random", type=int, default=20, help="random starts of each frame")
    parser.add_argument("--seed", type=int, default=0, help="random seed of the starts")
    script.main(lambda options: starts_study(options.random, options.seed), parser)
