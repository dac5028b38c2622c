"""The measurement: every rung goes through every recording in turn, A B C A B C, in one process.

Time and cell error are those of the rung's own sequence: what a user gets. Objectives of relative methods depend on the
previous estimate, so each estimate is judged by the same cost: with the previous frame of the reference, `reduced`, and
against the best that any rung found for it. A joint first pair is judged by its second frame, given the reference's
baseline, which it minimises, too.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import first_stream, reconstruct
from lampest.panel.panel import Array
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.compare import relative_error
from lampest.studies.methods import Shape
from lampest.studies.study import OnStep
from lampest.studies.timing import TimedFrames, peak_memory
from lampest.studies.tradeoff.settings import REFERENCE, Plan, TradeoffFile, TradeoffSubject, first_frames

CHANGED = 0.05  # a cell has changed that has left its unloaded resistance by more


@dataclass(frozen=True, eq=False)
class Measured(TimedFrames):
    """One rung with one method on one recording.

    Parameters
    ----------
    wall, cpu : of the solve, and of the processor from one frame to the next; the first frame of relative methods may
        hold the baseline as well.
    objective : as the module says. gap : (φ − φ_best)/(φ_best + what missing every reading by its noise costs): a gap
        far below 1 cannot be seen in the readings.
    subject, method, formulation : what was measured.
    baseline_s : of the unloaded baseline alone; 0 where it is solved with the first frame.
    cell_error, changed_error : (frames) median |r − truth|/truth over all cells, and over those whose truth has left
        the unloaded one by more than 5 %; percent; NaN without a truth, or where nothing has changed.
    memory_mb : peak of a fresh process with this rung on such a panel, libraries included; None: not measured.
    """

    subject: TradeoffSubject
    method: str
    formulation: str
    baseline_s: float
    cell_error: Array
    changed_error: Array
    memory_mb: float | None = None

    @property
    def shape(self) -> Shape:
        """(rows, columns)."""
        return self.subject.shape

    def times(self) -> Array:
        """(frames) s: the least of the repeats; the processor's time where something else disturbed it."""
        return np.asarray(np.minimum(self.wall, self.cpu).min(axis=1))


_Passage = tuple[Estimates, Array]  # through a recording: estimates, and the processor's s of each frame


def _passage(recording: Recording, estimator: Estimator) -> _Passage:
    """Solve the frames in sequence."""
    clock = [process_time()]
    found = reconstruct(recording, estimator, lambda: clock.append(process_time()))
    return found, np.diff(clock)


def run_tradeoff(plan: Plan, on_step: OnStep = lambda done, total: None) -> tuple[Measured, ...]:
    """Measure everything. on_step is called with how many of how many parts are done."""
    settings = plan.settings
    fresh = list(_memory_tasks(plan))
    chosen = [(subject, method) for subject in plan.subjects for method in settings.methods(subject.shape)]
    measured: list[Measured] = []
    for done, (subject, method) in enumerate(chosen, 1):
        measured += _measure(settings, subject, method)
        on_step(done, len(chosen) + len(fresh))
    memory = {}
    for done, (shape, name, task) in enumerate(fresh, len(chosen) + 1):
        memory[shape, name] = peak_memory(_solve, task)
        on_step(done, len(chosen) + len(fresh))
    return tuple(replace(one, memory_mb=memory.get((one.shape, one.formulation))) for one in measured)


def _measure(settings: TradeoffFile, subject: TradeoffSubject, method: str) -> Iterator[Measured]:
    """All rungs with one method on one recording."""
    recording = subject.recording
    rungs = settings.rungs(subject.shape)
    runs: dict[str, list[_Passage]] = {name: [] for name in rungs}
    begin = perf_counter()
    for turn in range(settings.repeats):
        if turn and perf_counter() - begin > settings.patience_s:
            break
        for name, formulation in rungs.items():
            runs[name].append(_passage(recording, settings.estimator(method, formulation)))
    objective, noise = _judged({name: run[0][0] for name, run in runs.items()})
    least = np.nanmin(np.stack(list(objective.values())), axis=0)
    for name, run in runs.items():
        gap = (objective[name] - least) / (least + noise)
        yield _measured(subject, method, name, run, objective[name], gap)


def _measured(
    subject: TradeoffSubject, method: str, name: str, runs: list[_Passage], objective: Array, gap: Array
) -> Measured:
    first = runs[0][0]
    cell, changed = errors(first)
    return Measured(
        subject=subject,
        method=method,
        formulation=name,
        wall=np.stack([[step.seconds for step in found.steps] for found, _ in runs], axis=1),
        cpu=np.stack([cpu for _, cpu in runs], axis=1),
        baseline_s=0.0 if first.joint_start else min(found.baseline.seconds for found, _ in runs),
        cell_error=cell,
        changed_error=changed,
        objective=objective,
        gap=gap,
        **TimedFrames.ends([step.solution for step in first.steps]),
    )


def errors(found: Estimates) -> tuple[Array, Array]:
    """(frames) median error of all cells and of the changed ones, percent; NaN where there is nothing to compare."""
    recording, frames = found.recording, len(found.frame)
    truth = recording.truth_cell_resistance
    if truth is None:
        return np.full(frames, np.nan), np.full(frames, np.nan)
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    resting = np.median(truth[unloaded], axis=0) if len(unloaded) else truth[0]
    error = relative_error(found.cell_resistance, truth[found.frame])
    changed = np.abs(truth[found.frame] / resting - 1) > CHANGED
    inside = [np.median(part[which]) if which.any() else np.nan for part, which in zip(error, changed, strict=True)]
    return np.median(error, axis=(1, 2)), np.array(inside)


def _judged(runs: dict[str, Estimates]) -> tuple[dict[str, Array], Array]:
    """(objective of every rung's estimates, what noise costs), each (frames), all with the reference's previous."""
    costs = list(_costs(runs[REFERENCE]))
    objective = {
        name: np.array([_objective(*cost, cells) for cost, cells in zip(costs, found.cell_resistance, strict=True)])
        for name, found in runs.items()
    }
    return objective, np.array([_noise_cost(*cost) for cost in costs])


def _costs(reference: Estimates) -> Iterator[tuple[Cost, Data]]:
    """Every frame's cost and data, with the reference's estimate of the frame before."""
    recording, estimator = reference.recording, reference.estimator
    readings = recording.readings()
    stream = replace(first_stream(recording, readings, estimator), baseline=reference.baseline)
    before = np.concatenate([reference.baseline_resistance[None], reference.cell_resistance[:-1]])
    for frame, previous in zip(reference.frame, before, strict=True):
        data, _ = replace(stream, previous=previous).given(readings[frame])
        yield estimator.cost(recording.scene, len(data.measured), data.partial), data


def _objective(cost: Cost, data: Data, cells: Array) -> float:
    if not np.all(np.isfinite(cells)):
        return float("nan")
    # What a rung with other data (the joint pair) puts a hair outside the bounds must not look better for it.
    return Evaluation.at(cost, data, np.clip(cells, data.lower[0], data.upper[0])[None]).objective


def _noise_cost(cost: Cost, data: Data) -> float:
    """The misfit terms where every reading is missed by its standard deviation."""
    costs = Evaluation(cost, data, data.apparent_resistance, data.measured + data.sigma, ()).costs
    return float(sum(value for term, value in zip(cost.terms, costs, strict=True) if term.reads_measurement))


Task = tuple[Estimator, Recording]


def _memory_tasks(plan: Plan) -> Iterator[tuple[Shape, str, Task]]:
    """Every rung on every size of panel, with two frames of the first of its recordings."""
    settings = plan.settings
    first = {subject.shape: subject for subject in reversed(plan.subjects)} if settings.memory is not None else {}
    for shape in dict.fromkeys(subject.shape for subject in plan.subjects if subject.shape in first):
        short = first_frames(first[shape].recording, 2)
        for name, formulation in settings.rungs(shape).items():
            yield shape, name, (settings.estimator(str(settings.memory), formulation), short)


def _solve(task: Task) -> None:
    estimator, recording = task
    reconstruct(recording, estimator)
