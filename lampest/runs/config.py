"""Run files (YAML): cases of every recording with every estimator at every point of the sweep."""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from lampest.cost.given import Background
from lampest.cost.terms import AnyTerm, term_types
from lampest.estimate.estimator import Estimator, Tare, Verify
from lampest.estimate.methods import AnyMethod, MethodName
from lampest.estimate.sequence import check_by_parts, segment_count
from lampest.estimate.weights import AutoWeight
from lampest.files import sweep
from lampest.files.document import (
    Document,
    adapter,
    entry_at,
    plain_content,
    read_document,
    to_yaml,
    validated,
)
from lampest.files.errors import InputError, meant
from lampest.files.typed import kinds_of, shipped, typed
from lampest.files.whole import note_read
from lampest.formulation.constraints import AnyPart, part_types
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.recording.stored import StoredRecording, opened
from lampest.runs.case import check_name
from lampest.runs.executors import AnyExecutor, Executor
from lampest.runs.provenance import digest
from lampest.runs.results import PublishedFigures
from lampest.solvers.posed import Bounds
from lampest.solvers.solution import Settings

Checks = Literal["all", "none"]  # of which recordings the circuit is checked
FORBID: dict[str, Any] = {"extra": "forbid"}
# Of a processor, for a later frame with error bars: 18 to 23 ms at 10 × 10 (docs/studies/bench.md).
SECONDS_A_CELL = 2e-4
ABSOLUTE_FACTOR = 5.0  # times as long where a loss is not squared
MIN_DIVIDED_SECONDS = 2.0  # processes start within half of it, so that two of them end earlier


def by_kind_class(name: str, kinds: Mapping[str, type], *bases: type) -> type:
    """Return a dataclass with a field for every kind of a registered class, None by default."""
    summary = f"The {name.lower()} of an estimator, by kind."
    space = {"__pydantic_config__": FORBID, "__module__": __name__, "__doc__": summary}
    members = [(kind, member | None, field(default=None)) for kind, member in kinds.items()]
    return make_dataclass(name, members, bases=bases, frozen=True, namespace=space)


def _extended(known: Callable[[], Mapping[str, type]]) -> type:
    """Return a base class whose validation also accepts kinds of installed packages."""

    class WithInstalled:
        @classmethod
        def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
            """Return the schema of a class with fields for these kinds; called by pydantic."""
            shipped_kinds = source.__dataclass_fields__
            further = {kind: each for kind, each in known().items() if kind not in shipped_kinds}
            if not further:
                return handler(source)
            return handler.generate_schema(by_kind_class(source.__name__, further, source))

    return WithInstalled


def _shipped_kinds(union: Any) -> dict[str, type]:
    return {kind: member for member in shipped(union) for kind in kinds_of(member)}


Terms = by_kind_class("Terms", _shipped_kinds(AnyTerm), _extended(term_types))
Constraints = by_kind_class("Constraints", _shipped_kinds(AnyPart), _extended(part_types))


def named_members(chosen: Any, kinds: Iterable[str]) -> tuple[Any, ...]:
    """Return the objects that a run file names, in the order of their kinds."""
    return tuple(member for kind in kinds if (member := getattr(chosen, kind, None)) is not None)


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Options of a run file for all estimators, or of an estimator.

    Solver and bounds of an estimator override single keys of those for all.
    """

    __pydantic_config__: ClassVar[Any] = FORBID
    formulation: MethodName | AnyMethod = "auto"
    solver: Settings = Settings()
    bounds: Bounds = Bounds()
    error_bars: Literal["auto"] | bool = "auto"
    auto_weight: AutoWeight = AutoWeight()
    tare: Tare | None = None
    verify: Verify = Verify("strongest")


@dataclass(frozen=True, kw_only=True)
class EstimatorEntry(Choices):
    """An estimator in a run file."""

    terms: Terms  # type: ignore[valid-type]
    constraints: Constraints | None = None  # type: ignore[valid-type]


@dataclass(frozen=True, kw_only=True)
class RunFile(Choices):
    """Content of a run file. Raises ValueError for missing recordings or estimators."""

    schema: Literal[1]
    recordings: list[str]
    estimators: dict[str, EstimatorEntry]
    executor: AnyExecutor | None = None
    check: Checks = "all"
    published: dict[str, PublishedFigures] | None = None
    sweep: dict[str, list[Any]] | None = None

    def __post_init__(self) -> None:
        if not self.recordings:
            raise ValueError("recordings must name at least one file")
        if not self.estimators:
            raise ValueError("estimators must hold at least one")


@dataclass(frozen=True)
class Case:
    """One recording with one estimator, at one point of a sweep.

    Attributes
    ----------
    path, sha256, recording
        File of the recording, its digest and its name.
    name : str
        Name of the estimator with the swept values, such as ``smooth@gradient.weight=0.001``.
    estimator : Estimator
    resolved : str
        All entries that determine the result, as YAML text.
    case_id : str
        Hash of `resolved`.
    stored : StoredRecording or None
        The recording, if it is too long for memory and solved part by part.
    swept : dict
        Key → value that the sweep set for this case.
    frames : int
        Number of frames that are solved; 0 for a recording that cannot be read.
    cells : int
        Number of cells of a frame.
    """

    path: Path
    sha256: str
    recording: str
    name: str
    estimator: Estimator
    resolved: str
    case_id: str
    stored: StoredRecording | None = None
    swept: Mapping[str, Any] = field(default_factory=dict)
    frames: int = 0
    cells: int = 0

    @property
    def frame_seconds(self) -> float:
        """Approximate processor time of a frame, s."""
        squared = all(term.loss.squared for term in self.estimator.terms)
        return self.cells * SECONDS_A_CELL * (1.0 if squared else ABSOLUTE_FACTOR)

    @property
    def seconds(self) -> float:
        """Approximate processor time of all frames, s."""
        return self.frames * self.frame_seconds

    @property
    def segments(self) -> int:
        """Number of segments that may be solved in any order, each worth a task of its own."""
        estimator = self.estimator
        whole = self.stored is not None or estimator.method.needs_all_frames
        if whole or self.seconds < MIN_DIVIDED_SECONDS or estimator.uses_previous:
            return 1
        return segment_count(self.frames)


@dataclass(frozen=True)
class Run:
    """Content of a run file.

    Attributes
    ----------
    cases : tuple of Case
        Cases in the order of the file.
    published : dict
        Estimator → published figures.
    executor : Executor or None
        Executor, if the file names one.
    assumed : tuple of (str, str)
        Recordings and the values that are assumed for missing entries of their scenes.
    check : str
        Of which recordings the circuit is checked: 'all' or 'none'.
    """

    cases: tuple[Case, ...]
    published: dict[str, PublishedFigures]
    executor: Executor | None = None
    assumed: tuple[tuple[str, str], ...] = ()
    check: Checks = "all"

    @property
    def tasks(self) -> int:
        """Number of tasks; at most 1 where all end before further processes have started."""
        if sum(case.seconds for case in self.cases) < MIN_DIVIDED_SECONDS:
            return min(len(self.cases), 1)
        return sum(case.segments for case in self.cases)


# Key → why no sweep varies it.
UNSWEPT = {
    "executor": "where cases run changes no result, so it cannot be swept",
    "check": "a recording is checked once, so it cannot be swept",
}


@typed
def read_run(path: str | Path, settings: tuple[str, ...] = ()) -> Run:
    """Read the cases of a run file with `PATH=VALUE` settings applied.

    Raises InputError for any fault before the first solve. An unreadable recording among several is
    no fault here: its cases fail later, without effect on the others.

    >>> from pathlib import Path
    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> recording.save("mine.h5")
    >>> estimators = "{LSM: {terms: {misfit: {}}}}"
    >>> text = f"{{schema: 1, recordings: [mine.h5], estimators: {estimators}}}"
    >>> _ = Path("run.yaml").write_text(text)
    >>> len(lampest.read_run("run.yaml").cases)
    1
    """
    path = Path(path)
    document = read_document(path, settings)
    _refuse_unknown(path, document, settings)
    recordings: dict[Path, _Source] = {}
    cases = []
    published: dict[str, PublishedFigures] = {}
    points = sweep.combinations(
        document, lambda varied: validated(varied, RunFile), "estimators", UNSWEPT
    )
    executor = points[0].value.executor and points[0].value.executor.beside(path.parent)
    for point in points:
        run: RunFile = point.value
        published |= run.published or {}
        prefix = f"estimators.{point.entry}."  # swept keys without the estimator: gradient.weight
        swept = {
            key.removeprefix(prefix).removeprefix("terms."): value
            for key, value in point.assignments.items()
        }
        # The name has the swept values: LSR-gCR@gradient.weight=0.001
        texts = (value if isinstance(value, str) else json.dumps(value) for value in swept.values())
        parts = (f"{key}={text}".replace("/", "|") for key, text in zip(swept, texts, strict=True))
        name = "@".join(filter(None, (point.entry, ",".join(parts))))
        estimator = resolve(point.document, run, point.entry)
        for file in recording_paths(path, run.recordings):
            source = recordings[file] = recordings.get(file) or _Source.read(file)
            source.check(f"{path}: {name} × {file.stem}", estimator)
            cases.append(source.case(name, estimator, swept))
    faults = [source.fault for source in recordings.values()]
    if faults[0] is not None and all(faults):
        raise faults[0]
    # Recordings in order, their estimators together, each case once.
    order = {case.recording: None for case in cases}
    unique = {case.case_id: case for case in cases}.values()
    distinct = tuple(case for name in order for case in unique if case.recording == name)
    assumed = tuple(
        (file.stem, source.scene.assumed_text)
        for file, source in recordings.items()
        if source.scene is not None and source.scene.assumed_text
    )
    return Run(distinct, published, executor, assumed, run.check)


def _refuse_unknown(path: Path, document: Document, settings: tuple[str, ...]) -> None:
    """Raise InputError where a setting reaches into an estimator that the file does not hold."""
    estimators = entry_at(read_document(path).content, ("estimators",))
    if not isinstance(estimators, dict):
        return
    for key in (setting.partition("=")[0] for setting in settings):
        room, *inner = key.split(".")
        if room == "estimators" and len(inner) > 1 and inner[0] not in estimators:
            listed = meant(inner[0], estimators) or f"; there are {', '.join(estimators)}"
            raise document.error((), f"{key}: there is no estimator {inner[0]!r}{listed}")


@dataclass(frozen=True, eq=False)
class _Source:
    """A recording of a run.

    Attributes
    ----------
    path, sha256 : Path, str
    scene, readings
        None if the file is unreadable.
    fault : InputError or None
        Why it is unreadable.
    frames : int
        Number of measured frames.
    stored : StoredRecording or None
        The recording, if it exceeds the memory; `readings` are then its first ones.
    """

    path: Path
    sha256: str
    scene: Scene | None = None
    readings: Readings | None = None
    fault: InputError | None = None
    frames: int = 0
    stored: StoredRecording | None = None

    @classmethod
    def read(cls, path: Path) -> "_Source":
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        names = path.absolute(), digest(path)
        try:
            recording = opened(path)
            if isinstance(recording, StoredRecording):
                readings = recording.part(recording.blocks[0]).readings()
                frames = recording.frames
                return cls(*names, recording.scene, readings, None, frames, recording)
            frames = len(recording.measured_frames())
        except InputError as error:
            return cls(*names, fault=error)
        return cls(*names, recording.scene, recording.readings(), None, frames)

    def check(self, case: str, estimator: Estimator) -> None:
        """Raise InputError if an estimator does not fit the recording."""
        if self.scene is None or self.readings is None:
            return
        try:
            estimator.check(self.scene)
            if self.stored is not None:
                check_by_parts(estimator, self.stored)
        except InputError as error:
            raise InputError(f"{case}: {error}") from error
        estimator.data(self.readings, Background(self.scene))

    def case(self, name: str, estimator: Estimator, swept: Mapping[str, Any]) -> Case:
        """Return the case of an estimator of that name."""
        recording = self.path.stem
        content = {"recording": recording, "recording_sha256": self.sha256, "estimator": name}
        resolved = to_yaml(content | {"case_format": 1} | plain_content(estimator))
        names = (self.path, self.sha256, recording, name)
        cells = 0 if self.scene is None else self.scene.panel.crossings
        size = self.stored, swept, self.frames, cells
        return Case(*names, estimator, resolved, hash_of(resolved), *size)


def hash_of(resolved: str) -> str:
    """Return the identifier of a case, a hash of all entries that determine its result."""
    return hashlib.sha256(resolved.encode()).hexdigest()[:24]


def recording_paths(config: Path, patterns: list[str]) -> list[Path]:
    """Return the files that the patterns name, relative to the run file.

    `*` stands for any part of a name.

    Raises InputError if a pattern matches nothing or two files share a stem.
    """
    files: dict[str, Path] = {}
    for pattern in patterns:
        target = config.parent / pattern
        matches = list[Path]()
        with suppress(OSError, ValueError):  # a name that is too long
            # '**' would traverse all folders below.
            several = "*" in target.name and "**" not in pattern
            matches = sorted(target.parent.glob(target.name)) if several else [target]
        if not matches or (len(matches) == 1 and "*" in matches[0].name):
            raise InputError(f"{config}: recordings: no file matches {pattern}")
        for file in matches:
            note_read(file)
            check_name(file.stem, "recording")
            if files.setdefault(file.stem, file) is not file:
                raise InputError(f"{config}: recordings: two files are called {file.stem}")
    return list(files.values())


def resolve(document: Document, run: RunFile, name: str) -> Estimator:
    """Return an estimator, with options of the run as defaults."""
    options = [item.name for item in fields(Choices)]
    shared = {option: document.content[option] for option in options if option in document.content}
    written = document.content["estimators"][name]
    merged = shared | written
    for part in ("solver", "bounds"):
        merged[part] = shared.get(part, {}) | written.get(part, {})
    try:
        entry = adapter(EstimatorEntry).validate_json(json.dumps(merged))
    except ValueError as error:
        raise document.error(("estimators", name), "does not fit the run") from error
    try:
        check_name(name, "estimator")
        return Estimator(
            named_members(entry.terms, term_types()),
            constraints=named_members(entry.constraints, part_types()) or None,
            **{option: getattr(entry, option) for option in options},
        )
    except ValueError as error:
        raise document.error(("estimators", name), str(error)) from error


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a run file for editors, without the Python examples."""
    text = json.dumps(adapter(RunFile).json_schema())
    return dict(json.loads(re.sub(r"\\n\\n>>> (?:[^\"\\]|\\.)*", "", text)))
