"""The measurement: every scene by every method; of each solve how it ended, and how right it is."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import nan
from typing import NamedTuple

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import first_stream, frame_period
from lampest.estimate.state import Step
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts.star_mesh import exact_two_point_resistance, two_point_resistance
from lampest.recording.recording import Recording
from lampest.solvers.solution import VERIFIED
from lampest.studies.extremes.judges import correct_digits, exact_cost, exact_residual, exact_scale, fifty_digits
from lampest.studies.extremes.scenes import AtlasFile, AtlasSample, AtlasTask, recording_of
from lampest.studies.study import OnStep, column, of_tasks

CRASHED, REFUSED = "crashed: ", "refused: "


@dataclass(frozen=True)
class Solve(AtlasSample):
    """One solve of the atlas; digits are log relative errors (NIST StRD)."""

    method: str = column("1", "method")
    formulation: str = column("1", "formulation")
    part: str = column("1", "baseline, frame, or the pair of both")
    solved: bool = column("1", "1: there is an estimate")
    status: str = column("1", "how the solve ended")
    iterations: int = column("1", "iterations of the solver", 0)
    residual: float = column("1", "KKT residual of the accepted estimate", nan)
    audited: float = column("1", "the same by differences of the exact forward map; NaN on large panels", nan)
    excess: float = column("1", "cost of the estimate over that of the truth within the bounds, scaled", nan)
    forward_digits: float = column("1", "LRE of the forward map, 50 digits", nan)
    model_digits: float = column("1", "LRE of the estimate's two-point resistance", nan)

    @property
    def doubtful(self) -> bool:
        """An estimate that the second test of optimality does not confirm."""
        return self.solved and self.audited > 10 * VERIFIED  # of a residual by differences

    @property
    def verified(self) -> bool:
        """An estimate, and nothing speaks against it."""
        return self.solved and not self.doubtful

    @property
    def crashed(self) -> bool:
        """No estimate, and no sentence that says why."""
        return self.status.startswith(CRASHED)


def run_atlas(atlas: AtlasFile, on_step: OnStep = lambda done, total: None) -> tuple[Solve, ...]:
    """Measure everything, in the order of the atlas. on_step is called with how many of how many scenes are done.

    Raises InputError where mpmath is not installed.
    """
    fifty_digits(np.ones((1, 1)))

    def lost(task: AtlasTask, error: object) -> Solve:
        return _failed(task.sample, "", "", "", f"{CRASHED}{type(error).__name__}: {error}")

    return of_tasks(solves_of, atlas.tasks, atlas.executor, lost, on_step)


def solves_of(task: AtlasTask) -> tuple[Solve, ...]:
    """All solves of one scene."""
    sample, atlas = task.sample, task.atlas
    recording, scene = recording_of(sample)
    forward = min(correct_digits(two_point_resistance(cells), fifty_digits(cells)) for cells in scene.cells)
    solves: list[Solve] = []
    for formulation in task.formulations:
        for name, method in atlas.estimators.items():
            terms = method.parts
            if scene.weight is not None:
                terms = tuple(term if term.reads_measurement else replace(term, weight=scene.weight) for term in terms)
            try:
                parts = _parts(Estimator(terms, formulation, atlas.solver), recording)
                solves += [_judged(task, name, part, recording, scene.cells) for part in parts]
            except InputError as error:
                solves.append(_failed(sample, name, formulation, "frame", f"{REFUSED}{error}"))
            except Exception as error:  # whatever it is, the atlas shows it
                solves.append(_failed(sample, name, formulation, "frame", f"{CRASHED}{type(error).__name__}: {error}"))
    return tuple(replace(solve, forward_digits=forward) for solve in solves)


def _failed(sample: AtlasSample, method: str, formulation: str, part: str, status: str) -> Solve:
    return Solve(**vars(sample), method=method, formulation=formulation, part=part, solved=False, status=status)


class _Part(NamedTuple):
    """One solve of a sequence with its data; frames : which of the scene's; estimator : whose cost it minimises."""

    name: str
    frames: slice
    estimator: Estimator
    data: Data
    step: Step


def _parts(estimator: Estimator, recording: Recording) -> Iterator[_Part]:
    """The baseline and the frame, or the pair of both."""
    readings = recording.readings()
    stream = first_stream(recording, readings, estimator)
    if stream.baseline is not None:
        alone = replace(estimator, terms=estimator.absolute_terms)
        blank = Stream(alone, recording.scene, frame_period(recording), readings[0])
        yield _Part("baseline", slice(0, 1), alone, blank.given(blank.resting)[0], stream.baseline)
    data, _ = stream.given(readings[1])
    _, step = stream.push(readings[1])
    joint = len(data.measured) == 2
    yield _Part("pair" if joint else "frame", slice(0 if joint else 1, 2), estimator, data, step)


def _judged(task: AtlasTask, method: str, part: _Part, recording: Recording, cells: Array) -> Solve:
    """What a solve came to, beside the scene's cells (2, rows, columns) ohm."""
    solution, data, estimator = part.step.solution, part.data, part.estimator
    cost = estimator.cost(recording.scene, len(data.measured), data.partial)
    solve = Solve(
        **vars(task.sample),
        method=method,
        formulation=estimator.method.kind,
        part=part.name,
        solved=solution.solved,
        status=solution.status.value,
        iterations=solution.iterations,
        residual=solution.kkt_residual,
    )
    if not solution.solved:
        return solve
    found, truth = solution.cell_resistance, np.clip(cells[part.frames], data.lower, data.upper)
    return replace(
        solve,
        audited=exact_residual(cost, data, found) if found[0].size <= task.atlas.audit_cells else nan,
        excess=(exact_cost(cost, data, found) - exact_cost(cost, data, truth)) / exact_scale(cost, data, found),
        model_digits=correct_digits(solution.reading, exact_two_point_resistance(found)),
    )
