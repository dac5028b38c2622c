"""Results files: what estimators made of recordings, case by case; their one reader and writer."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.runs.case import SHARED, CaseResult, PublishedFigures, Results, StepFigures, check_name
from lampest.runs.columns import AXES, ESTIMATED, GIVEN, Column

__all__ = ["CaseResult", "PublishedFigures", "Results", "StepFigures", "check_name", "read_results", "write_results"]
FORMAT = "results/1"
UNITS = {"_mm": "mm", "_kpa": "kPa"}


def write_results(
    path: str | Path, cases: Sequence[CaseResult], published: Mapping[str, PublishedFigures] | None = None
) -> None:
    """Write all cases into one file, whole or not at all; the same cases give the same bytes.

    Raises InputError where a case appears twice, where two different recordings share a name, or where the place cannot
    be written.
    """
    groups: dict[str, list[CaseResult]] = {}
    for case in cases:
        groups.setdefault(case.recording, []).append(case)
    for recording in groups.values():
        _check_together(recording)
    with hdf5.new_file(Path(path)) as file:
        hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT)
        entry = file.create_group("entry")
        hdf5.set_attributes(entry, NX_class="NXentry", **({"default": next(iter(groups))} if groups else {}))
        if published:
            figures = {name: asdict(figures) for name, figures in published.items()}
            hdf5.set_attributes(entry, published=json.dumps(figures, allow_nan=False))
        for order, (name, recording) in enumerate(groups.items()):
            _write_recording(entry.create_group(name), order, recording)


def _check_together(cases: list[CaseResult]) -> None:
    first, seen = cases[0], set()
    for case in cases:
        if case.estimator in seen:
            raise InputError(f"two cases are called {case.recording} × {case.estimator}")
        seen.add(case.estimator)
        for name in (
            "time",
            "pitch_mm",
            "series_resistance_ohm",
            "top_row_depth_mm",
            *(column.field for column in GIVEN),
        ):
            ours, theirs = getattr(case, name), getattr(first, name)
            if (ours is None) != (theirs is None) or (ours is not None and not np.array_equal(ours, theirs)):
                raise InputError(
                    f"{case.estimator} and {first.estimator} were given different recordings of the name "
                    f"{case.recording} ({name} differs)"
                )


def _write_recording(group: h5py.Group, order: int, cases: list[CaseResult]) -> None:
    hdf5.set_attributes(group, NX_class="NXsubentry", default=cases[0].estimator, order=order)
    given = _frames_group(group, SHARED, "resistance", cases[0])
    hdf5.set_attributes(
        given, pitch_mm=float(cases[0].pitch_mm), series_resistance_ohm=float(cases[0].series_resistance_ohm)
    )
    if cases[0].top_row_depth_mm is not None:
        hdf5.set_attributes(given, top_row_depth_mm=float(cases[0].top_row_depth_mm))
    _write_columns(given, cases[0], GIVEN)
    for place, case in enumerate(cases):
        found = _frames_group(group, case.estimator, "cell_resistance", case)
        hdf5.set_attributes(found, order=place, case_id=case.case_id, case=case.case_yaml)
        hdf5.set_attributes(found, **{f"{library}_version": text for library, text in sorted(case.versions.items())})
        hdf5.set_attributes(
            found,
            baseline_status=case.baseline_status,
            baseline_solve_time_s=float(case.baseline_solve_time),
            joint_start=np.uint8(case.joint_start),
        )
        _write_columns(found, case, (*ESTIMATED, GIVEN[0]))
        hdf5.write_dataset(found, "status", hdf5.ascii_array(case.status), "1", "how the solve ended", AXES[:1])
        for folder, figures in (("cost", case.costs), ("weight", case.weights), ("disc", case.disc)):
            for name, figure in figures.items():
                text = f"{folder} of the term {name}" if folder != "disc" else f"oral disc: {name.replace('_', ' ')}"
                units = next((unit for end, unit in UNITS.items() if name.removesuffix("_errors").endswith(end)), "1")
                hdf5.write_dataset(found, f"{folder}/{name}", np.asarray(figure, float), units, text, AXES[:1])
            if figures:
                hdf5.set_attributes(found[folder], NX_class="NXcollection")


def _frames_group(parent: h5py.Group, name: str, signal: str, case: CaseResult) -> h5py.Group:
    group = parent.create_group(name)
    hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=list(AXES))
    _, rows, columns = case.measured.shape
    hdf5.write_scale(group, "time", np.asarray(case.time, dtype=float), "s", "time of the frame")
    hdf5.write_scale(group, "row", np.arange(rows), "1", "row line")
    hdf5.write_scale(group, "column", np.arange(columns), "1", "column line")
    return group


def _write_columns(group: h5py.Group, case: CaseResult, columns: Sequence[Column]) -> None:
    for column in columns:
        value = getattr(case, column.field)
        if value is not None:
            data = np.asarray(value).astype(column.kind)
            hdf5.write_dataset(group, column.dataset, data, column.units, column.long_name, column.axes)


def read_results(path: str | Path) -> Results:
    """Read a results file. Raises InputError with the dataset's path where something is wrong."""
    path = Path(path)
    with hdf5.existing_file(path) as file:
        form = hdf5.read_attribute(file, "/", "lampest_format")
        if not isinstance(form, str) or form != FORMAT:
            raise InputError(f"{path}: no results file (lampest_format is {form!r}, not '{FORMAT}')")
        published = _read_published(file)
        cases: list[CaseResult] = []
        for recording in _in_order(file, "/entry"):
            cases += _read_recording(file, recording)
        return Results(tuple(cases), published)


def _in_order(file: h5py.File, path: str) -> list[str]:
    names = hdf5.child_groups(file, path)
    return sorted(names, key=lambda name: (hdf5.read_number(file, f"{path}/{name}", "order", 0), name))


def _read_recording(file: h5py.File, name: str) -> list[CaseResult]:
    base = f"/entry/{name}/{SHARED}"
    resistance = hdf5.read_array(file, f"{base}/resistance", 3)
    sizes = dict(zip(AXES, resistance.shape, strict=True))
    estimators = [child for child in hdf5.child_groups(file, f"/entry/{name}") if child != SHARED]
    if len(estimators) * len(ESTIMATED) * resistance.size > hdf5.MOST_VALUES:
        raise InputError(
            f"{file.filename}: /entry/{name} claims more than {hdf5.MOST_VALUES} values, which are not read"
        )
    given = _read_columns(file, base, GIVEN, sizes)
    given["time"] = hdf5.read_array(file, f"{base}/time", 1, (sizes["time"],)).astype(float)
    for attribute in ("pitch_mm", "series_resistance_ohm"):
        given[attribute] = hdf5.read_number(file, base, attribute)
    if "top_row_depth_mm" in hdf5.attribute_names(file, base):
        given["top_row_depth_mm"] = hdf5.read_number(file, base, "top_row_depth_mm")
    return [
        _read_case(file, name, child, given, sizes) for child in _in_order(file, f"/entry/{name}") if child != SHARED
    ]


def _read_case(file: h5py.File, recording: str, name: str, given: dict[str, Any], sizes: dict[str, int]) -> CaseResult:
    base = f"/entry/{recording}/{name}"
    found = _read_columns(file, base, ESTIMATED, sizes)
    found["solved"] = found["solved"].astype(bool)
    texts = {attribute: hdf5.read_attribute(file, base, attribute) for attribute in hdf5.attribute_names(file, base)}
    try:
        return CaseResult(
            recording=recording,
            estimator=name,
            case_id=str(texts.get("case_id", "")),
            case_yaml=str(texts.get("case", "")),
            versions={key.removesuffix("_version"): str(texts[key]) for key in texts if key.endswith("_version")},
            status=hdf5.read_texts(file, f"{base}/status", sizes["time"]),
            costs=_read_figures(file, f"{base}/cost", sizes["time"]),
            weights=_read_figures(file, f"{base}/weight", sizes["time"]),
            disc=_read_figures(file, f"{base}/disc", sizes["time"]),
            baseline_status=str(texts.get("baseline_status", "")),
            baseline_solve_time=hdf5.read_number(file, base, "baseline_solve_time_s", float("nan")),
            joint_start=bool(hdf5.read_number(file, base, "joint_start")),
            **given,
            **found,
        )
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(file.filename) else f"{file.filename}: {error}") from error


def _read_figures(file: h5py.File, path: str, frames: int) -> dict[str, Any]:
    """term → (frames)."""
    terms = hdf5.child_datasets(file, path) if hdf5.has(file, path) else []
    return {term: hdf5.read_array(file, f"{path}/{term}", 1, (frames,)) for term in terms}


def _read_columns(file: h5py.File, base: str, columns: Sequence[Column], sizes: dict[str, int]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for column in columns:
        path = f"{base}/{column.dataset}"
        if column.optional and not hdf5.has(file, path):
            found[column.field] = None
            continue
        shape = tuple(sizes[axis] for axis in column.axes)
        if np.issubdtype(column.kind, np.integer):
            found[column.field] = hdf5.read_whole(file, path, column.kind, len(shape), shape)
        else:
            found[column.field] = hdf5.read_array(file, path, len(shape), shape).astype(column.kind)
    return found


def _read_published(file: h5py.File) -> dict[str, PublishedFigures]:
    if "published" not in hdf5.attribute_names(file, "/entry"):
        return {}
    try:
        content = json.loads(str(hdf5.read_attribute(file, "/entry", "published")))
        return {
            str(name): PublishedFigures(
                **{step: StepFigures(**values) for step, values in figures.items() if values is not None}
            )
            for name, figures in content.items()
        }
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        names = ", ".join(item.name for item in fields(PublishedFigures))
        raise InputError(f"{file.filename}: /entry@published is not figures by estimator and {names}") from error
