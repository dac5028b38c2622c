"""A results file → its cases."""

import json
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from math import prod
from pathlib import Path
from typing import Any, Literal, NamedTuple

import h5py
import numpy as np

from lampest.files import hdf5
from lampest.files.document import parse_document, validated
from lampest.files.errors import InputError, meant
from lampest.files.typed import typed
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.frame_noise import FrameNoise
from lampest.runs.case import REQUIRED, SENTENCES, SHARED, CaseResult, StoredCase
from lampest.runs.columns import FIGURES, FRAME, MAPS, MEASURED, Column, all_columns
from lampest.runs.results.writer import FORMAT, PublishedFigures, StepFigures

NONE = slice(0, 0)
# Of the noise that readings of a frame share: numbers, and patterns in volt.
NUMBERS, PATTERNS = ("gain", "unloaded"), ("together", "apart")
NAMES = (*NUMBERS, *PATTERNS)


@dataclass(frozen=True, eq=False)
class Results:
    """The cases of one file in the order they were given, and published figures by estimator.

    >>> lampest.Results((found.result("LSM"),)).estimators()
    ('LSM',)
    """

    cases: tuple[CaseResult, ...]
    published: Mapping[str, PublishedFigures] = field(default_factory=dict)

    def recordings(self) -> tuple[str, ...]:
        """The recordings' names in order, each once."""
        return tuple(dict.fromkeys(case.recording for case in self.cases))

    def of(self, recording: str) -> tuple[CaseResult, ...]:
        """The cases of one recording. Raises InputError where there is none."""
        cases = tuple(case for case in self.cases if case.recording == recording)
        if not cases:
            raise InputError(
                f"no results of a recording '{recording}'; there are {', '.join(self.recordings()) or 'none'}"
            )
        return cases

    def estimators(self) -> tuple[str, ...]:
        """The estimators' names in order, each once."""
        return tuple(dict.fromkeys(case.estimator for case in self.cases))

    def label(self, case: CaseResult) -> str:
        """The estimator's name; of one with published figures and weights of its own `LSR-CR, paper's lambda`."""
        chosen = "weight: auto" in case.case_yaml or not case.weights.keys() - {"misfit"}
        return case.estimator if chosen or case.estimator not in self.published else f"{case.estimator}, paper's lambda"

    def named(self, what: Literal["recording", "estimator"], names: Collection[str]) -> "Results":
        """The results of these recordings or estimators, in the file's order; all where none is named.

        Raises InputError where one is unknown.
        """
        known = list(dict.fromkeys(str(getattr(case, what)) for case in self.cases))
        for name in names:
            if name not in known:
                close = meant(name, known)
                raise InputError(f"no {what} is called {name!r}; there are {', '.join(known)}{close}")
        kept = names or known
        return replace(self, cases=tuple(case for case in self.cases if getattr(case, what) in kept))


@typed
def read_results(path: str | Path, columns: Sequence[Column] = (), frames: range | None = None) -> Results:
    """Read a results file; columns : of what it holds besides those of lampest and of installed packages.

    frames : of the recordings, those that are read; None: all. A recording that has none of them is left out.
    Raises InputError with the dataset's path where something is wrong, or no recording has any of the frames.

    >>> lampest.read_results("results.h5").recordings()
    ('mine',)
    """
    path, table = Path(path), all_columns(columns)
    with _results_file(path) as file:
        published = _read_published(file)
        names = _in_order(file, "/entry")
        parts = {name: hdf5.ALL if frames is None else _part(file, name, frames) for name in names}
        read = [name for name in names if parts[name] != NONE]
        if names and not read:
            raise InputError(f"{path}: holds none of the frames that are asked for")
        cases = [case for name in read for case in _read_recording(file, name, table, parts[name])]
        return Results(tuple(cases), published)


def read_each(path: Path, most: int) -> Iterator[CaseResult]:
    """Every case of a results file, its frames by parts of so many readings. Raises InputError as `read_results`."""
    with _results_file(path) as file:
        _read_published(file)
        for name in _in_order(file, "/entry"):
            frames, rows, columns = (hdf5.length_of(file, f"/entry/{name}/{SHARED}/{axis}") for axis in MAPS)
            step = max(1, most // (rows * columns * max(1, len(hdf5.child_groups(file, f"/entry/{name}")) - 1)))
            for begin in range(0, frames, step):
                yield from _read_recording(file, name, all_columns(), slice(begin, begin + step))


def _part(file: h5py.File, recording: str, frames: range) -> slice:
    """Which of the frames that are kept are these ones of the recording, by bisection; NONE where none is."""
    name = next((name for name in _in_order(file, f"/entry/{recording}") if name != SHARED), "")
    path, length = f"/entry/{recording}/{name}/{FRAME.path}", hdf5.length_of(file, f"/entry/{recording}/{SHARED}/time")

    def number(at: int) -> int:
        return int(hdf5.read_array(file, path, 1, (length,), slice(at, at + 1))[0])

    part = slice(*(bisect_left(range(length), end, key=number) for end in (frames.start, frames.stop)))
    return part if part.start < part.stop else NONE


def stored_cases(path: Path) -> tuple[StoredCase, ...]:
    """The cases of a results file without their values. Raises InputError as `read_results`."""
    found = []
    with _results_file(path) as file:
        for recording in _in_order(file, "/entry"):
            base = f"/entry/{recording}/{SHARED}"
            frames, rows, columns = (hdf5.length_of(file, f"{base}/{axis}") for axis in MAPS)
            for name in _in_order(file, f"/entry/{recording}"):
                if name != SHARED:
                    identity = hdf5.read_attribute(file, f"/entry/{recording}/{name}", "case_id")
                    found.append(StoredCase(path, recording, name, str(identity), frames, rows * columns))
    return tuple(found)


@contextmanager
def _results_file(path: Path) -> Iterator[h5py.File]:
    with hdf5.existing_file(path) as file:
        form = hdf5.read_attribute(file, "/", "lampest_format")
        if not isinstance(form, str) or form != FORMAT:
            raise InputError(f"{file.filename}: no results file (lampest_format is {form!r}, not '{FORMAT}')")
        yield file


class FramesRead(NamedTuple):
    """Axis → how many there are of a recording, and which part of its frames is read."""

    sizes: dict[str, int]
    part: slice


def _in_order(file: h5py.File, path: str) -> list[str]:
    names = hdf5.child_groups(file, path)
    return sorted(names, key=lambda name: (hdf5.read_number(file, f"{path}/{name}", "order", 0), name))


def _read_recording(file: h5py.File, name: str, table: Sequence[Column], part: slice) -> list[CaseResult]:
    base = f"/entry/{name}/{SHARED}"
    scene = _stored_scene(file, base)
    table = [column.of(scene.circuit) for column in table]
    path = f"{base}/{MEASURED.of(scene.circuit).path}"
    hdf5.read_array(file, path, len(MAPS), part=slice(0))  # whether it is what it claims; nothing is read
    shape = hdf5.shape_of(file, path)
    frames = FramesRead(dict(zip(MAPS, shape, strict=True)), part)
    estimators = [child for child in _in_order(file, f"/entry/{name}") if child != SHARED]
    maps = sum(column.axes == MAPS and not column.shared for column in table)
    if len(estimators) * maps * len(range(shape[0])[part]) * prod(shape[1:]) > hdf5.MOST_VALUES:
        raise InputError(
            f"{file.filename}: /entry/{name} claims more than {hdf5.MOST_VALUES} values, which are not read at once; "
            f"of its {shape[0]} frames --frames 0:1000 names some"
        )
    given = _read_columns(file, base, [column for column in table if column.shared], frames)
    return [_read_case(file, (name, child), given, scene, table, frames) for child in estimators]


def _read_case(
    file: h5py.File,
    names: tuple[str, str],
    given: dict[str, Any],
    scene: Scene,
    table: Sequence[Column],
    frames: FramesRead,
) -> CaseResult:
    recording, name = names
    base, start = f"/entry/{recording}/{name}", f"/entry/{recording}/{SHARED}/start_time"
    values = given | _read_columns(file, base, [column for column in table if not column.shared], frames)
    texts = {attribute: hdf5.read_attribute(file, base, attribute) for attribute in hdf5.attribute_names(file, base)}
    try:
        case = CaseResult.of(
            values,
            recording=recording,
            estimator=name,
            scene=scene,
            case_id=str(texts.get("case_id", "")),
            case_yaml=str(texts.get("case", "")),
            versions={key.removesuffix("_version"): str(texts[key]) for key in texts if key.endswith("_version")},
            baseline_status=str(texts.get("baseline_status", "")),
            baseline_solve_time=hdf5.read_number(file, base, "baseline_solve_time_s", float("nan")),
            reading_error=hdf5.read_number(file, base, "reading_error", 0.0),
            frame_noise={name: np.asarray(texts[f"frame_{name}"]) for name in NAMES if f"frame_{name}" in texts},
            **{field: str(texts.get(name, "")) for name, field in SENTENCES.items()},
            start_time=hdf5.read_text(file, start) if hdf5.has(file, start) else "",
            joint_start=bool(hdf5.read_number(file, base, "joint_start")),
            **{folder.name: _read_figures(file, f"{base}/{folder.folder}", frames) for folder in FIGURES},
        )
        case.check(table)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(file.filename) else f"{file.filename}: {error}") from error
    return case


def _read_columns(file: h5py.File, base: str, columns: Sequence[Column], frames: FramesRead) -> dict[str, Any]:
    """Column → values, of those that the file holds or cannot be without."""
    return {
        column.name: column.read(file, base, frames.sizes, frames.part)
        for column in columns
        if column.name in REQUIRED or hdf5.has(file, f"{base}/{column.path}")
    }


def _read_figures(file: h5py.File, path: str, frames: FramesRead) -> dict[str, Array]:
    """name → (frames)."""
    names = hdf5.child_datasets(file, path) if hdf5.has(file, path) else []
    shape = (frames.sizes[MAPS[0]],)
    return {name: hdf5.read_array(file, f"{path}/{name}", 1, shape, frames.part) for name in names}


def _read_published(file: h5py.File) -> dict[str, PublishedFigures]:
    """Figures by estimator from JSON."""
    if "published" not in hdf5.attribute_names(file, "/entry"):
        return {}
    try:
        return {
            str(name): PublishedFigures(
                **{step: StepFigures(**values) for step, values in figures.items() if values is not None}
            )
            for name, figures in json.loads(str(hdf5.read_attribute(file, "/entry", "published"))).items()
        }
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        names = ", ".join(item.name for item in fields(PublishedFigures))
        raise InputError(f"{file.filename}: /entry@published is not figures by estimator and {names}") from error


def _stored_scene(file: h5py.File, base: str) -> Scene:
    """The scene of a recording's group. Raises InputError where it is damaged or impossible."""
    document = parse_document(hdf5.read_text(file, f"{base}/scene"), f"{file.filename}:{base}/scene")
    scene: Scene = validated(document, Scene)
    return scene


def arrays_of(noise: FrameNoise | None) -> dict[str, Array]:
    """Its numbers, and patterns in volt where there are such; nothing of None."""
    found = {} if noise is None else {name: np.array(getattr(noise, name), dtype=float, order="C") for name in NAMES}
    return {name: value for name, value in found.items() if value.size}


def frame_noise_of(arrays: Mapping[str, Array], scene: Scene) -> FrameNoise | None:
    """The reverse. Raises ValueError where that is no such noise of the scene's panel."""
    if scene.readout is None or not arrays:
        return None
    rows, columns = scene.panel.shape
    channels = rows if scene.circuit.by_columns else columns
    numbers = [np.asarray(arrays.get(name, np.nan)) for name in NUMBERS]
    roots = [np.asarray(arrays.get(name, np.zeros((channels, 0)))) for name in PATTERNS]
    if any(array.dtype.kind not in "iuf" or not np.isfinite(array).all() for array in (*numbers, *roots)):
        raise ValueError("frame_gain and what belongs to it must be finite numbers")
    if any(number.shape for number in numbers) or numbers[0] < 0 or numbers[1] < 1:
        raise ValueError("frame_gain must not be negative, frame_unloaded at least 1")
    if any(root.ndim != 2 or len(root) != channels for root in roots):
        raise ValueError(f"frame_together and frame_apart must have {channels} rows, one for each channel of a line")
    return FrameNoise(scene, int(numbers[1]), float(numbers[0]), *(root.astype(float) for root in roots))
