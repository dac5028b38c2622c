"""The measurement: every rung goes through every recording in turn, A B C A B C, in one process; its rows and files.

Time and cell error are those of the rung's own sequence: what a user gets. Objectives of relative methods depend on the
previous estimate, so each estimate is judged by the same cost: with the previous frame of the reference, `reduced`, and
against the best that any rung found for it. A joint first pair is judged by its second frame, given the reference's
baseline, which it minimises, too.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import first_stream, reconstruct
from lampest.files import hdf5
from lampest.panel.panel import Array
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.compare import Table, relative_error
from lampest.studies import study
from lampest.studies.methods import Shape
from lampest.studies.study import OnStep
from lampest.studies.timing import TimedFrames, peak_memory
from lampest.studies.tradeoff.figure import front, tradeoff_figure
from lampest.studies.tradeoff.settings import REFERENCE, Plan, TradeoffFile, TradeoffSubject, first_frames, read_plan

REACHED = 1e-6  # the gap of a frame that has reached the optimum
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


Group = Sequence[Measured]
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


def _one(name: Callable[[Measured], str]) -> Callable[[Group], str]:
    """What all have in common; 'all' where they differ."""

    def only(own: Group) -> str:
        different = list(dict.fromkeys(map(name, own)))
        return different[0] if len(different) == 1 else "all"

    return only


def _over(what: str, own: Group) -> Any:
    """A figure of all frames; a failed frame's gap is infinite."""
    values = np.concatenate([getattr(one, what) for one in own])
    return np.nan_to_num(values, nan=np.inf) if what == "gap" else values


def _median(what: str) -> Callable[[Group], float | None]:
    def median(own: Group) -> float | None:
        values = _over(what, own)
        values = values[np.isfinite(values)]
        return float(np.median(values)) if len(values) else None

    return median


FIGURES: study.Figures = {
    "rows": lambda own: own[0].shape[0],
    "columns": lambda own: own[0].shape[1],
    "recording": _one(lambda one: one.subject.recording.name),
    "scene": _one(lambda one: one.subject.scene),
    "noise": _one(lambda one: one.subject.noise),
    "method": _one(lambda one: one.method),
    "formulation": lambda own: own[0].formulation,
    "first_ms": lambda own: 1e3 * float(np.median([one.baseline_s + one.times()[0] for one in own])),  # with baseline
    "frame_ms": lambda own: 1e3 * float(np.median(np.concatenate([one.times()[1:] for one in own]))),
    "cell_error": _median("cell_error"),  # over frames of a frame's median, percent; None without a truth
    "changed_error": _median("changed_error"),  # the same of cells that have changed
    "gap": lambda own: float(np.median(_over("gap", own))),
    "worst_gap": lambda own: float(np.max(_over("gap", own))),
    "reached": lambda own: float(np.mean(_over("gap", own) <= REACHED)),  # share of the frames
    "frames": lambda own: len(_over("gap", own)),
    "failed": lambda own: int(np.sum(~_over("solved", own))),
    "memory_mb": lambda own: own[0].memory_mb,  # peak of a fresh process, libraries included
}
SCREEN: dict[str, Callable[[study.Row], str]] = {
    "panel": lambda row: f"{row.rows} × {row.columns}",
    "method": lambda row: row.method,
    "formulation": lambda row: row.formulation,
    "first [ms]": lambda row: f"{row.first_ms:.3g}",
    "frame [ms]": lambda row: f"{row.frame_ms:.3g}",
    "cell error [%]": lambda row: study.text_of(row.cell_error),
    "of changed cells [%]": lambda row: study.text_of(row.changed_error),
    "gap median / worst": lambda row: f"{row.gap:.0e} / {row.worst_gap:.0e}",
    "reached [%]": lambda row: f"{100 * row.reached:.0f}",
    "failed": lambda row: f"{row.failed}/{row.frames}",
    "memory [MB]": lambda row: study.text_of(row.memory_mb, ".0f"),
}


def summary_rows(own: Group) -> list[study.Row]:
    """By panel size and rung, all that is given together."""
    shapes = study.grouped(own, lambda one: one.shape).values()
    rungs = (study.grouped(here, lambda one: one.formulation).values() for here in shapes)
    return [row for groups in rungs for row in study.rows_of(groups, FIGURES)]


def method_rows(found: Group) -> list[study.Row]:
    """By method, panel size and rung, all recordings together; the file's first method first."""
    return [row for own in study.grouped(found, lambda one: one.method).values() for row in summary_rows(own)]


def all_rows(found: Group) -> list[study.Row]:
    """Summaries, then methods, then each rung with each method on each recording."""
    return [*summary_rows(found), *method_rows(found), *study.rows_of(([one] for one in found), FIGURES)]


def on_front(rows: Sequence[study.Row]) -> list[str]:
    """Rungs of one size that no other beats, in time together with cell error, or in time together with the gap."""
    kept = set(front([(row.frame_ms, row.gap) for row in rows]))
    errors = [(row.frame_ms, float("inf") if row.changed_error is None else row.changed_error) for row in rows]
    return [rows[index].formulation for index in sorted(kept | set(front(errors)))]


def tradeoff_table(found: Group) -> Table:
    """The first method's rows, those on a front marked."""
    rows = summary_rows([one for one in found if one.method == found[0].method])
    fronts = {shape: on_front(own) for shape, own in study.grouped(rows, lambda row: (row.rows, row.columns)).items()}
    marked = {"front": lambda row: "*" * (row.formulation in fronts[row.rows, row.columns])}
    return study.screen_table(rows, SCREEN | marked)


SAMPLES = {
    "wall": "wall time of the estimate",
    "cpu": "processor time from the frame before to this one",
    "objective": "cost with the reference's previous frame",
    "gap": "objective above the best of all rungs, against it and the noise",
}
ERRORS = (
    ("cell_error", "percent", "median error of the cells against the truth"),
    ("changed_error", "percent", "median error of the cells that have changed"),
)


def _write_samples(entry: Any, found: Group) -> None:
    """/entry/<recording>/<method>/<formulation>: times, errors, objectives and gaps of every frame; and memory."""
    for one in found:
        recording = entry.require_group(one.subject.recording.name)
        rows, columns = one.shape
        hdf5.set_attributes(recording, NX_class="NXsubentry", rows=rows, columns=columns)
        hdf5.set_attributes(recording, scene=one.subject.scene, noise=one.subject.noise)
        method = recording.require_group(one.method)
        hdf5.set_attributes(method, NX_class="NXcollection")
        group = method.create_group(one.formulation.replace(" ", "_"))
        one.write(group, SAMPLES, "frame in sequence", formulation=one.formulation, baseline_s=one.baseline_s)
        study.write_columns(group, one, ERRORS, ("frame",))
        if one.memory_mb is not None:
            hdf5.set_attributes(group, peak_memory_mb=one.memory_mb)


STUDY: study.Study[Plan, Group] = study.Study(
    "tradeoff",
    "measurements",
    "tradeoff.yaml",
    read_plan,
    run_tradeoff,
    FIGURES,
    all_rows,
    lambda found: [("", tradeoff_table(found))],
    "tradeoff/1",
    _write_samples,
    lambda found: {"tradeoff": tradeoff_figure(method_rows(found))},
)
