"""Cases → a results file, whole or not at all."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.parts import join_parts
from lampest.files.typed import Configuration, check_not_negative, typed
from lampest.panel.scene import Scene, scene_text
from lampest.recording.recording import coordinates
from lampest.runs.case import SENTENCES, SHARED, CaseResult, StoredCase
from lampest.runs.columns import FIGURES, FRAME, FRAMES, MAPS, MEASURED, TIME, Column, Figures, all_columns

FORMAT = "results/1"
POSITIONS = "y x"  # by this the CF conventions, and so xarray, know them for coordinates


@dataclass(frozen=True)
class StepFigures(Configuration):
    """Published figures of some steps: mean and standard deviation of solve time (s) and of data error (percent).

    Raises ValueError where a figure is negative or not finite.

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
    """An estimator's figures in a publication: over all steps, or apart where the first is solved with the baseline.

    >>> lampest.PublishedFigures(all=lampest.StepFigures(time_s=16.45)).all.time_s
    16.45
    """

    all: StepFigures | None = None
    initial: StepFigures | None = None
    following: StepFigures | None = None


@typed
def write_results(
    path: str | Path,
    cases: Sequence[CaseResult | StoredCase],
    published: Mapping[str, PublishedFigures] | None = None,
    columns: Sequence[Column] = (),
) -> None:
    """Write all cases into one file, whole or not at all; the same cases give the same bytes.

    columns : of what the cases hold as `extra`, besides those of installed packages. Raises InputError where a case
    appears twice, where two different recordings share a name, where an extra has no column or does not fit it, or
    where the place cannot be written.

    >>> lampest.write_results("results.h5", [found.result("LSM")])
    """
    table = all_columns(columns)
    groups: dict[str, list[CaseResult]] = {}
    stored: dict[str, list[StoredCase]] = {}
    for case in cases:
        if isinstance(case, StoredCase):
            stored.setdefault(case.recording, []).append(case)
        else:
            case.described(columns)
            groups.setdefault(case.recording, []).append(case)
    for recording in groups.values():
        _check_together(recording, table)
    size = sum(case.path.stat().st_size for long in stored.values() for case in long)
    with hdf5.new_large_file(Path(path), size) if stored else hdf5.new_file(Path(path)) as file:
        hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT)
        entry = file.create_group("entry")
        hdf5.set_attributes(entry, NX_class="NXentry", **({"default": cases[0].recording} if cases else {}))
        if published:
            text = json.dumps({name: asdict(figures) for name, figures in published.items()}, allow_nan=False)
            hdf5.set_attributes(entry, published=text)
        for order, name in enumerate(dict.fromkeys(case.recording for case in cases)):
            group = entry.create_group(name)
            if name in stored:
                _copy_recording(group, order, stored[name])
            else:
                _write_recording(group, order, groups[name], table)


def join_case(path: Path, parts: Sequence[Path], recording: str) -> None:
    """Write the case whose parts are these files, one after the other in time, whole or not at all.

    Raises InputError where a part cannot be read, or as `write_results`.
    """
    size = sum(part.stat().st_size for part in parts)
    with hdf5.new_large_file(path, size) as file:
        hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT)
        entry = file.create_group("entry")
        hdf5.set_attributes(entry, NX_class="NXentry", default=recording)
        join_parts(parts, entry.create_group(recording), f"/entry/{recording}")


def _copy_recording(group: h5py.Group, order: int, cases: list[StoredCase]) -> None:
    """The cases of a long recording from their own files."""
    hdf5.set_attributes(group, NX_class="NXsubentry", default=cases[0].estimator, order=order)
    for number, case in enumerate(cases):
        for name in (SHARED, case.estimator)[bool(number) :]:
            join_parts((case.path,), group.create_group(name), f"/entry/{case.recording}/{name}")
        hdf5.set_attributes(group[case.estimator], order=number)


def _check_together(cases: list[CaseResult], table: Sequence[Column]) -> None:
    """Cases of one recording must have been given the same."""
    first, seen, numbers = cases[0], set(), _numbers(cases[0].scene)
    for case in cases:
        if case.estimator in seen:
            raise InputError(f"two cases are called {case.recording} × {case.estimator}")
        seen.add(case.estimator)
        for name, ours, theirs in (
            *((each.name, case.column(each.name), first.column(each.name)) for each in table if each.shared),
            *((name, _numbers(case.scene).get(name), number) for name, number in numbers.items()),
            ("start_time", case.start_time or first.start_time, first.start_time or case.start_time),
            ("scene", case.scene, first.scene),
        ):
            if (ours is None) != (theirs is None) or (ours is not None and not _same(ours, theirs)):
                raise InputError(
                    f"{case.estimator} and {first.estimator} were given different recordings of the name "
                    f"{case.recording} ({name} differs)"
                )


def _same(ours: Any, theirs: Any) -> bool:
    """Whether two values agree; what is no number in both does."""
    numbers = isinstance(ours, np.ndarray) and ours.dtype.kind == "f"
    return np.array_equal(ours, theirs, equal_nan=numbers)


def _write_recording(group: h5py.Group, order: int, cases: list[CaseResult], table: Sequence[Column]) -> None:
    hdf5.set_attributes(group, NX_class="NXsubentry", default=cases[0].estimator, order=order)
    scene = cases[0].scene
    start_time = next((case.start_time for case in cases if case.start_time), "")
    table = [column.of(scene.circuit) for column in table]
    given = _group_of_data(group, SHARED, MEASURED.of(scene.circuit).path)
    hdf5.set_attributes(given, **_numbers(scene))
    hdf5.write_dataset(given, "scene", hdf5.ascii_array(scene_text(scene)), "1", "what was measured, YAML")
    if start_time:
        hdf5.write_dataset(
            given, "start_time", hdf5.ascii_array(start_time), "1", "date and time at 0 s of the time axis, ISO 8601"
        )
    _write_datasets(given, cases[0], [column for column in table if column.shared and column != TIME])
    for number, case in enumerate(cases):
        estimate = _group_of_data(group, case.estimator, "cell_resistance")
        attributes: dict[str, Any] = {"order": number, "case_id": case.case_id, "case": case.case_yaml}
        attributes |= {f"{library}_version": text for library, text in sorted(case.versions.items())}
        attributes |= {
            "baseline_status": case.baseline_status,
            "baseline_solve_time_s": float(case.baseline_solve_time),
        }
        attributes |= {"joint_start": np.uint8(case.joint_start)}
        attributes |= {name: text for name, field in SENTENCES.items() if (text := getattr(case, field))}
        attributes |= {"reading_error": float(case.reading_error)} if case.reading_error else {}
        hdf5.set_attributes(
            estimate, **attributes, **{f"frame_{name}": noise for name, noise in case.frame_noise.items()}
        )
        own = [*(column for column in table if not column.shared), FRAME]
        _write_datasets(estimate, case, own, FIGURES)


def _numbers(scene: Scene) -> dict[str, float]:
    """Attributes of a recording's group: numbers of its scene, which stands beside them as YAML text."""
    series, depth = scene.series_resistance_ohm, None if scene.water is None else scene.water.top_row_depth_mm
    numbers = {"pitch_mm": scene.panel.pitch_mm, "series_resistance_ohm": series, "top_row_depth_mm": depth}
    return {name: float(number) for name, number in numbers.items() if isinstance(number, int | float)}


def _group_of_data(parent: h5py.Group, name: str, signal: str) -> h5py.Group:
    group = parent.create_group(name)
    hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=list(MAPS))
    return group


def _write_datasets(
    group: h5py.Group, case: CaseResult, columns: Sequence[Column], folders: Sequence[Figures] = ()
) -> None:
    """Axes, positions, columns and figures of a case in a group, and then which of them lie along which axes."""
    hdf5.write_scale(group, TIME.path, np.asarray(case.time, dtype=float), TIME.units, TIME.long_name)
    axes: dict[str, tuple[str, ...]] = {}
    for name, (along, values, units, long_name) in coordinates(case.scene.panel).items():
        if (name,) == along:
            hdf5.write_scale(group, name, values, units, long_name)
        else:
            hdf5.write_dataset(group, name, values, units, long_name)
            axes[name] = along
    for column in columns:
        if (held := case.column(column.name)) is not None:
            seen: dict[str, Any] = {"coordinates": POSITIONS} if column.axes != FRAMES else {}
            hdf5.write_dataset(group, column.path, column.stored(held), **column.attributes, **seen)
            axes[column.path] = column.axes
    for folder in folders:
        figures = getattr(case, folder.name)
        for name, values in figures.items():
            path, data = f"{folder.folder}/{name}", np.asarray(values, dtype=float)
            hdf5.write_dataset(group, path, data, folder.units(name), folder.long_name(name))
            axes[path] = FRAMES
        if figures:
            hdf5.set_attributes(group[folder.folder], NX_class="NXcollection")
    hdf5.attach_scales(group, axes)
