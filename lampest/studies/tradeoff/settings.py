"""A trade-off's YAML file: which rungs of the ladder are measured with which methods on which recordings."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, cast

import numpy as np

from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import AnyMethod, Method, MethodName, named_method
from lampest.estimate.methods.approximate import TruncatedMethod
from lampest.files.document import read_document, validated
from lampest.files.errors import InputError
from lampest.files.typed import Configuration, check_range
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.recording.stored import only_frames
from lampest.runs.case import check_name
from lampest.runs.config import recording_paths
from lampest.solvers.solution import Settings
from lampest.studies.methods import (
    BREATHING,
    LARGEST_SIDE,
    BoundedMethod,
    Shape,
    Sizes,
    check_sides,
    lamprey_mouth,
    paper_methods,
    shapes_of,
)

REFERENCE = "reduced"
LADDER: tuple[MethodName | AnyMethod, ...] = (
    "naive",
    "scaled",
    "linearised",
    TruncatedMethod(steps=1),
    TruncatedMethod(steps=2),
    TruncatedMethod(steps=4),
    "region",
    "reduced",
    "nodal",
    "per_pixel",
)


@dataclass(frozen=True)
class TradeoffLimits(Configuration):
    """The largest side, max(rows, columns), on which a rung is measured; 0: not at all. `reduced` always is.

    joint : no rung, but the methods that compare frames; on larger panels their joint first pair takes minutes.
    """

    naive: int = LARGEST_SIDE
    scaled: int = LARGEST_SIDE
    linearised: int = LARGEST_SIDE
    truncated: int = LARGEST_SIDE
    region: int = LARGEST_SIDE
    nodal: int = 16
    per_pixel: int = 10
    joint: int = 16

    def allow(self, formulation: Method, shape: Shape) -> bool:
        """Whether a rung runs on a panel."""
        return max(shape) <= getattr(self, formulation.kind, LARGEST_SIDE)


@dataclass(frozen=True)
class Simulated(Configuration):
    """Recordings of one lamprey of a fixed size on panels of 10 mm pitch, for every size, noise and scene.

    Parameters
    ----------
    sizes : sides of square panels, or [rows, columns].
    noise : readouts by name. scenes : unmodelled effects by name.
    diameter_mm : of the mouth. seed : of all random numbers.

    Raises ValueError where a number is out of range.
    """

    sizes: Sizes
    noise: dict[str, TwoPointReadout] = field(default_factory=lambda: {"10bit": TwoPointReadout()})
    scenes: dict[str, Unmodelled] = field(default_factory=lambda: {"clean": Unmodelled()})
    diameter_mm: float = 35.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.sizes or not self.noise or not self.scenes:
            raise ValueError("sizes, noise and scenes must hold at least one")
        check_sides(self.shapes, 8, LARGEST_SIDE)
        for name in (*self.noise, *self.scenes):
            check_name(name, "noise or scene")
        if not 0 < self.diameter_mm < float("inf"):
            raise ValueError("diameter_mm must be positive and finite")
        if not 0 <= self.seed < 2**64:
            raise ValueError("seed must lie between 0 and 2^64")

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """(rows, columns) of every panel."""
        return shapes_of(self.sizes)

    def subjects(self, frames: int) -> Iterator["TradeoffSubject"]:
        """Every combination, in order of size; frames measured frames after three unloaded ones."""
        for shape in self.shapes:
            for noise, readout in self.noise.items():
                for scene, unmodelled in self.scenes.items():
                    recording = self._recording(shape, readout, unmodelled, frames)
                    yield TradeoffSubject(replace(recording, name=f"{recording.name}_{scene}_{noise}"), scene, noise)

    def _recording(self, shape: Shape, readout: TwoPointReadout, unmodelled: Unmodelled, frames: int) -> Recording:
        rows, columns = shape
        mouth = lamprey_mouth((10 * (columns // 2) - 6, 10 * (rows // 2) - 4), self.diameter_mm)
        scene = Scene(Panel(rows, columns), readout, 140)
        simulation = Simulation(
            1, self.seed, scene, frames=frames, loads=(mouth,), course=BREATHING, unmodelled=unmodelled
        )
        return simulate(simulation, f"{rows}x{columns}")


@dataclass(frozen=True, eq=False)
class TradeoffSubject:
    """A recording that is measured; scene and noise are '-' for one from a file."""

    recording: Recording
    scene: str
    noise: str

    @property
    def shape(self) -> Shape:
        """(rows, columns)."""
        return self.recording.scene.panel.shape


@dataclass(frozen=True)
class TradeoffFile(Configuration):
    """What is measured.

    Parameters
    ----------
    recordings : files, relative to this one. simulated : recordings made for the purpose.
    estimators : methods by name; the paper's five by default.
    formulations : the rungs; all by default. `reduced` must be among them: it is what others are compared with.
    frames : of each recording at most so many measured frames, in sequence, from the first.
    repeats, patience_s : how often every rung runs through a recording; no further time once that has taken so long.
    memory : the method with which the peak memory of a fresh process is measured; None: it is not.
    solver : tolerance and iterations, the same for all.
    limits : the largest side for each rung.

    Raises ValueError where something is missing or a number is out of range.
    """

    schema: Literal[1]
    recordings: tuple[str, ...] = ()
    simulated: Simulated | None = None
    estimators: dict[str, BoundedMethod] = field(default_factory=lambda: paper_methods(BoundedMethod))
    formulations: tuple[MethodName | AnyMethod, ...] = LADDER
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
        check_range("frames", self.frames, 2, 1000)
        check_range("repeats", self.repeats, 1, 1000)
        if not 0 <= self.patience_s < float("inf"):
            raise ValueError("patience_s must be zero or positive, and finite")
        if self.memory is not None and self.memory not in self.estimators:
            raise ValueError(f"memory: {self.memory} is none of the estimators")

    @property
    def ladder(self) -> tuple[Method, ...]:
        """The formulations; words as what they stand for."""
        return tuple(named_method(formulation) for formulation in self.formulations)

    def rungs(self, shape: Shape) -> dict[str, Method]:
        """The rungs that are measured on a panel, by label."""
        return {label(formulation): formulation for formulation in self.ladder if self.limits.allow(formulation, shape)}

    def methods(self, shape: Shape) -> tuple[str, ...]:
        """The methods that are measured on a panel."""
        small = max(shape) <= self.limits.joint
        chosen = self.estimators.items()
        return tuple(name for name, method in chosen if small or not any(term.needs_previous for term in method.parts))

    def estimator(self, method: str, formulation: Method) -> Estimator:
        """A method in a formulation."""
        chosen = self.estimators[method]
        return Estimator(chosen.parts, formulation, self.solver, chosen.bounds)


@dataclass(frozen=True, eq=False)
class Plan:
    """A trade-off's file with its recordings at hand, cut to their first frames."""

    settings: TradeoffFile
    subjects: tuple[TradeoffSubject, ...]


def label(formulation: Method) -> str:
    """The rung's name in tables and figures: its word, with the number of steps where there is one."""
    return f"{formulation.kind} {formulation.steps}" if isinstance(formulation, TruncatedMethod) else formulation.kind


def read_plan(path: Path, assigned: tuple[str, ...] = ()) -> Plan:
    """A trade-off's file and its recordings. Raises InputError, with line and column where the file is at fault."""
    settings = cast(TradeoffFile, validated(read_document(path, assigned), TradeoffFile))
    subjects = []
    for file in recording_paths(path, list(settings.recordings)):
        recording = Recording.load(file)
        subjects.append(TradeoffSubject(first_frames(recording, settings.frames), "-", "-"))
    if settings.simulated is not None:
        try:
            subjects += settings.simulated.subjects(settings.frames)
        except ValueError as error:
            raise InputError(f"{path}: simulated: {error}") from error
    names = [subject.recording.name for subject in subjects]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: two recordings are called {name}")
    return Plan(settings, tuple(subjects))


def first_frames(recording: Recording, count: int) -> Recording:
    """The unloaded frames and the first measured ones. Raises InputError where fewer than two are measured."""
    measured = recording.measured_frames()[:count]
    if len(measured) < 2:
        raise InputError(f"{recording.name}: a trade-off needs at least two measured frames")
    chosen = recording.role == UNLOADED
    chosen[measured] = True
    return replace(only_frames(replace(recording, number=np.arange(len(chosen))), chosen), number=None)
