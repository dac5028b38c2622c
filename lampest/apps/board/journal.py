"""Journals: recordings that grow frame by frame, and their rewriting as finished recordings.

A journal has the layout of a recording. Other processes can read it meanwhile (single writer,
multiple readers, SWMR), and flushed frames remain readable after a crash. `finished` rewrites a
journal with the noise and σ of every reading; `repair` does so for one that was left behind.
"""

import contextlib
import dataclasses
import errno
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import prod
from pathlib import Path

import h5py
import numpy as np

from lampest.apps.board.protocol import MAX_CODE
from lampest.apps.board.sample import Sample
from lampest.files import hdf5
from lampest.files.document import to_yaml
from lampest.files.errors import InputError, counted
from lampest.files.patient import PatientFile
from lampest.files.process import deaf, delayed_interrupt
from lampest.files.whole import check_output, folder_beside, is_locked, locked, own, sync_folder
from lampest.panel.readouts.converter import MIN_REPEATS, noise_of_variance
from lampest.panel.scene import Scene
from lampest.recording.acquisition import EVENTS, FILE_ATTRIBUTES, SALT, Rows, blocks, group_of
from lampest.recording.file import read_raw_readings, recording_file
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.stored import StoredRecording, save_parts

SWMR_FORMAT = ("v110", "v110")  # the first format that other programs may read as it grows
PATIENCE_SECONDS = 10.0  # s for which samples wait for a disk that takes none (tests/attack)
ADDRESS_BYTES = 16_384  # of a block of chunk addresses: that of 500,000 chunks has 8,200
NO_SPACE = "no space"  # labels of events
DISK_ERROR = "disk error"


class UnwrittenError(InputError):
    """The disk takes no more frames, or the file of a growing recording is gone."""


@dataclass(eq=False)
class Journal:
    """Open, growing recording file.

    HDF5 is used only while the disk has room for what it will write. Samples wait meanwhile, and
    are tried again with each further one.

    Attributes
    ----------
    file : h5py.File
    scene : Scene
    storage : PatientFile
    frames : int
        Number of frames that the disk has.
    until, last_time : float
        Arrival of the newest sample that HDF5 has in s since 1970-01-01 UTC, and its time in s.
    waiting : list
        Samples that the disk does not have yet, each with its role.
    given : int
        Number of samples that HDF5 has written and the disk has not.
    refused_since : float or None
        Time of the first refusal of the disk in s, on a clock that is never set; None without one.
    events : list
        Times in s and labels of events that are not in the file yet.
    """

    file: h5py.File
    scene: Scene
    storage: PatientFile
    frames: int = 0
    until: float = 0.0
    last_time: float = 0.0
    waiting: list[tuple[Sample, int]] = field(default_factory=list)
    given: int = 0
    refused_since: float | None = None
    events: list[tuple[float, str]] = field(default_factory=list)

    @classmethod
    @contextlib.contextmanager
    def create(
        cls, path: Path, scene: Scene, readings: int | None, *, estimates: bool = False
    ) -> Iterator["Journal"]:
        """Create and yield a journal, also of a board's `estimates`.

        `readings` are the codes of a sum; None for a board that sends no sums.

        Raises InputError if the file cannot be created, or exists. Raises UnwrittenError at the
        end if the disk did not take all frames.
        """
        check_output(path)
        rows = Rows.of_frames(scene.circuit, sums=readings is not None, estimates=estimates)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            storage = PatientFile(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be made ({error.strerror or error})") from error
        with contextlib.ExitStack() as stack:
            stack.callback(_close, storage)
            if not storage.reserve(_most_bytes(rows, scene, 1)):
                path.unlink()
                raise InputError(f"{path}: cannot be made ({_reason(storage)})")
            with delayed_interrupt():
                file = stack.enter_context(h5py.File(storage, "w", libver=SWMR_FORMAT))
                _lay_out(file, scene, readings, rows)
                file.flush()
                sync_folder(path.parent)
                file.swmr_mode = True
            stack.enter_context(locked(path))  # HDF5's own lock ended where SWMR began
            journal = cls(file, scene, storage)
            yield journal
            journal.write_waiting()
            if journal.pending:
                raise UnwrittenError(journal.trouble)

    @property
    def pending(self) -> int:
        """Number of samples that the disk does not have yet."""
        return len(self.waiting) + self.given

    @property
    def trouble(self) -> str:
        """Sentence on the frames that the disk has, while others wait for it; '' without these."""
        if not self.pending:
            return ""
        clock = time.strftime("%H:%M:%S", time.localtime(self.until))
        kept = f"{counted(self.frames, 'frame')} kept until {clock}" if self.frames else "no frame"
        return f"{_refusal(self.storage)}: {kept} ({_reason(self.storage)})"

    def append(
        self, samples: Sequence[Sample], unloaded: int, keys: Callable[[], str] = lambda: ""
    ) -> None:
        """Append and flush samples with their events, and the pressed keys as events.

        The first `unloaded` samples are unloaded. Samples that the disk does not take wait for the
        next call. Raises UnwrittenError if it takes none for PATIENCE_SECONDS, or if the file has
        lost its name.
        """
        for number, sample in enumerate(samples):
            role = UNLOADED if number < unloaded else MEASURED
            self.waiting.append((sample, role))
            self.events += [(sample.time, label) for label in (*sample.events, *keys())]
        if not self.storage.in_place:
            raise UnwrittenError(
                f"{self.storage!r}: was removed or renamed while it was recorded; "
                f"{counted(self.frames, 'frame')} went with it"
            )
        self.write_waiting()
        since = self.refused_since
        if since is not None and time.monotonic() - since > PATIENCE_SECONDS:
            raise UnwrittenError(self.trouble)

    def write_waiting(self) -> None:
        """Write the waiting samples and events if the disk has room for them."""
        rows = Rows.of_file(self.file, self.scene.circuit)
        room = self.storage.reserve(_most_bytes(rows, self.scene, len(self.waiting)))
        if self.pending and not room and self.refused_since is None:
            self.refused_since = time.monotonic()
            self.events.append((self.last_time, _refusal(self.storage)))
        if not self.storage.flushed():
            return
        self.frames += self.given
        self.given = 0
        with delayed_interrupt():  # a signal's exception must not pass through HDF5
            if self.waiting and room:
                unknown = np.full(self.scene.panel.shape, np.nan)
                columns = [
                    {"log_change": unknown}
                    | {name: held for name, held in vars(sample.frame).items() if held is not None}
                    | vars(sample)
                    | {"recorded": sample.recorded, "role": role}
                    for sample, role in self.waiting
                ]
                names = ["recorded", *(path.split("/")[-1] for path, *_ in rows.datasets[1:])]
                rows.append(self.file, [[column[name] for column in columns] for name in names])
                last, _ = self.waiting[-1]
                self.until = last.host_time
                self.last_time = last.time
                self.given = len(self.waiting)
                self.waiting.clear()
            for moment, label in self.events:
                EVENTS.append(self.file, ([moment], [hdf5.ascii_array(label)]))
        self.events.clear()
        if self.storage.flushed():
            self.frames += self.given
            self.given = 0
            self.refused_since = self.refused_since if self.waiting else None

    def mark(self, moment: float, label: str) -> None:
        """Append an event; its label is cut to 16 characters."""
        self.events.append((moment, label))
        self.write_waiting()

    def keep(self, source: h5py.File) -> None:
        """Append the undamaged frames and events of another journal.

        Damaged frames count as lost before the next.
        """
        for rows in (Rows.of_file(self.file, self.scene.circuit), EVENTS):
            intact = np.flatnonzero(rows.undamaged(source))
            dropped = np.diff(intact, prepend=-1) - 1
            for part in blocks(len(intact), self.scene.panel.crossings):
                count = part.stop - part.start
                if not self.storage.reserve(_most_bytes(rows, self.scene, count)):
                    raise UnwrittenError(
                        f"{self.storage!r}: cannot be written ({_reason(self.storage)})"
                    )
                first, last = intact[part][[0, -1]].tolist()
                values = [
                    column[intact[part] - first]
                    for column in rows.stored(source, slice(first, last + 1))
                ]
                for number, (path, *_) in enumerate(rows.datasets):
                    if path == "acquisition/lost":
                        values[number] = values[number] + dropped[part]
                rows.append(self.file, values)


def _close(storage: PatientFile) -> None:
    """Close a file; bytes that the disk still refuses are those behind its undamaged frames."""
    with contextlib.suppress(OSError):
        storage.close()


def _reason(storage: PatientFile) -> str:
    """Return the disk's own words on its refusal."""
    error = storage.trouble
    return "it was written at last" if error is None else error.strerror or str(error)


def _refusal(storage: PatientFile) -> str:
    """Return the label of an event about a refusal."""
    full = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    return NO_SPACE if getattr(storage.trouble, "errno", None) in full else DISK_ERROR


def _most_bytes(rows: Rows, scene: Scene, frames: int) -> int:
    """Return the most bytes that a number of further frames take, with their events.

    Each dataset begins one chunk more than it fills, and a block of their addresses.
    """
    total = 0
    for series in (rows, EVENTS):
        for path, kind, *_ in (*series.datasets, series.checksum):
            length, *cells = _chunk(path, scene)
            begun = frames // length + 2
            total += begun * length * prod(cells) * np.dtype(kind).itemsize + ADDRESS_BYTES
    return total


def _chunk(path: str, scene: Scene) -> tuple[int, ...]:
    """Return the shape of a chunk of a journal's dataset, which is written with every frame."""
    with_cells = path.endswith((f"/{scene.circuit.signal}", "/sums", "/log_change"))
    return (16, *scene.panel.shape) if with_cells else (1024,)


def _lay_out(file: h5py.File, scene: Scene, readings: int | None, frame_rows: Rows) -> None:
    """Create the groups, datasets and attributes of a journal."""
    circuit = scene.circuit
    frames = group_of(scene.circuit)
    entry = file.create_group("entry")
    hdf5.write_text(entry, "scene", to_yaml(scene))
    series = (frame_rows, EVENTS)
    salt = secrets.token_hex(16)
    for path, kind, units, long_name in (
        dataset for rows in series for dataset in (*rows.datasets, rows.checksum)
    ):
        chunk = _chunk(path, scene)
        cells = chunk[1:]
        dataset = entry.create_dataset(
            path, (0, *cells), kind, maxshape=(None, *cells), chunks=chunk
        )
        hdf5.set_attributes(dataset, units=units, long_name=long_name)
    for rows in series:
        hdf5.set_attributes(entry[rows.checksum[0]], **{SALT: salt})
    hdf5.set_attributes(file, **FILE_ATTRIBUTES, lampest_unfinished=np.uint8(1))
    hdf5.set_attributes(entry, NX_class="NXentry", default=frames)
    hdf5.set_attributes(
        entry[frames], NX_class="NXdata", signal=circuit.signal, axes=["time", "row", "column"]
    )
    if readings is not None:
        hdf5.set_attributes(
            entry["raw"], NX_class="NXdata", signal="sums", readings=np.uint16(readings)
        )
    hdf5.set_attributes(entry["acquisition"], NX_class="NXcollection")


def journal_for(sample: Sample, path: Path) -> contextlib.AbstractContextManager[Journal]:
    """Return a journal for the frames of a board, from its first sample.

    Raises InputError if the file exists.
    """
    return Journal.create(
        path, sample.scene, sample.hello.readings, estimates=sample.hello.estimates
    )


def repair(path: Path) -> tuple[int, int]:
    """Rewrite an unfinished recording as a finished one, with σ of every reading.

    Finished ones remain unchanged. Returns the numbers of frames and of damaged frames, which are
    removed and count as lost. Raises InputError if nothing can be read, or if the file is still
    being recorded.
    """
    own(path)
    with hdf5.existing_file(path) as file:
        closed = "lampest_unfinished" not in file.attrs
    if closed:
        return StoredRecording.of(path).frames, 0
    if is_locked(path):
        raise InputError(f"{path}: still being recorded")
    with folder_beside(path) as folder:
        with recording_file(path) as (file, scene, _):
            rows = Rows.of_file(file, scene.circuit)
            intact = rows.undamaged(file)
            if len(intact) and not intact.any():
                raise InputError(f"{path}: every frame is damaged")
            readings = read_raw_readings(file) if rows.sums else None
            with Journal.create(
                folder / path.name, scene, readings, estimates=rows.estimates
            ) as journal:
                journal.keep(file)
        return finished(path, folder / path.name)[1], int(np.sum(~intact))


def finished(path: Path, journal: Path | None = None) -> tuple[Scene, int, float | None]:
    """Rewrite the journal at `path`, or another one, as a recording at `path`.

    Raises InputError without room for the rewriting: the file at `path` is unchanged then, and can
    be repaired later.

    Returns
    -------
    scene : Scene
    frames : int
        Number of frames.
    noise : float or None
        Noise of one reading from repeats in LSB, if these determine it.
    """
    own(path)
    with deaf():
        recording = StoredRecording.of(journal or path)
        overlapping = (range(max(part.start - 1, 0), part.stop) for part in recording.blocks)
        noise = noise_from_repeats(recording.part(part) for part in overlapping)
        parts = (_with_sigma(recording.part(part), noise) for part in recording.blocks)
        try:
            save_parts(path, parts)
        except InputError as error:
            cause = error.__cause__
            reason = cause.strerror if isinstance(cause, OSError) else None
            raise InputError(
                f"{path}: {counted(recording.frames, 'frame')} kept, but "
                f"the file cannot be completed ({reason or str(error).removeprefix(f'{path}: ')}); "
                f"lampest check --repair {path} completes it once there is room"
            ) from error
        return recording.scene, recording.frames, noise


def _with_sigma(recording: Recording, noise: float | None) -> Recording:
    """Return the recording with σ of every reading.

    The noise of repeats in LSB determines σ if it is known, otherwise the readout's.
    """
    readout = recording.scene.readout
    if readout is None or recording.scene.panel.modules is not None:  # whose modules have their own
        return recording
    readout = readout if noise is None else dataclasses.replace(readout, noise_lsb=noise)
    return dataclasses.replace(recording, sigma=readout.sigma(recording.recorded))


def noise_from_repeats(parts: Iterable[Recording]) -> float | None:
    """Return the noise of a reading in LSB from differences of successive unloaded codes.

    The result is None below MIN_REPEATS.
    """
    total = 0.0
    count = 0
    readout = None
    for part in parts:
        readout = part.scene.readout
        sums = part.raw_sums
        if readout is None or sums is None or part.raw_readings is None:
            return None
        mean_code = sums / part.raw_readings
        pairs = (part.role[1:] == UNLOADED) & (part.role[:-1] == UNLOADED)
        if part.acquisition is not None:
            pairs &= np.diff(part.acquisition.session.astype(int)) == 0
        # Codes near the rails are excluded: their noise is clipped.
        inside = (mean_code > 2) & (mean_code < MAX_CODE - 2)
        difference = np.diff(mean_code, axis=0)[(inside[1:] & inside[:-1]) & pairs[:, None, None]]
        total = total + float(np.sum(difference**2))
        count = count + len(difference)
    if readout is None or count < MIN_REPEATS:
        return None
    # The variance of a difference of two readings is twice that of one.
    return noise_of_variance(readout, total / count / 2)
