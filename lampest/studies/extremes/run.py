"""The measurement: every scene by every method; of each solve how it ended, and how right it is."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import nan

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
from lampest.studies.extremes.judges import (
    convex_estimate,
    correct_digits,
    exact_cost,
    exact_residual,
    exact_scale,
    fifty_digits,
)
from lampest.studies.extremes.scenes import AtlasFile, AtlasSample, AtlasTask, Made, recording_of
from lampest.studies.study import OnStep, of_tasks

CRASHED, REFUSED = "crashed: ", "refused: "


@dataclass(frozen=True)
class Solve:
    """One solve of the atlas; `COLUMNS` say what each field is, digits are log relative errors (NIST StRD).

    audited : NaN where there is no estimate or the panel is large. excess : (φ(estimate) − φ(truth within the
    bounds))/s. estimate_digits : of an estimate without penalties from attainable readings, against the convex one; in
    a scaled scene of any, against the scaled estimate of the original.
    """

    sample: AtlasSample
    method: str
    formulation: str
    part: str
    solved: bool
    status: str
    iterations: int
    residual: float = nan
    audited: float = nan
    excess: float = nan
    forward_digits: float = nan
    model_digits: float = nan
    estimate_digits: float = nan

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


COLUMNS = (
    ("case", "1", "name of the scene", "sample.case"),
    ("rows", "1", "row lines", "sample.rows"),
    ("columns", "1", "column lines", "sample.columns"),
    ("decades", "1", "decades between the least and the largest cell", "sample.decades"),
    ("noise", "1", "relative standard deviation of a reading", "sample.noise"),
    ("seed", "1", "seed of cells and noise", "sample.seed"),
    ("method", "1", "method"),
    ("formulation", "1", "formulation"),
    ("part", "1", "baseline, frame, or the pair of both"),
    ("verified", "1", "1: an estimate that nothing speaks against"),
    ("solved", "1", "1: there is an estimate"),
    ("doubtful", "1", "1: an estimate that the audit does not confirm"),
    ("status", "1", "how the solve ended"),
    ("iterations", "1", "iterations of the solver"),
    ("kkt_residual", "1", "KKT residual of the accepted estimate", "residual"),
    ("audited_residual", "1", "the same by differences of the exact forward map", "audited"),
    ("excess", "1", "cost of the estimate over that of the truth, scaled"),
    ("forward_digits", "1", "LRE of the forward map, 50 digits"),
    ("model_digits", "1", "LRE of the estimate's two-point resistance"),
    ("estimate_digits", "1", "LRE against the convex solution"),
)


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
    forward = [correct_digits(two_point_resistance(cells), fifty_digits(cells)) for cells in scene.cells]
    solves: list[Solve] = []
    for formulation in task.formulations:
        for name, method in atlas.estimators.items():
            terms = method.parts
            if scene.weight is not None:
                terms = tuple(term if term.reads_measurement else replace(term, weight=scene.weight) for term in terms)
            estimator = Estimator(terms, formulation, atlas.solver)
            try:
                solves += _solves(task, name, estimator, recording, scene)
            except InputError as error:
                solves.append(_failed(sample, name, formulation, "frame", f"{REFUSED}{error}"))
            except Exception as error:  # whatever it is, the atlas shows it
                solves.append(_failed(sample, name, formulation, "frame", f"{CRASHED}{type(error).__name__}: {error}"))
    return tuple(replace(solve, forward_digits=min(forward)) for solve in solves)


def _failed(sample: AtlasSample, method: str, formulation: str, part: str, status: str) -> Solve:
    return Solve(sample, method, formulation, part, False, status, 0)


def _solves(task: AtlasTask, method: str, estimator: Estimator, recording: Recording, scene: Made) -> Iterator[Solve]:
    """The baseline and the frame, or the pair of both; where the scene is a scaled one, against the original."""
    originals: Sequence[_Part | None] = (None, None)
    if scene.scale != 1:
        sigma = None if recording.sigma is None else recording.sigma / scene.scale
        original = replace(recording, recorded=recording.recorded / scene.scale, sigma=sigma)
        originals = list(_parts(estimator, original))
        # Of all residuals only relative changes do not grow with the unit.
        squared = [scene.scale**2 if term.needs_previous else 1.0 for term in estimator.terms]
        weights = zip(estimator.terms, squared, strict=True)
        estimator = estimator.with_weights(float(term.weight) * factor for term, factor in weights)
    for part, before in zip(_parts(estimator, recording), originals, strict=False):
        solve = _judged(task, method, part, scene, recording)
        if before is not None and solve.solved and before.step.solution.solved:
            alike = scene.scale * before.step.solution.cell_resistance
            solve = replace(solve, estimate_digits=correct_digits(part.step.solution.cell_resistance, alike))
        yield solve


@dataclass(frozen=True, eq=False)
class _Part:
    """One solve of a sequence with its data; frames : which of the scene's; estimator : whose cost it minimises."""

    name: str
    frames: slice
    estimator: Estimator
    data: Data
    step: Step


def _parts(estimator: Estimator, recording: Recording) -> Iterator[_Part]:
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


def _judged(task: AtlasTask, method: str, part: _Part, scene: Made, recording: Recording) -> Solve:
    solution, data, estimator = part.step.solution, part.data, part.estimator
    cost = estimator.cost(recording.scene, len(data.measured), data.partial)
    solve = Solve(
        task.sample,
        method,
        estimator.method.kind,
        part.name,
        solution.solved,
        solution.status.value,
        solution.iterations,
        solution.kkt_residual,
    )
    if not solution.solved:
        return solve
    cells = solution.cell_resistance
    truth = np.clip(scene.cells[part.frames], data.lower, data.upper)
    audit = cells[0].size <= task.atlas.audit_cells
    return replace(
        solve,
        audited=exact_residual(cost, data, cells) if audit else nan,
        excess=(exact_cost(cost, data, cells) - exact_cost(cost, data, truth)) / exact_scale(cost, data, cells),
        model_digits=correct_digits(solution.reading, exact_two_point_resistance(cells)),
        estimate_digits=_against_convex(estimator, data, cells),
    )


def _against_convex(estimator: Estimator, data: Data, cells: Array) -> float:
    """LRE against the convex solution where that is the answer: no penalties, no marks, no bound in the way."""
    if not all(term.reads_measurement for term in estimator.terms) or data.partial:
        return nan
    certified = convex_estimate(data.measured[0])
    if certified is None or np.any(certified < data.lower[0]) or np.any(certified > data.upper[0]):
        return nan
    return correct_digits(cells[0], certified)
