"""The HDF5 file of a recording: how it is opened, its scene, its frames and their coordinates.

A file holds a scene, the values of each field of a `Recording` that is known, and the places of
rows and columns. `lampest.recording.acquisition` names the datasets.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from h5py import File
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.checksums import check_datasets
from lampest.files.document import entry_at, parse_document
from lampest.files.errors import InputError
from lampest.files.process import check_memory
from lampest.panel.effects import SERIES
from lampest.panel.panel import Panel
from lampest.panel.readouts.converter import Characteristic
from lampest.panel.scene import Scene, scene_text, validated_scene
from lampest.recording.acquisition import (
    CODE_OFFSET,
    FILE_ATTRIBUTES,
    FORMER_OFFSET,
    Acquisition,
    group_of,
    stored_fields,
    undamaged_frames,
)

# Key of `systematic: {series_tolerance_ohm}` in recordings of version 0.1.
FORMER_SERIES = "series_ohm"
# Dataset of two-point readings with groups in recordings of version 0.1.
FORMER_SIGNAL = "two_point/volt"
SIMULATION = "/entry/truth/simulation"


@contextmanager
def recording_file(path: Path) -> Iterator[tuple[File, Scene, str]]:
    """Yield an open recording file, its scene and the path of its readings.

    Raises InputError if the file is no recording, or has no valid scene.
    """
    if path.suffix.lower() in hdf5.READABLE:
        raise InputError(
            f"{path}: is no recording; lampest.import_file (lampest import) makes one of it"
        )
    with hdf5.existing_file(path) as file:
        if str(hdf5.read_attribute(file, "/", "lampest_format")).startswith("results/"):
            raise InputError(f"{path}: holds results; lampest.read_results reads them")
        check_datasets(file)
        scene = _scene_of(hdf5.read_text(file, "/entry/scene"), f"{path}:/entry/scene")
        steps = hdf5.read_number(file, "/", CODE_OFFSET, FORMER_OFFSET)
        readout = scene.readout
        # Unless the scene states the converter, it begins as many steps above zero.
        if steps and readout is not None and readout.converter is None:
            zero = steps * readout.lsb_volt
            converter = Characteristic(zero_volt=zero, full_volt=readout.full_scale_volt + zero)
            scene = replace(scene, readout=replace(readout, converter=converter))
        readings = _places(file, scene)["recorded"]
        if len(hdf5.shape_of(file, readings)) != 3:
            raise InputError(f"{path}: {readings} must be frames × rows × columns")
        yield file, scene, readings


def _places(file: File, scene: Scene) -> dict[str, str]:
    """Return the paths of datasets in a file, by field of a `Recording`."""
    fields = stored_fields(scene.circuit).items()
    places = {field: f"/entry/{path}" for field, (path, *_) in fields}
    if not hdf5.has(file, places["recorded"]) and hdf5.has(file, f"/entry/{FORMER_SIGNAL}"):
        places["recorded"] = f"/entry/{FORMER_SIGNAL}"
    return places


@lru_cache(maxsize=8)  # a recording that is too long for memory is opened again for every part
def _scene_of(text: str, where: str) -> Scene:
    """Return the scene of a file's text; the key FORMER_SERIES of earlier versions is renamed.

    Raises InputError, with the place `where`, for an invalid scene.
    """
    document = parse_document(text, where)
    errors = entry_at(document.content, ("systematic",))
    if isinstance(errors, dict) and FORMER_SERIES in errors:
        renamed = {SERIES if key == FORMER_SERIES else key: value for key, value in errors.items()}
        document = document.with_value(("systematic",), renamed)
    return validated_scene(document)


def read_frames(file: File, scene: Scene, part: slice) -> dict[str, Any]:
    """Return the fields of a `Recording` that its file holds, by name.

    Frames without times are a second apart.

    Parameters
    ----------
    file : File
    scene : Scene
    part : slice
        Frames of a finished file; all: those that are not damaged.

    Raises
    ------
    InputError
        If a dataset is invalid, with its path, or memory does not suffice.
    """
    places = {
        field: place for field, place in _places(file, scene).items() if hdf5.has(file, place)
    }
    chosen = part
    if part == hdf5.ALL:
        chosen = undamaged_frames(file, scene)
        # Memory has to suffice for the recording and for copies of its readings.
        shape = hdf5.shape_of(file, places["recorded"])
        besides = set(places) - {"recorded", "time", "role", "raw_sums"}
        others = sum(prod(hdf5.shape_of(file, places[field])) for field in besides)
        label = f"{file.filename}: {shape[0]} frames of {prod(shape[1:])} cells at once"
        # 49 bytes a reading were counted at 100,000,000 readings
        check_memory(8.0 * (6 * prod(shape) + others), label)
    held = {}
    dimensions: dict[str, int | tuple[int, int]] = {"time": 1, "role": 1, "sigma": (2, 3)}
    for field, place in places.items():
        flat = field == "sigma" and len(hdf5.shape_of(file, place)) == 2
        kind = np.uint16 if field == "raw_sums" else None
        rows = hdf5.ALL if flat else chosen
        held[field] = hdf5.read_array(file, place, dimensions.get(field, 3), part=rows, kind=kind)
    for field, place in (("start_time", "/entry/start_time"), ("simulation", SIMULATION)):
        held[field] = hdf5.read_text(file, place) if hdf5.has(file, place) else None
    if "raw_sums" in held:
        held["raw_readings"] = read_raw_readings(file)
    frames = len(held["recorded"])
    acquisition = Acquisition.read(file, chosen)
    if acquisition is not None and held["start_time"] is None and frames and "time" in held:
        held["start_time"] = acquisition.start(float(held["time"][0]))
    held["acquisition"] = acquisition
    number = (chosen.start or 0) + np.arange(frames)
    held.setdefault("time", number.astype(float))
    held["number"] = None if part == hdf5.ALL else number
    return held


def write_frames(file: File, scene: Scene, held: Mapping[str, Any]) -> None:
    """Write scene, frames, truth and acquisition into a new file, in the layout of NeXus.

    `held` are the fields of a `Recording`, None where there is none; the inverse of `read_frames`.
    """
    hdf5.set_attributes(file, **FILE_ATTRIBUTES)
    entry = file.create_group("entry")
    hdf5.set_attributes(entry, NX_class="NXentry", default=group_of(scene.circuit))
    hdf5.write_text(entry, "scene", scene_text(scene))
    if held["start_time"] is not None:
        hdf5.write_text(entry, "start_time", held["start_time"])  # NeXus has it under this name
    lines = ("time", "row", "column")
    axes = {1: lines[:1], 2: lines[1:], 3: lines}
    flags = {"flag_values": np.arange(2, dtype=np.uint8), "flag_meanings": "unloaded measured"}
    for field, (path, kind, units, long_name) in stored_fields(scene.circuit).items():
        name, signal = path.split("/")
        values = held[field]
        uncounted = field == "raw_sums" and held["raw_readings"] is None
        if values is None or uncounted or field == "time":  # each group has a time of its own
            continue
        group = entry.get(name)
        if group is None:
            group = entry.create_group(name)
            hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=[*lines])
            hdf5.write_scale(group, "time", held["time"], "s", "time of the frame")
            for place, (along, at, unit, words) in coordinates(scene.panel).items():
                if (place,) == along:
                    hdf5.write_scale(group, place, at, unit, words)
                else:
                    hdf5.write_dataset(group, place, at, unit, words, along)
        meanings = flags if field == "role" else {}
        hdf5.write_dataset(
            group, signal, values.astype(kind), units, long_name, axes[values.ndim], **meanings
        )
    if "raw" in entry:
        hdf5.set_attributes(entry["raw"], readings=np.uint16(held["raw_readings"] or 0))
    if held["truth_cell_resistance"] is not None and held["simulation"] is not None:
        hdf5.write_text(entry["truth"], "simulation", held["simulation"])
    if held["acquisition"] is not None:
        held["acquisition"].write(entry, held["time"])


def read_raw_readings(file: File) -> int:
    """Return the number of codes in each sum; 0 without it.

    Raises InputError unless it is a whole number of 16 bits.
    """
    number = hdf5.read_number(file, "/entry/raw", "readings", 0)
    most = np.iinfo(np.uint16).max
    if not (0 <= number <= most and float(number).is_integer()):
        raise InputError(
            f"{file.filename}: /entry/raw@readings must be a whole number from 0 to {most}, "
            f"not {number:g}"
        )
    return int(number)


def coordinates(panel: Panel) -> dict[str, tuple[tuple[str, ...], NDArray[Any], str, str]]:
    """Return (axes, values, unit, long name) of the coordinates row, column, y, x and z, by name.

    The coordinate y depends on the row and x on the column. For listed cells x, y, and z in space,
    depend on the cell, and are NaN without a cell.
    """
    lines = zip(("row", "column"), map(np.arange, panel.shape), strict=True)
    axes = {line: ((line,), number, "1", f"{line} line") for line, number in lines}
    if panel.cells is not None:
        height = panel.heights_mm
        places = zip("xyz", [*panel.places_mm, *([] if height is None else [height])], strict=False)
        return axes | {
            name: (("row", "column"), at, "mm", "position of the cell") for name, at in places
        }
    x, y = panel.centres_mm()
    centres = (("y", "row", y), ("x", "column", x))
    return axes | {
        name: ((line,), at, "mm", f"position of the {line}") for name, line, at in centres
    }
