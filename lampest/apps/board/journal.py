"""Journals: recordings that grow frame by frame, and their rewriting as finished recordings.

A journal has the layout of a recording. Other processes can read it meanwhile (single writer,
multiple readers, SWMR), and flushed frames remain readable after a crash. `finished` rewrites a
journal with the noise and σ of every reading; `repair` does so for one that was left behind.
"""

import contextlib
import dataclasses
import secrets
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from lampest.apps.board.protocol import MAX_CODE
from lampest.apps.board.stream import Sample
from lampest.files import hdf5
from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.files.process import deaf
from lampest.files.whole import check_output, folder_beside, is_locked, locked, own, sync_folder
from lampest.panel.readouts.converter import MIN_REPEATS
from lampest.panel.scene import Scene
from lampest.recording.acquisition import EVENTS, FORMAT, SALT, Rows, blocks, group_of
from lampest.recording.file import recording_file
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.stored import StoredRecording, save_parts


@dataclass(frozen=True)
class Journal:
    """Open, growing recording file.

    Attributes
    ----------
    file : h5py.File
    scene : Scene
    """

    file: h5py.File
    scene: Scene

    @classmethod
    @contextlib.contextmanager
    def create(
        cls, path: Path, scene: Scene, readings: int, *, estimates: bool = False
    ) -> Iterator["Journal"]:
        """Create and yield a journal, also of a board's `estimates`.

        Raises InputError if the file cannot be created, or exists.
        """
        check_output(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = h5py.File(path, "x", libver=("v110", "v110"))
        except OSError as error:
            raise InputError(f"{path}: cannot be made ({error.strerror or error})") from error
        with file:
            _lay_out(file, scene, readings, Rows.of_frames(scene.circuit, estimates=estimates))
            file.flush()
            sync_folder(path.parent)
            file.swmr_mode = True
            with locked(path):  # HDF5's own lock ended where SWMR began
                yield cls(file, scene)

    def append(
        self, samples: Sequence[Sample], unloaded: int, keys: Callable[[], str] = lambda: ""
    ) -> None:
        """Append and flush samples with their events, and the pressed keys as events.

        Raises InputError if it fails. The first `unloaded` samples are unloaded.
        """
        rows = Rows.of_file(self.file, self.scene.circuit)
        unknown = np.full(self.scene.panel.shape, np.nan)
        fields = [
            vars(sample.frame)
            | vars(sample)
            | {
                "recorded": sample.recorded,
                "role": UNLOADED if number < unloaded else MEASURED,
                "log_change": unknown
                if sample.frame.log_change is None
                else sample.frame.log_change,
            }
            for number, sample in enumerate(samples)
        ]
        names = ["recorded", *(path.split("/")[-1] for path, *_ in rows.datasets[1:])]
        rows.append(self.file, [[field[name] for field in fields] for name in names])
        for sample in samples:
            for event in (*sample.events, *keys()):
                self.mark(sample.time, event)

    def mark(self, time: float, label: str) -> None:
        """Append an event; its label is cut to 16 characters."""
        EVENTS.append(self.file, ([time], [hdf5.ascii_array(label)]))

    def keep(self, source: h5py.File) -> None:
        """Append the undamaged frames and events of another journal.

        Damaged frames count as lost before the next.
        """
        for rows in (Rows.of_file(self.file, self.scene.circuit), EVENTS):
            intact = np.flatnonzero(rows.undamaged(source))
            dropped = np.diff(intact, prepend=-1) - 1
            for part in blocks(len(intact), self.scene.panel.crossings):
                first, last = intact[part][[0, -1]].tolist()
                values = [
                    column[intact[part] - first]
                    for column in rows.stored(source, slice(first, last + 1))
                ]
                for number, (path, *_) in enumerate(rows.datasets):
                    if path == "acquisition/lost":
                        values[number] = values[number] + dropped[part]
                rows.append(self.file, values)


def _lay_out(file: h5py.File, scene: Scene, readings: int, frame_rows: Rows) -> None:
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
        cells = (
            scene.panel.shape
            if path.endswith((f"/{circuit.signal}", "/sums", "/log_change"))
            else ()
        )
        chunk = (16 if cells else 1024, *cells)  # a chunk is written anew with every frame
        dataset = entry.create_dataset(
            path, (0, *cells), kind, maxshape=(None, *cells), chunks=chunk
        )
        hdf5.set_attributes(dataset, units=units, long_name=long_name)
    for rows in series:
        hdf5.set_attributes(entry[rows.checksum[0]], **{SALT: salt})
    hdf5.set_attributes(
        file,
        NX_class="NXroot",
        default="entry",
        lampest_format=FORMAT,
        lampest_unfinished=np.uint8(1),
    )
    hdf5.set_attributes(entry, NX_class="NXentry", default=frames)
    hdf5.set_attributes(
        entry[frames], NX_class="NXdata", signal=circuit.signal, axes=["time", "row", "column"]
    )
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
        with recording_file(path) as (file, scene, _, _):
            rows = Rows.of_file(file, scene.circuit)
            intact = rows.undamaged(file)
            if len(intact) and not intact.any():
                raise InputError(f"{path}: every frame is damaged")
            readings = int(hdf5.read_number(file, "/entry/raw", "readings"))
            estimates = rows != Rows.of_frames(scene.circuit)
            with Journal.create(
                folder / path.name, scene, readings, estimates=estimates
            ) as journal:
                journal.keep(file)
        return finished(path, folder / path.name)[1], int(np.sum(~intact))


def finished(path: Path, journal: Path | None = None) -> tuple[Scene, int, float | None]:
    """Rewrite the journal at `path`, or another one, as a recording at `path`.

    Return scene, frames and noise.
    """
    own(path)
    with deaf():
        recording = StoredRecording.of(journal or path)
        overlapping = (range(max(part.start - 1, 0), part.stop) for part in recording.blocks)
        noise = noise_from_repeats(recording.part(part) for part in overlapping)
        save_parts(path, (_with_sigma(recording.part(part), noise) for part in recording.blocks))
        return recording.scene, recording.frames, noise


def _with_sigma(recording: Recording, noise: float | None) -> Recording:
    """Return the recording with σ of every reading.

    It is by the noise of its repeats in LSB if it is known.
    """
    readout = recording.scene.readout
    if readout is None or recording.scene.panel.modules is not None:  # whose modules have their own
        return recording
    readout = readout if noise is None else dataclasses.replace(readout, noise_lsb=noise)
    return dataclasses.replace(recording, sigma=readout.sigma(recording.recorded))


def noise_from_repeats(parts: Iterable[Recording]) -> float | None:
    """Return the noise of a reading in LSB from differences of successive unloaded codes.

    None below MIN_REPEATS.
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
    return readout.noise_of_variance(total / count / 2)
