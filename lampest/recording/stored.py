"""Recordings that are too long for memory: files that are read, estimated and written part by part.

A recording of more than MAX_READINGS readings stays in its file. Its parts have PART_READINGS
readings each, and end, where possible, with a chunk of the results.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.parts import join_parts
from lampest.files.whole import folder_beside
from lampest.panel.scene import Scene
from lampest.recording.acquisition import group_of, undamaged_frames
from lampest.recording.file import recording_file
from lampest.recording.recording import MEASURED, UNLOADED, Recording

# Readings of a recording in memory at once: 2 GB, because error bars take 1 kB for each.
MAX_READINGS = 2_000_000
PART_READINGS = 500_000  # readings of a part of a longer recording


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """Recording file that is read in parts.

    Attributes
    ----------
    path : Path
    scene : Scene
    frames : int
        Number of frames.
    start_time : str or None
        See `Recording`.
    """

    path: Path
    scene: Scene
    frames: int
    start_time: str | None

    @classmethod
    def of(cls, path: Path) -> "StoredRecording":
        """Return the stored recording of a file.

        Raises InputError if it is no recording, or its datasets disagree.
        """
        with recording_file(path) as (file, scene, readings):
            shape = hdf5.shape_of(file, readings)
            if not shape[0]:
                raise InputError(f"{path}: {readings} holds no frame")
            group = f"/entry/{group_of(scene.circuit)}"
            end = undamaged_frames(file, scene).stop
            for axis in (f"{group}/time", f"{group}/role") if end is None else ():
                if hdf5.has(file, axis) and hdf5.shape_of(file, axis) != shape[:1]:
                    raise InputError(
                        f"{path}: {axis} does not have one value for each of the {shape[0]} frames"
                    )
        start_time = Recording.load(path, slice(0, 1)).start_time
        return cls(path, scene, shape[0] if end is None else end, start_time)

    @property
    def name(self) -> str:
        """Name of the recording in results."""
        return self.path.stem

    @property
    def length(self) -> int:
        """Number of frames of a part."""
        return max(16, PART_READINGS // self.scene.panel.crossings)

    @cached_property
    def role(self) -> NDArray[Any]:
        """Roles of the frames; measured where the file has none."""
        with hdf5.existing_file(self.path) as file:
            path = f"/entry/{group_of(self.scene.circuit)}/role"
            if hdf5.has(file, path):
                return np.asarray(hdf5.read_array(file, path, 1, part=slice(0, self.frames)))
        return np.ones(self.frames)

    @cached_property
    def blocks(self) -> tuple[range, ...]:
        """Ranges of frames that are estimated and written part by part.

        If possible, a part ends with a chunk of the measured frames in results.
        """
        chunk = max(1, hdf5.CHUNK // self.scene.panel.crossings)
        ends = [0]
        measured = self.role == MEASURED
        full = measured & (np.cumsum(measured) % chunk == 0)
        while ends[-1] < self.frames:
            end = min(ends[-1] + self.length, self.frames)
            last = np.flatnonzero(full[ends[-1] : end])
            ends.append(ends[-1] + int(last[-1]) + 1 if len(last) and end < self.frames else end)
        return tuple(range(first, end) for first, end in pairwise(ends))

    @property
    def measured_blocks(self) -> tuple[int, ...]:
        """Numbers of the blocks with measured frames."""
        return tuple(n for n, part in enumerate(self.blocks) if MEASURED in self.role[part])

    def part(self, frames: range, beside: int = 0) -> Recording:
        """Return a range of frames with up to `beside` further ones on either side.

        Raises as `Recording.load`.
        """
        within = slice(max(frames.start - beside, 0), min(frames.stop + beside, self.frames))
        return replace(Recording.load(self.path, within), start_time=self.start_time)


def joined(parts: Sequence[Recording], chosen: NDArray[Any] | None = None) -> Recording:
    """Return the frames of concatenated parts, without acquisition data and raw sums.

    `chosen` are their indices or a mask; None: each numbered frame of overlapping parts once.
    """
    first = parts[0]
    truths = ["truth_cell_resistance", "truth_pressure"]
    names = ["recorded", "time", "role", "number", "board_log_change", *truths]
    names += ["sigma"] if first.sigma is not None and first.sigma.ndim == 3 else []
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in names
        if getattr(first, name) is not None
    }
    frames = np.unique(columns["number"], return_index=True)[1] if chosen is None else chosen
    chosen_of_each = {name: values[frames] for name, values in columns.items()}
    return replace(first, **chosen_of_each, raw_sums=None, raw_readings=None, acquisition=None)


def first_unloaded(stored: StoredRecording, most: int) -> Recording | None:
    """Return at most `most` unloaded frames from the beginning of a recording, or None."""
    numbers = np.flatnonzero(stored.role == UNLOADED)[:most]
    parts = (stored.part(frames) for frames in stored.blocks if np.isin(numbers, frames).any())
    chosen = [
        joined((part,), np.isin(part.number, numbers)) for part in parts if part.number is not None
    ]
    return joined(chosen) if chosen else None


def measured_part(stored: StoredRecording, frames: range, beside: int) -> Recording | None:
    """Return the measured frames of a range, and of `beside` frames on either side, or None.

    The function returns None if no frame of the range is measured.
    """
    part = stored.part(frames, beside)
    assert part.number is not None
    measured = part.role == MEASURED
    inside = (part.number >= frames.start) & (part.number < frames.stop)
    return joined((part,), measured) if np.any(measured & inside) else None


def save_parts(path: Path, parts: Iterable[Recording]) -> None:
    """Write a recording from its parts, completely or not at all.

    Parts are files in a temporary folder next to the recording until all of them exist. Raises
    InputError if the recording cannot be written.
    """
    files = []
    with folder_beside(path) as folder:
        for number, part in enumerate(parts):
            files.append(folder / f"{number}.h5")
            part.save(files[-1])
        with hdf5.new_large_file(path, sum(file.stat().st_size for file in files)) as file:
            join_parts(files, file.create_group("entry"), "/entry")
            with hdf5.existing_file(files[0]) as first:
                file.attrs.update(first.attrs)


def too_long(frames: int, cells: int) -> bool:
    """Return whether a recording of this many frames and cells is too large for memory."""
    return frames * cells > MAX_READINGS


def opened(path: Path) -> Recording | StoredRecording:
    """Return the recording of a file, as parts if it is too long for memory.

    Raises InputError as `Recording.load`.
    """
    with recording_file(path) as (file, _, readings):
        number = prod(hdf5.shape_of(file, readings))
    return StoredRecording.of(path) if number > MAX_READINGS else Recording.load(path)
