"""A results file → its cases."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.runs.case import REQUIRED, SHARED, CaseResult
from lampest.runs.columns import FIGURES, MAPS, MEASURED, Column, all_columns
from lampest.runs.published import PublishedFigures, published_from
from lampest.runs.results.scene import stored_scene
from lampest.runs.results.writer import FORMAT


@dataclass(frozen=True, eq=False)
class Results:
    """The cases of one file in the order they were given, and published figures by estimator."""

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


def read_results(path: str | Path, columns: Sequence[Column] = ()) -> Results:
    """Read a results file; columns : of what it holds besides those of lampest and of installed packages.

    Raises InputError with the dataset's path where something is wrong.
    """
    path, table = Path(path), all_columns(columns)
    with hdf5.existing_file(path) as file:
        _check_format(file)
        published = _read_published(file)
        cases: list[CaseResult] = []
        for recording in _in_order(file, "/entry"):
            cases += _read_recording(file, recording, table)
        return Results(tuple(cases), published)


def read_case_ids(path: Path) -> frozenset[str]:
    """The identities of the cases of a results file, without what they found. Raises InputError as `read_results`."""
    with hdf5.existing_file(path) as file:
        _check_format(file)
        groups = [f"/entry/{name}" for name in hdf5.child_groups(file, "/entry")]
        cases = [f"{group}/{name}" for group in groups for name in hdf5.child_groups(file, group) if name != SHARED]
        return frozenset(str(hdf5.read_attribute(file, case, "case_id")) for case in cases)


def _check_format(file: h5py.File) -> None:
    form = hdf5.read_attribute(file, "/", "lampest_format")
    if not isinstance(form, str) or form != FORMAT:
        raise InputError(f"{file.filename}: no results file (lampest_format is {form!r}, not '{FORMAT}')")


def _in_order(file: h5py.File, path: str) -> list[str]:
    names = hdf5.child_groups(file, path)
    return sorted(names, key=lambda name: (hdf5.read_number(file, f"{path}/{name}", "order", 0), name))


def _read_recording(file: h5py.File, name: str, table: Sequence[Column]) -> list[CaseResult]:
    base = f"/entry/{name}/{SHARED}"
    scene = stored_scene(file, base, f"{base}/{MEASURED.path}")
    table = [column.of(scene.circuit) for column in table]
    measured = hdf5.read_array(file, f"{base}/{MEASURED.of(scene.circuit).path}", 3)
    sizes = dict(zip(MAPS, measured.shape, strict=True))
    estimators = [child for child in _in_order(file, f"/entry/{name}") if child != SHARED]
    maps = sum(column.axes == MAPS and not column.shared for column in table)
    if len(estimators) * maps * measured.size > hdf5.MOST_VALUES:
        raise InputError(
            f"{file.filename}: /entry/{name} claims more than {hdf5.MOST_VALUES} values, which are not read"
        )
    given = _read_columns(file, base, [column for column in table if column.shared], sizes)
    return [_read_case(file, (name, child), given, scene, table, sizes) for child in estimators]


def _read_case(
    file: h5py.File,
    names: tuple[str, str],
    given: dict[str, Any],
    scene: Scene,
    table: Sequence[Column],
    sizes: dict[str, int],
) -> CaseResult:
    recording, name = names
    base = f"/entry/{recording}/{name}"
    values = given | _read_columns(file, base, [column for column in table if not column.shared], sizes)
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
            model_mark=str(texts.get("model_explains", "")),
            model_sentence=str(texts.get("model_check", "")),
            noise_sentence=str(texts.get("noise_check", "")),
            noise_learned=str(texts.get("noise_learned", "")),
            reading_error=hdf5.read_number(file, base, "reading_error", 0.0),
            film_sentence=str(texts.get("film", "")),
            start_time=_start_time(file, recording),
            joint_start=bool(hdf5.read_number(file, base, "joint_start")),
            **{folder.name: _read_figures(file, f"{base}/{folder.folder}", sizes["time"]) for folder in FIGURES},
        )
        case.check(table)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(file.filename) else f"{file.filename}: {error}") from error
    return case


def _start_time(file: h5py.File, recording: str) -> str:
    path = f"/entry/{recording}/{SHARED}/start_time"
    return hdf5.read_text(file, path) if hdf5.has(file, path) else ""


def _read_columns(file: h5py.File, base: str, columns: Sequence[Column], sizes: dict[str, int]) -> dict[str, Any]:
    """Column → values, of those that the file holds or cannot be without."""
    return {
        column.name: column.read(file, base, sizes)
        for column in columns
        if column.name in REQUIRED or hdf5.has(file, f"{base}/{column.path}")
    }


def _read_figures(file: h5py.File, path: str, frames: int) -> dict[str, Array]:
    """name → (frames)."""
    names = hdf5.child_datasets(file, path) if hdf5.has(file, path) else []
    return {name: hdf5.read_array(file, f"{path}/{name}", 1, (frames,)) for name in names}


def _read_published(file: h5py.File) -> dict[str, PublishedFigures]:
    if "published" not in hdf5.attribute_names(file, "/entry"):
        return {}
    text = str(hdf5.read_attribute(file, "/entry", "published"))
    try:
        return published_from(text)
    except ValueError as error:
        raise InputError(f"{file.filename}: /entry@published {error}") from error
