"""Journal: file of a running recording, to which frames are appended.

It has the layout of a recording. Other processes can read it meanwhile (single writer, multiple readers, SWMR), and
flushed frames remain readable after a crash.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.files.whole import check_output, locked
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording import acquisition
from lampest.recording.acquisition import group_of
from lampest.recording.board.stream import Sample
from lampest.recording.recording import FORMAT, MEASURED, UNLOADED


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

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths of the datasets with a row for every frame."""
        return tuple(path for path, *_ in acquisition.growing(self.scene.circuit))

    @classmethod
    @contextmanager
    def create(cls, path: Path, scene: Scene, readings: int) -> Iterator["Journal"]:
        """Create and yield a journal. Raises InputError if the file cannot be created, or exists."""
        check_output(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = h5py.File(path, "x", libver=("v110", "v110"))
        except OSError as error:
            raise InputError(f"{path}: cannot be made ({error.strerror or error})") from error
        with file:
            _lay_out(file, scene, readings)
            file.flush()
            file.swmr_mode = True
            with locked(path):  # HDF5's own lock ended where SWMR began
                yield cls(file, scene)

    def append(self, samples: Sequence[Sample], unloaded: int, keys: Callable[[], str] = lambda: "") -> None:
        """Append and flush samples with their events, and the pressed keys as events. Raises InputError if it fails.

        The first `unloaded` samples are unloaded.
        """
        fields = [vars(sample.frame) | vars(sample) | {"recorded": sample.recorded} for sample in samples]
        names = ("recorded", "time", "sums", *(name for name, *_ in acquisition.FRAME_FIELDS))
        recorded, time, sums, *acquired = ([field[name] for field in fields] for name in names)
        roles = [UNLOADED if number < unloaded else MEASURED for number in range(len(samples))]
        self._push(self.paths, (recorded, time, roles, sums, *acquired), acquisition.FRAME_CHECKSUM)
        for sample in samples:
            for event in (*sample.events, *keys()):
                self.mark(sample.time, event)

    def mark(self, time: float, label: str) -> None:
        """Append an event; its label is cut to 16 characters."""
        self._push(acquisition.EVENT_PATHS, ([time], [hdf5.ascii_array(label)]), acquisition.EVENT_CHECKSUM)

    def keep(self, source: h5py.File, damaged: NDArray[np.intp], frames: int) -> None:
        """Append the undamaged frames and events of another journal; damaged frames count as lost before the next."""
        whole, lost = np.setdiff1d(np.arange(frames), damaged), self.paths.index("acquisition/lost")
        dropped = np.diff(whole, prepend=-1) - 1
        for part in acquisition.blocks(len(whole), int(np.prod(self.file["entry/raw/sums"].shape[1:]))):
            numbers = whole[part]
            rows = acquisition.stored_rows(source, self.paths, slice(int(numbers[0]), int(numbers[-1]) + 1))
            values = [column[numbers - numbers[0]] for column in rows]
            values[lost] = values[lost] + dropped[part]
            self._push(self.paths, values, acquisition.FRAME_CHECKSUM)
        events = acquisition.whole_events(source)
        rows = acquisition.stored_rows(source, acquisition.EVENT_PATHS, slice(len(events)))
        self._push(acquisition.EVENT_PATHS, [column[events] for column in rows], acquisition.EVENT_CHECKSUM)

    def _push(self, paths: Sequence[str], values: Sequence[Sequence[Any] | Array], checksum: str) -> None:
        """Append rows, and then their checksums, once the rows are in the file."""
        try:
            columns = [self._extend(path, value) for path, value in zip(paths, values, strict=True)]
            self.file.flush()
            self._extend(checksum, acquisition.checksums(columns))
            self.file[f"entry/{checksum}"].flush()
        except (OSError, RuntimeError) as error:
            raise InputError(f"{self.file.filename}: cannot be written ({' '.join(str(error).split())})") from error

    def _extend(self, path: str, values: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
        """Append values in the dataset's type, integers clipped to its maximum, and return them."""
        dataset = self.file[f"entry/{path}"]
        if dataset.dtype.kind == "u":
            values = np.minimum(np.asarray(values, np.uint64), np.iinfo(dataset.dtype).max)
        column, length = np.asarray(values, dataset.dtype), dataset.shape[0]
        dataset.resize(length + len(column), axis=0)
        dataset[length:] = column
        return column


def _lay_out(file: h5py.File, scene: Scene, readings: int) -> None:
    """Create the groups, datasets and attributes of a journal."""
    circuit, frames, time, label = scene.circuit, group_of(scene.circuit), *acquisition.EVENT_PATHS
    growing = (
        *acquisition.growing(circuit),
        (acquisition.FRAME_CHECKSUM, "u4", "1", "CRC-32 of all that belongs to the frame"),
        (acquisition.EVENT_CHECKSUM, "u4", "1", "CRC-32 of all that belongs to the event"),
        (time, "f8", "s", "time of the event"),
        (label, acquisition.LABEL, "1", "label of the event"),
    )
    entry = file.create_group("entry")
    hdf5.write_text(entry, "scene", to_yaml(scene))
    for path, kind, units, long_name in growing:
        cells = scene.panel.shape if path.endswith((f"/{circuit.signal}", "/sums")) else ()
        chunk = (16 if cells else 1024, *cells)  # a chunk is written anew with every frame
        dataset = entry.create_dataset(path, (0, *cells), kind, maxshape=(None, *cells), chunks=chunk)
        hdf5.set_attributes(dataset, units=units, long_name=long_name)
    hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT, lampest_unfinished=np.uint8(1))
    hdf5.set_attributes(entry, NX_class="NXentry", default=frames)
    hdf5.set_attributes(entry[frames], NX_class="NXdata", signal=circuit.signal, axes=["time", "row", "column"])
    hdf5.set_attributes(entry["raw"], NX_class="NXdata", signal="sums", readings=np.uint16(readings))
    hdf5.set_attributes(entry["acquisition"], NX_class="NXcollection")
