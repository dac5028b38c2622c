"""Trade-off between accuracy and speed: all formulations solve every recording in turn, A B C A B C.

Time and cell error are those of the formulation's own sequence. Objectives of relative methods depend on the previous
estimate. Therefore each estimate is evaluated with the same cost, given the previous frame of the reference, `reduced`,
and compared with the lowest value of all formulations. A joint first pair is evaluated by its second frame, given the
reference's baseline.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Literal, NamedTuple

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import AnyMethod, MethodName, named_method
from lampest.estimate.methods.approximate import TruncatedMethod
from lampest.estimate.methods.method import Method
from lampest.estimate.sequence import first_stream, reconstruct
from lampest.files.errors import InputError
from lampest.files.typed import Configuration, check_not_negative, check_positive_fields, check_ranges
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.recording.stored import only_frames
from lampest.report.compare import relative_error
from lampest.runs.case import check_name
from lampest.runs.config import recording_paths
from lampest.solvers.solution import Settings
from lampest.studies import common
from lampest.studies.common import TimedFrame, outcome, peak_memory
from lampest.studies.study import OnStep, column, read_settings

REFERENCE = "reduced"
Passage = tuple[Estimates, Array]  # estimates of a recording, and the processor time of each frame, s


@dataclass(frozen=True)
class TradeoffLimits(Configuration):
    """Largest side, max(rows, columns), of panels for each formulation; 0: none. `reduced` is always measured.

    joint : largest side for methods that compare frames, whose joint first pair takes minutes on larger panels.
    """

    naive: int = common.MAX_SIDE
    scaled: int = common.MAX_SIDE
    linearised: int = common.MAX_SIDE
    truncated: int = common.MAX_SIDE
    nodal: int = 16
    per_pixel: int = 10
    joint: int = 16


@dataclass(frozen=True)
class Simulated(Configuration):
    """Simulated recordings of a lamprey on panels of 10 mm pitch, for every size, noise and scene.

    Attributes
    ----------
    sizes
        Sides of square panels, or [rows, columns].
    noise
        Readouts by name.
    scenes
        Unmodelled effects by name.
    diameter_mm
        Diameter of the mouth.
    """

    sizes: common.Sizes
    noise: dict[str, TwoPointReadout] = field(default_factory=lambda: {"10bit": TwoPointReadout()})
    scenes: dict[str, Unmodelled] = field(default_factory=lambda: {"clean": Unmodelled()})
    diameter_mm: float = 35.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.sizes or not self.noise or not self.scenes:
            raise ValueError("sizes, noise and scenes must hold at least one")
        common.check_sides(common.shapes_of(self.sizes), 8, common.MAX_SIDE)
        for name in (*self.noise, *self.scenes):
            check_name(name, "noise or scene")
        check_positive_fields(self, "diameter_mm")
        check_ranges(self, 0, 2**64 - 1, "seed")

    def recordings(self, frames: int) -> Iterator[Recording]:
        """Yield recordings <panel>_<scene>_<noise> in order of size, with three unloaded and some measured frames."""
        lamprey = common.shipped_lamprey()
        for rows, columns in common.shapes_of(self.sizes):
            mouth = common.lamprey_mouth((10 * (columns // 2) - 6, 10 * (rows // 2) - 4), self.diameter_mm)
            known: dict[str, Any] = {"frames": frames, "loads": (mouth,), "course": lamprey.course}
            for noise, readout in self.noise.items():
                place = Scene(Panel(rows, columns), readout, lamprey.scene.series_resistance_ohm)
                for scene, unmodelled in self.scenes.items():
                    simulation = Simulation(1, self.seed, place, unmodelled=unmodelled, **known)
                    yield replace(simulate(simulation, f"{rows}x{columns}"), name=f"{rows}x{columns}_{scene}_{noise}")


@dataclass(frozen=True)
class TradeoffFile(Configuration):
    """Settings of a trade-off. Raises ValueError for missing entries and numbers out of range.

    Attributes
    ----------
    recordings
        Files, relative to this one.
    simulated
        Simulated recordings.
    estimators
        Methods by name; by default the five of the paper.
    formulations
        Formulations, by default all. They must include `reduced`, the reference.
    frames
        Maximal number of measured frames of each recording.
    repeats, patience_s
        Number of passes of every formulation through a recording; none begins after `patience_s`.
    memory
        Method for the measurement of peak memory, if any.
    solver
        Tolerance and iterations of all solvers.
    limits
        Largest side for each formulation.
    """

    schema: Literal[1]
    recordings: tuple[str, ...] = ()
    simulated: Simulated | None = None
    estimators: dict[str, common.BoundedMethod] = field(
        default_factory=lambda: common.paper_methods(common.BoundedMethod)
    )
    formulations: tuple[MethodName | AnyMethod, ...] = (
        "naive",
        "scaled",
        "linearised",
        *(TruncatedMethod(steps=steps) for steps in (1, 2, 4)),
        "reduced",
        "nodal",
        "per_pixel",
    )
    frames: int = 5
    repeats: int = 3
    patience_s: float = 3.0
    memory: str | None = None
    solver: Settings = Settings()
    limits: TradeoffLimits = TradeoffLimits()

    def __post_init__(self) -> None:
        if not self.recordings and self.simulated is None:
            raise ValueError("name recordings, or say what is simulated")
        if not self.estimators:
            raise ValueError("estimators must hold at least one")
        for name in self.estimators:
            check_name(name, "estimator")
        labels = [label(formulation) for formulation in self.ladder]
        if REFERENCE not in labels:
            raise ValueError(f"formulations must hold {REFERENCE}, which the others are compared with")
        if len(set(labels)) < len(labels):
            raise ValueError("formulations names a rung twice")
        check_ranges(self, 2, 1000, "frames")
        check_ranges(self, 1, 1000, "repeats")
        check_not_negative(self, "patience_s")
        if self.memory is not None and self.memory not in self.estimators:
            raise ValueError(f"memory: {self.memory} is none of the estimators")

    @property
    def ladder(self) -> tuple[Method, ...]:
        """Formulations as methods."""
        return tuple(named_method(formulation) for formulation in self.formulations)

    def rungs(self, shape: common.Shape) -> dict[str, Method]:
        """Return the formulations that are measured on a panel, by label."""
        allowed = (rung for rung in self.ladder if max(shape) <= getattr(self.limits, rung.kind, common.MAX_SIDE))
        return {label(rung): rung for rung in allowed}

    def methods(self, shape: common.Shape) -> list[str]:
        """Return the methods that are measured on a panel."""
        compared = {
            name for name, method in self.estimators.items() if any(term.needs_previous for term in method.parts)
        }
        return [name for name in self.estimators if max(shape) <= self.limits.joint or name not in compared]

    def estimator(self, method: str, formulation: Method) -> Estimator:
        """Return a method in a formulation."""
        chosen = self.estimators[method]
        return Estimator(chosen.parts, formulation, self.solver, chosen.bounds)


class Plan(NamedTuple):
    """Settings of a trade-off with its recordings, cut to their first frames."""

    settings: TradeoffFile
    recordings: list[Recording]


def label(formulation: Method) -> str:
    """Return the name of a formulation in tables and figures, with its number of steps if it has one."""
    return f"{formulation.kind} {formulation.steps}" if isinstance(formulation, TruncatedMethod) else formulation.kind


def read_plan(path: Path, assigned: tuple[str, ...] = ()) -> Plan:
    """Read the settings of a trade-off and its recordings. Raises InputError with line and column."""
    settings = read_settings(TradeoffFile)(path, assigned)
    files = recording_paths(path, list(settings.recordings))
    recordings = [first_frames(Recording.load(file), settings.frames) for file in files]
    if settings.simulated is not None:
        try:
            recordings += settings.simulated.recordings(settings.frames)
        except ValueError as error:
            raise InputError(f"{path}: simulated: {error}") from error
    names = [recording.name for recording in recordings]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{path}: two recordings are called {twice[0]}")
    return Plan(settings, recordings)


def first_frames(recording: Recording, count: int) -> Recording:
    """Return the unloaded and the first measured frames. Raises InputError with fewer than two measured ones."""
    measured = recording.measured_frames()[:count]
    if len(measured) < 2:
        raise InputError(f"{recording.name}: a trade-off needs at least two measured frames")
    chosen = recording.role == UNLOADED
    chosen[measured] = True
    return replace(only_frames(replace(recording, number=np.arange(len(chosen))), chosen), number=None)


@dataclass(frozen=True, kw_only=True)
class TradeoffFrame(TimedFrame):
    """A frame of a method and a formulation.

    objective : cost as in the module's docstring; NaN of a failed frame. gap : (φ − φ_best)/(φ_best + φ_noise), where
    φ_noise is the cost of residuals of one standard deviation; a gap far below 1 is invisible in the readings.
    """

    baseline_s: float = column("s", "time of the unloaded baseline; 0 where it is solved with the first frame")
    cell_error: float = column("percent", "median error of the cells against the truth")
    changed_error: float = column("percent", "the same of cells that the load has changed by more than 5 percent")


def run_tradeoff(plan: Plan, on_step: OnStep = lambda done, total: None) -> list[TradeoffFrame]:
    """Measure everything; on_step : receives the numbers of finished and of all parts."""
    settings, done = plan.settings, count(1)
    first = {recording.scene.panel.shape: recording for recording in reversed(plan.recordings)}
    fresh = [(shape, name) for shape in first if settings.memory for name in settings.rungs(shape)]
    methods = {shape: settings.methods(shape) for shape in first}
    chosen = [(record, method) for record in plan.recordings for method in methods[record.scene.panel.shape]]
    measured: list[TradeoffFrame] = []
    for recording, method in chosen:
        measured += _measure(settings, recording, method)
        on_step(next(done), len(chosen) + len(fresh))
    memory = {}
    for shape, name in fresh:
        estimator = settings.estimator(str(settings.memory), settings.rungs(shape)[name])
        memory[shape, name] = peak_memory(_passage, (estimator, first_frames(first[shape], 2)))
        on_step(next(done), len(chosen) + len(fresh))
    return [replace(frame, memory_mb=memory.get((frame.shape, frame.solver))) for frame in measured]


def _passage(task: tuple[Estimator, Recording]) -> Passage:
    """Solve the frames of a recording in sequence."""
    (estimator, recording), clock = task, [process_time()]
    estimates = reconstruct(recording, estimator, lambda *_: clock.append(process_time()))
    return estimates, np.diff(clock)


def _measure(settings: TradeoffFile, recording: Recording, method: str) -> Iterator[TradeoffFrame]:
    """Measure all formulations with a method on a recording."""
    rungs, begin = settings.rungs(recording.scene.panel.shape), perf_counter()
    runs: dict[str, list[Passage]] = {name: [] for name in rungs}
    for turn in range(settings.repeats):
        if turn and perf_counter() - begin > settings.patience_s:
            break
        for name, formulation in rungs.items():
            runs[name].append(_passage((settings.estimator(method, formulation), recording)))
    costs = list(_costs(runs[REFERENCE][0][0]))
    objective = {
        name: [_objective(*cost, cells) for cost, cells in zip(costs, run[0][0].cell_resistance, strict=True)]
        for name, run in runs.items()
    }
    least = np.nanmin(list(objective.values()), axis=0)
    # (φ − φ_best)/(φ_best + φ_noise)
    gaps = {name: (own - least) / (least + [_noise_cost(*cost) for cost in costs]) for name, own in objective.items()}
    for name, run in runs.items():
        first = run[0][0]
        turns = [np.minimum([step.seconds for step in estimates.steps], cpu) for estimates, cpu in run]
        seconds = np.min(turns, axis=0)
        for number, (step, cell, changed) in enumerate(zip(first.steps, *errors(first), strict=True)):
            yield TradeoffFrame(
                **outcome(recording, step),
                method=method,
                solver=name,
                frame=number,
                seconds=float(seconds[number]),
                objective=objective[name][number],
                gap=float(gaps[name][number]),
                baseline_s=0.0 if first.joint_start else min(estimates.baseline.seconds for estimates, _ in run),
                cell_error=float(cell),
                changed_error=float(changed),
            )


def errors(estimates: Estimates) -> tuple[Array, Array]:
    """Return median errors of all cells and of changed ones in percent, shape (frames,); NaN if unknown."""
    recording, frames = estimates.recording, len(estimates.frame)
    truth = recording.truth_cell_resistance
    if truth is None:
        return np.full(frames, np.nan), np.full(frames, np.nan)
    # changed cells: by more than 5 % from the median of the true unloaded cells
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    resting = np.median(truth[unloaded], axis=0) if len(unloaded) else truth[0]
    error = relative_error(estimates.cell_resistance, truth[estimates.frame])
    changed = np.abs(truth[estimates.frame] / resting - 1) > 0.05  # as `TradeoffFrame.changed_error` says
    inside = [np.median(part[which]) if which.any() else np.nan for part, which in zip(error, changed, strict=True)]
    return np.median(error, axis=(1, 2)), np.array(inside)


def _costs(reference: Estimates) -> Iterator[tuple[Cost, Data]]:
    """Yield cost and data of every frame, with the reference's estimate of the previous frame."""
    recording, estimator = reference.recording, reference.estimator
    readings = recording.readings()
    stream = replace(first_stream(recording, readings, estimator), baseline=reference.baseline)
    before = np.concatenate([reference.baseline_resistance[None], reference.cell_resistance[:-1]])
    for frame, previous in zip(reference.frame, before, strict=True):
        data, _ = replace(stream, previous=previous).given(readings[frame])
        yield estimator.cost(recording.scene, len(data.measured), partial=data.partial), data


def _objective(cost: Cost, data: Data, cells: Array) -> float:
    if not np.all(np.isfinite(cells)):
        return float("nan")
    # A formulation with other data, the joint pair, may exceed the bounds by rounding, and must not gain by that.
    return Evaluation.at(cost, data, np.clip(cells, data.lower[0], data.upper[0])[None]).objective


def _noise_cost(cost: Cost, data: Data) -> float:
    """Return the misfit terms for residuals of one standard deviation."""
    costs = Evaluation(cost, data, data.apparent_resistance, data.measured + data.sigma, ()).costs
    return float(sum(value for term, value in zip(cost.terms, costs, strict=True) if term.reads_measurement))
