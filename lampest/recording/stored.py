"""Recordings on disk that are read in parts, so that memory does not grow with the number of frames."""

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
from lampest.recording.recording import MEASURED, UNLOADED, Recording, recording_file

MAX_READINGS = 2_000_000  # readings of a recording in memory at once: 2 GB, because error bars take 1 kB for each
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
        """Return the stored recording of a file. Raises InputError if it is no recording, or its datasets disagree."""
        with recording_file(path) as (file, scene, group, signal):
            shape = hdf5.shape_of(file, f"{group}/{signal}")
            if not shape[0]:
                raise InputError(f"{path}: {group}/{signal} holds no frame")
            end = undamaged_frames(file, scene).stop
            for axis in (f"{group}/time", f"{group}/role") if end is None else ():
                if hdf5.has(file, axis) and hdf5.shape_of(file, axis) != shape[:1]:
                    raise InputError(f"{path}: {axis} does not have one value for each of the {shape[0]} frames")
        return cls(path, scene, shape[0] if end is None else end, Recording.load(path, slice(0, 1)).start_time)

    @property
    def name(self) -> str:
        """Name of the recording in results."""
        return self.path.stem

    @property
    def length(self) -> int:
        """Number of frames of a part."""
        return max(16, PART_READINGS // self.scene.panel.crossings)

    def blocks(self) -> tuple[range, ...]:
        """Return the ranges of frames that are estimated and written part by part.

        If possible, a part ends with a chunk of the measured frames in results.
        """
        return tuple(self._blocks)

    @property
    def measured_blocks(self) -> tuple[int, ...]:
        """Numbers of the blocks with measured frames."""
        return tuple(number for number, count in enumerate(self._blocks.values()) if count)

    @cached_property
    def _blocks(self) -> dict[range, int]:
        """Numbers of measured frames by block."""
        chunk, ends = max(1, hdf5.CHUNK // self.scene.panel.crossings), [0]
        with hdf5.existing_file(self.path) as file:
            path = f"/entry/{group_of(self.scene.circuit)}/role"
            known = hdf5.has(file, path)
            role = hdf5.read_array(file, path, 1, part=slice(0, self.frames)) if known else np.ones(self.frames)
        measured = np.cumsum(role == MEASURED)
        while ends[-1] < self.frames:
            first, end = ends[-1], min(ends[-1] + self.length, self.frames)
            full = np.flatnonzero((measured[first:end] % chunk == 0) & (role[first:end] == MEASURED))
            ends.append(first + int(full[-1]) + 1 if len(full) and end < self.frames else end)
        return {range(first, end): int((role[first:end] == MEASURED).sum()) for first, end in pairwise(ends)}

    def part(self, frames: range, beside: int = 0) -> Recording:
        """Return a range of frames with up to `beside` further ones on either side. Raises as `Recording.load`."""
        within = slice(max(frames.start - beside, 0), min(frames.stop + beside, self.frames))
        return replace(Recording.load(self.path, within), start_time=self.start_time)


def only_frames(recording: Recording, frames: NDArray[np.bool_]) -> Recording:
    """Return chosen frames of a part, boolean (frames,), without acquisition data and raw sums."""
    return _each_frame((recording,), frames)


def of_parts(parts: Sequence[Recording]) -> Recording:
    """Return overlapping parts of a recording as one, each frame once, without acquisition data and raw sums."""
    numbers = np.concatenate([part.number for part in parts if part.number is not None])
    return _each_frame(parts, np.unique(numbers, return_index=True)[1])


def _each_frame(parts: Sequence[Recording], chosen: NDArray[Any]) -> Recording:
    """Return the chosen frames (indices or mask) of concatenated parts, without acquisition data and raw sums."""
    first = parts[0]
    names = ["recorded", "time", "role", "number", "truth_cell_resistance", "truth_pressure"]
    names += ["sigma"] if first.sigma is not None and first.sigma.ndim == 3 else []
    present = [name for name in names if getattr(first, name) is not None]
    each: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts])[chosen] for name in present}
    return replace(first, **each, raw_sums=None, raw_readings=None, acquisition=None)


def first_unloaded(stored: StoredRecording, most: int) -> Recording | None:
    """Return at most `most` unloaded frames from the beginning of a recording; None if there is none."""
    chosen: list[Recording] = []
    for frames in stored.blocks():
        part = stored.part(frames)
        resting = part.role == UNLOADED
        resting &= np.cumsum(resting) <= most
        most -= int(resting.sum())
        chosen += [only_frames(part, resting)] if resting.any() else []
        if not most:
            break
    return of_parts(chosen) if chosen else None


def measured_part(stored: StoredRecording, frames: range, beside: int) -> Recording | None:
    """Return the measured frames of a range, and of `beside` frames on either side; None if the range has none."""
    part = stored.part(frames, beside)
    assert part.number is not None
    measured = part.role == MEASURED
    inside = (part.number >= frames.start) & (part.number < frames.stop)
    return only_frames(part, measured) if np.any(measured & inside) else None


def save_parts(path: Path, parts: Iterable[Recording]) -> None:
    """Write a recording from its parts, completely or not at all.

    Until all parts exist they are files in a temporary folder next to it. Raises InputError if it cannot be written.
    """
    files: list[Path] = []
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
    """Return the recording of a file, as parts if it is too long for memory. Raises InputError as `Recording.load`."""
    with recording_file(path) as (file, _, group, signal):
        readings = prod(hdf5.shape_of(file, f"{group}/{signal}"))
    return StoredRecording.of(path) if readings > MAX_READINGS else Recording.load(path)
