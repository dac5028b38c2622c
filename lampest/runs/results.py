"""Results files: writer and reader of cases."""

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import chain
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from h5py import File, Group

from lampest.files import checksums, hdf5
from lampest.files.document import adapter, parse_document
from lampest.files.errors import InputError, brief, meant
from lampest.files.parts import copy_group, join_parts
from lampest.files.typed import Configuration, check_not_negative, typed
from lampest.panel.scene import Scene, scene_text, validated_scene
from lampest.recording import stored
from lampest.runs.case import (
    ATTRIBUTES,
    FIGURES,
    FRAME,
    MEASURED,
    REQUIRED,
    SHARED,
    TIME,
    StoredCase,
    all_columns,
)
from lampest.runs.case import CaseResult as CaseResult
from lampest.runs.columns import FRAMES, MAPS, Column, Columns

FORMAT = "results/1"
Reader = Callable[[str | Path], "Results"]
POSITIONS = "y x"  # attribute `coordinates` of the CF conventions, which xarray reads


@dataclass(frozen=True)
class StepFigures(Configuration):
    """Published figures of some steps: solve time in s and data error in percent.

    Each figure is a mean and a standard deviation.

    Raises ValueError for negative and infinite figures.

    >>> lampest.StepFigures(error_percent=1.33).error_percent
    1.33
    """

    time_s: float | None = None
    time_sd_s: float | None = None
    error_percent: float | None = None
    error_sd_percent: float | None = None

    def __post_init__(self) -> None:
        check_not_negative(self, *(field.name for field in fields(self)))


@dataclass(frozen=True)
class PublishedFigures(Configuration):
    """Published figures of an estimator.

    One set of figures is over all steps, or two sets are over a joint first step and the following
    ones.

    >>> lampest.PublishedFigures(all=lampest.StepFigures(time_s=16.45)).all.time_s
    16.45
    """

    all: StepFigures | None = None
    initial: StepFigures | None = None
    following: StepFigures | None = None


@dataclass(frozen=True, eq=False)
class Results:
    """Cases of a file in their order, and published figures by estimator.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> lampest.Results((estimate.result("LSM"),)).estimators()
    ('LSM',)
    """

    cases: tuple[CaseResult, ...]
    published: Mapping[str, PublishedFigures] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return the object in one line, arrays by their shapes."""
        return brief(self)

    def recordings(self) -> tuple[str, ...]:
        """Return the names of the recordings in order."""
        return tuple(dict.fromkeys(case.recording for case in self.cases))

    def of(self, recording: str) -> tuple[CaseResult, ...]:
        """Return the cases of a recording. Raises InputError if there are none."""
        return self.named("recording", (recording,)).cases

    def estimators(self) -> tuple[str, ...]:
        """Return the names of the estimators in order."""
        return tuple(dict.fromkeys(case.estimator for case in self.cases))

    def label(self, case: CaseResult) -> str:
        """Return the estimator's name, as `LSR-CR, paper's lambda` for published, fixed weights."""
        chosen = "weight: auto" in case.case_yaml or not case.weights.keys() - {"misfit"}
        if chosen or case.estimator not in self.published:
            return case.estimator
        return f"{case.estimator}, paper's lambda"

    def named(self, field: Literal["recording", "estimator"], names: Collection[str]) -> "Results":
        """Return the results of these recordings or estimators in the order of the file.

        No names stand for all.

        Raises InputError for an unknown name.
        """
        known = self.recordings() if field == "recording" else self.estimators()
        for name in names:
            if name not in known:
                close = meant(name, known)
                raise InputError(
                    f"no {field} is called {name!r}; there are {', '.join(known) or 'none'}{close}"
                )
        cases = [case for case in self.cases if getattr(case, field) in (names or known)]
        return replace(self, cases=tuple(cases))


@typed
def write_results(
    path: str | Path,
    cases: Sequence[CaseResult | StoredCase],
    published: Mapping[str, PublishedFigures] | None = None,
    columns: Columns = (),
) -> None:
    """Write cases into one file, atomically and reproducibly.

    Parameters
    ----------
    path : path
    cases : sequence of CaseResult or StoredCase
    published : mapping, optional
        Estimator → published figures.
    columns : sequence of Column
        Descriptions of `extra`, besides those of installed packages.

    Raises
    ------
    InputError
        For repeated cases, different recordings of one name, an extra without column or unfit
        values, and a place that cannot be written.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> lampest.write_results("results.h5", [estimate.result("LSM")])
    """
    recordings: dict[str, list[CaseResult | StoredCase]] = {}
    for case in cases:
        recordings.setdefault(case.recording, []).append(case)
    for held in recordings.values():
        _check_together([case for case in held if isinstance(case, CaseResult)], columns)
    path = Path(path)
    held_in_files = [case for case in cases if isinstance(case, StoredCase)]
    size = sum(case.path.stat().st_size for case in held_in_files)
    # The file of more readings than a recording in memory has is built on the disk.
    large = sum(case.frames * case.cells for case in held_in_files) > stored.MAX_READINGS
    with hdf5.new_large_file(path, size) if large else hdf5.new_file(path) as file:
        entry = _begun(file, next(iter(recordings), ""))
        if published:
            figures = {name: asdict(of_name) for name, of_name in published.items()}
            hdf5.set_attributes(entry, published=json.dumps(figures, allow_nan=False))
        for order, (name, held) in enumerate(recordings.items()):
            group = entry.create_group(name)
            hdf5.set_attributes(
                group, NX_class="NXsubentry", default=held[0].estimator, order=order
            )
            measured: dict[str, bytes] = {}
            for number, case in enumerate(held):
                if isinstance(case, StoredCase):
                    _copy_case(group, case, measured)
                else:
                    _write_case(group, case, columns)
                measured = measured or checksums.digests_below(group[SHARED])
                hdf5.set_attributes(group[case.estimator], order=number)


def join_case(path: Path, parts: Sequence[Path], recording: str) -> None:
    """Join the parts of a case, in temporal order, into one file atomically.

    Raises InputError for an unreadable part, and as `write_results`.
    """
    with hdf5.new_large_file(path, sum(part.stat().st_size for part in parts)) as file:
        join_parts(parts, _begun(file, recording).create_group(recording), f"/entry/{recording}")


def _begun(file: File, first: str) -> Group:
    """Create the entry of a file with its first recording as the default."""
    hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT)
    entry = file.create_group("entry")
    hdf5.set_attributes(entry, NX_class="NXentry", **({"default": first} if first else {}))
    return entry


def _check_together(cases: Sequence[CaseResult], columns: Columns) -> None:
    """Raise InputError unless all cases of a recording have the same measurement."""
    estimators = set()
    for case in cases:
        first = cases[0]
        shared = [column.name for column in case.described(columns) if column.shared]
        if case.estimator in estimators:
            raise InputError(f"two cases are called {case.recording} × {case.estimator}")
        estimators.add(case.estimator)
        for name, ours, theirs in (
            *((name, case.column(name), first.column(name)) for name in shared),
            ("start_time", case.start_time, first.start_time),
            ("scene", case.scene, first.scene),
        ):
            numeric = isinstance(ours, np.ndarray) and ours.dtype.kind == "f"
            if (ours is None) != (theirs is None) or not np.array_equal(
                ours, theirs, equal_nan=numeric
            ):
                raise InputError(
                    f"{case.estimator} and {first.estimator} were given different recordings "
                    f"of the name {case.recording} ({name} differs)"
                )


def _write_case(group: Group, case: CaseResult, columns: Columns) -> None:
    """Write an estimate and, with the first case of a recording, the measurement."""
    variables = case.variables(columns, raw=True).values()
    if SHARED not in group:
        measurement = _group_of_data(group, SHARED, MEASURED.of(case.scene.circuit).path)
        texts = {"scene": (scene_text(case.scene), "what was measured, YAML")}
        if case.start_time:
            texts["start_time"] = case.start_time, "date and time at 0 s of the time axis, ISO 8601"
        for name, (text, words) in texts.items():
            hdf5.write_dataset(measurement, name, hdf5.ascii_array(text), "1", words)
        _write_variables(measurement, case, [each for each in variables if each.shared])
    estimate = _group_of_data(group, case.estimator, "cell_resistance")
    attributes = {
        name: value
        for name, (item, default) in ATTRIBUTES.items()
        if (value := getattr(case, item)) != default
    }
    attributes |= {f"{library}_version": text for library, text in case.versions.items()}
    attributes |= {f"frame_{name}": noise for name, noise in case.frame_noise.items()}
    attributes["joint_start"] = np.uint8(case.joint_start)
    hdf5.set_attributes(estimate, **attributes)
    axes = (TIME.name, FRAME.name)
    own = [each for each in variables if not each.shared or each.name in axes]
    _write_variables(estimate, case, own)


def _copy_case(group: Group, case: StoredCase, measured: Mapping[str, bytes]) -> None:
    """Copy an estimate of a file and, with the first case of a recording, the measurement.

    Attributes of a check that was made after the case replace those of the file.

    Raises InputError for an unreadable file, or if its measurement differs from that of the first
    case, whose digests are `measured`.
    """
    with hdf5.existing_file(case.path) as source:
        held = source[f"entry/{case.recording}"]
        if not measured:
            copy_group(held[SHARED], group, SHARED)
        else:
            differing = measured.items() ^ checksums.digests_below(held[SHARED]).items()
            if differing:
                raise InputError(
                    f"{case.estimator} and an estimator before it were given different recordings "
                    f"of the name {case.recording} ({min(differing)[0]} differs)"
                )
        copy_group(held[case.estimator], group, case.estimator)
    if case.verdict is None:
        return
    estimate = group[case.estimator]
    names = ("model_explains", "model_check", "advice", "warnings")
    for name, text in zip(names, (*case.verdict, case.advice, case.warnings), strict=True):
        if text:
            hdf5.set_attributes(estimate, **{name: text})
        elif name in estimate.attrs:
            del estimate.attrs[name]


def _group_of_data(parent: Group, name: str, signal: str) -> Group:
    """Create a group with the axes of a case and its signal."""
    group = parent.create_group(name)
    hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=list(MAPS))
    return group


def _write_variables(group: Group, case: CaseResult, variables: Iterable[Column]) -> None:
    """Write coordinates, columns and figures of a case into a group, then attach the axes."""
    axes = {}
    places = case.coordinates
    for column in (*places.values(), *variables):
        attributes = column.attributes
        if column.name not in places and column.axes != FRAMES:
            attributes["coordinates"] = POSITIONS
        hdf5.write_dataset(group, column.path, column.stored, **attributes)
        if column.axes == (column.name,):
            group[column.path].make_scale(column.name)
        else:
            axes[column.path] = column.axes
    for folder in sorted({path.partition("/")[0] for path in axes if "/" in path}):
        hdf5.set_attributes(group[folder], NX_class="NXcollection")
    hdf5.attach_scales(group, axes)


@typed
def read_results(path: str | Path, columns: Columns = (), frames: range | None = None) -> Results:
    """Read a results file.

    Parameters
    ----------
    path : path
    columns : sequence of Column
        Columns besides those of lampest and of installed packages.
    frames : range, optional
        Frames of the recordings that are read; recordings without any of them are left out.

    Returns
    -------
    Results

    Raises
    ------
    InputError
        With the path of a faulty dataset, if datasets were exchanged or removed, or if no recording
        has any of the frames.

    Examples
    --------
    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> estimate.save("results.h5", "LSM")
    >>> lampest.read_results("results.h5").recordings()
    ('mine',)
    """
    path = Path(path)
    table = all_columns(columns)
    with _results_file(path) as file:
        checksums.check_datasets(file)
        published = _read_published(file)
        names = _in_order(file, "/entry")
        parts = {name: hdf5.ALL if frames is None else _part(file, name, frames) for name in names}
        held = {name: part for name, part in parts.items() if part is not None}
        if names and not held:
            raise InputError(f"{path}: holds none of the frames that are asked for")
        read = (_read_recording(file, name, table, part) for name, part in held.items())
        return Results(tuple(chain.from_iterable(read)), published)


def read_each(path: Path, most: int) -> Iterator[CaseResult]:
    """Yield every case of a results file in parts of `most` readings.

    Raises InputError as `read_results`.
    """
    with _results_file(path) as file:
        checksums.check_datasets(file)
        _read_published(file)
        for name in _in_order(file, "/entry"):
            frames, cells = _sizes(file, name)
            step = max(1, most // (cells * max(1, len(_estimators(file, name)))))
            for begin in range(0, frames, step):
                yield from _read_recording(file, name, all_columns(), slice(begin, begin + step))


def stored_cases(path: Path) -> tuple[StoredCase, ...]:
    """Return references to the cases of a results file. Raises InputError as `read_results`."""
    with _results_file(path) as file:
        cases = []
        for recording in _in_order(file, "/entry"):
            for name in _estimators(file, recording):
                case_id, warnings, advice = (
                    str(hdf5.read_attribute(file, f"/entry/{recording}/{name}", text) or "")
                    for text in ("case_id", "warnings", "advice")
                )
                names = (path, recording, name, *_sizes(file, recording))
                cases.append(StoredCase(*names, case_id, warnings, advice))
        return tuple(cases)


def read_case_scene(case: StoredCase) -> Scene:
    """Return the scene of a case's recording. Raises InputError as `read_results`."""
    with _results_file(case.path) as file:
        return _read_scene(file, case.recording)


def _read_scene(file: File, recording: str) -> Scene:
    """Return the scene of a stored recording. Raises InputError for an invalid one."""
    path = f"/entry/{recording}/{SHARED}/scene"
    text = hdf5.read_text(file, path)
    return validated_scene(parse_document(text, f"{file.filename}:{path}"))


@contextmanager
def _results_file(path: Path) -> Iterator[File]:
    """Yield an open results file. Raises InputError if the file is none."""
    with hdf5.existing_file(path) as file:
        form = hdf5.read_attribute(file, "/", "lampest_format")
        if str(form) != FORMAT:
            kind = f"lampest_format is {form!r}"
            if str(form).startswith("recording/"):
                kind = "a recording, lampest run computes results of it"
            raise InputError(f"{file.filename}: no results file ({kind})")
        yield file


def _in_order(file: File, path: str) -> list[str]:
    """Return the names of the groups below a path in the order in which they were written."""
    names = hdf5.children(file, path, Group)
    return sorted(
        names, key=lambda name: (hdf5.read_number(file, f"{path}/{name}", "order", 0), name)
    )


def _estimators(file: File, recording: str) -> list[str]:
    return [name for name in _in_order(file, f"/entry/{recording}") if name != SHARED]


def _sizes(file: File, recording: str) -> tuple[int, int]:
    """Return the numbers of frames and cells of a recording."""
    frames, rows, columns = (
        hdf5.length_of(file, f"/entry/{recording}/{SHARED}/{axis}") for axis in MAPS
    )
    return frames, rows * columns


def _part(file: File, recording: str, frames: range) -> slice | None:
    """Return the slice of the stored frames that belong to a range; None if it is empty."""
    estimator = _estimators(file, recording)[0]
    numbers = hdf5.read_array(file, f"/entry/{recording}/{estimator}/{FRAME.path}", 1)
    begin, end = np.searchsorted(numbers, (frames.start, frames.stop))
    return slice(int(begin), int(end)) if begin < end else None


def _read_recording(file: File, name: str, table: Columns, part: slice) -> list[CaseResult]:
    """Return the cases of a recording. Raises InputError as `read_results`."""
    base = f"/entry/{name}/{SHARED}"
    scene = _read_scene(file, name)
    table = [column.of(scene.circuit) for column in table]
    path = f"{base}/{MEASURED.of(scene.circuit).path}"
    # Validation of type and dimensions; no values are read.
    hdf5.read_array(file, path, len(MAPS), part=slice(0))
    shape = hdf5.shape_of(file, path)
    estimators = _estimators(file, name)
    maps = len(estimators) * sum(column.axes == MAPS and not column.shared for column in table)
    if maps * len(range(shape[0])[part]) * prod(shape[1:]) > hdf5.MAX_VALUES:
        raise InputError(
            f"{file.filename}: /entry/{name} claims more than {hdf5.MAX_VALUES} values, "
            "which are not read at once; "
            f"of its {shape[0]} frames --frames 0:1000 names some"
        )
    sizes = dict(zip(MAPS, shape, strict=True))

    def values_in(group: str, *, shared: bool) -> dict[str, Any]:
        """Return the values of the columns that are required or in a group of the file."""
        return {
            column.name: column.read(file, group, sizes, part)
            for column in table
            if column.shared == shared
            and (column.name in REQUIRED or hdf5.has(file, f"{group}/{column.path}"))
        }

    start_path = f"{base}/start_time"
    start = hdf5.read_text(file, start_path) if hdf5.has(file, start_path) else ""
    about = {"recording": name, "scene": scene, "start_time": start}
    measurements = values_in(base, shared=True)
    cases = []
    for estimator in estimators:
        group = f"/entry/{name}/{estimator}"
        values = measurements | values_in(group, shared=False)
        attributes = about | _read_attributes(file, group)
        for kind in FIGURES:
            folder = f"{group}/{kind.folder}"
            attributes[kind.name] = {
                figure: hdf5.read_array(file, f"{folder}/{figure}", 1, shape[:1], part)
                for figure in (hdf5.children(file, folder) if hdf5.has(file, folder) else ())
            }
        try:
            case = CaseResult.of(values, estimator=estimator, **attributes)
            case.check(table)
        except InputError as error:
            raise InputError(f"{file.filename}: {error}") from error
        cases.append(case)
    return cases


def _read_attributes(file: File, path: str) -> dict[str, Any]:
    """Return the attributes of a case."""
    texts = {
        name: hdf5.read_attribute(file, path, name) for name in hdf5.attribute_names(file, path)
    }
    attributes: dict[str, Any] = {"versions": {}, "frame_noise": {}}
    for key, value in texts.items():
        if key.endswith("_version"):
            attributes["versions"][key.removesuffix("_version")] = str(value)
        if key.startswith("frame_"):
            attributes["frame_noise"][key.removeprefix("frame_")] = np.asarray(value)
    for name, (item, default) in ATTRIBUTES.items():
        if isinstance(default, str):
            attributes[item] = str(texts.get(name, ""))
        else:
            attributes[item] = type(default)(hdf5.read_number(file, path, name, default))
    return attributes


def _read_published(file: File) -> dict[str, PublishedFigures]:
    """Return the published figures by estimator, which are stored as JSON."""
    text = hdf5.read_attribute(file, "/entry", "published")
    try:
        return dict(adapter(dict[str, PublishedFigures]).validate_json(text or "{}"))
    except (ValueError, TypeError) as error:
        names = ", ".join(item.name for item in fields(PublishedFigures))
        raise InputError(
            f"{file.filename}: /entry@published is not figures by estimator and {names}"
        ) from error
