"""Recordings that were never closed: how many of their frames were written, and which of those are damaged.

A recorder appends rows, and after them the checksum of each: one that is there vouches for all of its row.
"""

from collections.abc import Sequence
from typing import Any
from zlib import crc32

import h5py
import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.acquisition import FRAME_FIELDS, LABEL_BYTES

FRAME_CHECKSUM, EVENT_CHECKSUM = "acquisition/crc32", "acquisition/event_crc32"
EVENT_PATHS = ("acquisition/event_time", "acquisition/event_label")
SUMS = 3  # their place among a frame's columns
AT_ONCE = 1000  # frames that are looked at together


def frame_paths(group: str, signal: str) -> tuple[str, ...]:
    """What every frame has a row in, below /entry, in the order of its checksum."""
    acquired = (f"acquisition/{name}" for name, *_ in FRAME_FIELDS)
    return (f"{group}/{signal}", f"{group}/time", f"{group}/role", "raw/sums", *acquired)


def checksums(columns: Sequence[NDArray[Any]]) -> NDArray[np.uint32]:
    """CRC-32 of each row over all columns."""
    count = len(columns[0])
    if not count:
        return np.zeros(0, dtype=np.uint32)
    values = [np.ascontiguousarray(column).reshape(count, -1).view(np.uint8) for column in columns]
    return np.array([crc32(row.tobytes()) for row in np.concatenate(values, axis=1)], dtype=np.uint32)


def undamaged_frames(file: h5py.File, scene: Scene, group: str) -> slice:
    """All frames of a finished file, the written ones of an unfinished one. Raises InputError where one is damaged."""
    if "lampest_unfinished" not in file.attrs:
        return hdf5.ALL
    frames, damaged = damaged_frames(file, scene, group)
    if len(damaged) or not np.all(whole_events(file)):
        what = f"{len(damaged)} of {frames} frames are damaged, first frame {damaged[0]}" if len(damaged) else ""
        raise InputError(
            f"{file.filename}: {what or 'an event is damaged'}; lampest check --repair keeps what is whole"
        )
    return slice(frames)


def damaged_frames(file: h5py.File, scene: Scene, group: str) -> tuple[int, NDArray[np.intp]]:
    """(frames written, numbers of the damaged ones) of an unfinished file."""
    paths = frame_paths(group.removeprefix("/entry/"), scene.circuit.signal)
    written = min(hdf5.length_of(file, f"/entry/{path}") for path in paths)
    checked = hdf5.has(file, f"/entry/{FRAME_CHECKSUM}")
    frames = hdf5.length_of(file, f"/entry/{FRAME_CHECKSUM}") if checked else written
    wrong: list[NDArray[np.intp]] = []
    for begin in range(0, min(frames, written), AT_ONCE):
        part = slice(begin, min(begin + AT_ONCE, frames, written))
        columns = stored_rows(file, paths, part)
        recorded, sums = columns[0], columns[SUMS]
        if sums.shape != recorded.shape or recorded.ndim != 3:
            raise InputError(f"{file.filename}: /entry/raw/sums has another shape than the frames")
        differs = np.any(_recorded(file, scene, sums) != recorded, axis=(1, 2))
        if checked:
            differs |= checksums(columns) != stored_rows(file, (FRAME_CHECKSUM,), part)[0]
        # Zero is what HDF5 returns for what was never written; a board's codes stand for the middle of their interval.
        elif len(unwritten := np.flatnonzero(np.any(recorded == 0, axis=(1, 2)))):
            frames = begin + int(unwritten[0])
            wrong.append(begin + np.flatnonzero(differs[: unwritten[0]]))
            break
        wrong.append(begin + np.flatnonzero(differs))
    return frames, np.concatenate([*wrong, np.arange(written, frames)])


def whole_events(file: h5py.File) -> NDArray[np.bool_]:
    """Which events are what was written; all, where there are no checksums."""
    events = min(
        hdf5.length_of(file, f"/entry/{path}") if hdf5.has(file, f"/entry/{path}") else 0 for path in EVENT_PATHS
    )
    if not hdf5.has(file, f"/entry/{EVENT_CHECKSUM}"):
        return np.ones(events, dtype=np.bool_)
    count = hdf5.length_of(file, f"/entry/{EVENT_CHECKSUM}")
    right = np.zeros(count, dtype=np.bool_)
    part = slice(min(events, count))
    right[part] = checksums(stored_rows(file, EVENT_PATHS, part)) == stored_rows(file, (EVENT_CHECKSUM,), part)[0]
    return right


def stored_rows(file: h5py.File, paths: Sequence[str], part: slice) -> list[NDArray[Any]]:
    """Some rows of datasets below /entry, as they stand in the file. Raises InputError where one cannot be read."""
    return [_rows(file, f"/entry/{path}", part) for path in paths]


def _rows(file: h5py.File, path: str, part: slice) -> NDArray[Any]:
    if path.endswith("label"):
        texts = hdf5.read_texts(file, path, part=part)
        return np.array([text.encode() for text in texts], dtype=f"S{LABEL_BYTES}")
    return np.asarray(hdf5.read_array(file, path, (1, 3), part=part))


def _recorded(file: h5py.File, scene: Scene, sums: NDArray[Any]) -> Array:
    readings = int(hdf5.read_number(file, "/entry/raw", "readings"))
    if scene.readout is None or readings < 1:
        raise InputError(f"{file.filename}: has no readout, and was never recorded from a board")
    return scene.readout.recorded_from_sums(sums, readings)
