"""Datasets of a recording, and acquisition data of a board.

The acquisition data are clocks, frame numbers, gaps, events, checksums. A recorder appends rows to
the datasets and then the checksum of each row, until it closes the file (`Rows`). As in write-ahead
logs, a salt of the recording and the number of the row enter each checksum: rows of another
recording, or of another place, do not fit.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from math import prod
from typing import Any, NamedTuple
from zlib import crc32

import h5py
import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.typed import Validated
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene

# Attribute of a file: voltage of code c in steps, less c. Files of versions 0.1 and 0.2 lack it:
# they hold the middle of codes, c + ½ steps.
CODE_OFFSET = "code_offset_steps"
FORMER_OFFSET = 0.5
FILE_ATTRIBUTES = {
    "NX_class": "NXroot",
    "default": "entry",
    "lampest_format": "recording/1",
    CODE_OFFSET: 0.0,
}
PATH = "/entry/acquisition"
SUMS = "raw/sums"
ESTIMATES = "board/log_change"
COUNTER = 2**32  # period of a board's counters and clocks, such as millis() and micros()
# Fields of every frame: name, type, units, long name.
FRAME_FIELDS = (
    ("host_time", "f8", "s", "host clock when the frame arrived, since 1970-01-01 UTC"),
    ("device_ms", "u4", "ms", "board clock at the start of the scan"),
    ("sequence", "u4", "1", "number of the frame since the board was started"),
    ("missed", "u2", "1", "scans that the board could not begin in time before this one"),
    ("lost", "u4", "1", "frames that are missing before this one"),
    (
        "session",
        "u2",
        "1",
        "grows by one where the board was unplugged or restarted before the frame",
    ),
)

SALT = "salt"  # attribute of a dataset of checksums; files of older versions have none
LABEL = "S16"  # type of an event's label
Dataset = tuple[str, str, str, str]  # path below /entry, type while it grows, units, long name
NO_SUM = np.iinfo(np.uint16).max  # a missing sum; 64 readings of 10 bits sum to at most 65,472


def group_of(circuit: Readout) -> str:
    """Return the name of the group of recorded values, 'two_point' or 'readings'."""
    return "two_point" if circuit.unit == "ohm" else "readings"


def stored_fields(circuit: Readout) -> dict[str, Dataset]:
    """Return the datasets of the fields of a `Recording`, by field.

    The first one of a group is its signal.
    """
    group = group_of(circuit)
    unit = circuit.unit
    signal = circuit.signal
    return {
        "recorded": (f"{group}/{signal}", "f8", unit, circuit.signal_name),
        "time": (f"{group}/time", "f8", "s", "time of the frame"),
        "role": (f"{group}/role", "u1", "1", "0 unloaded baseline, 1 measured"),
        "raw_sums": (SUMS, "u2", "1", "sums of ADC codes"),
        "board_log_change": (
            ESTIMATES,
            "f8",
            "1",
            "ln(r / r unloaded) that the board estimated",
        ),
        "sigma": (f"{group}/sigma", "f8", unit, f"standard deviation of {signal}"),
        "truth_cell_resistance": ("truth/cell_resistance", "f8", "ohm", "true cell resistance"),
        "truth_pressure": ("truth/pressure", "f8", "kPa", "true pressure on the cells"),
    }


@dataclass(frozen=True, eq=False)
class Acquisition(Validated):
    """Acquisition data of a recording from a board.

    Attributes
    ----------
    host_time : array, shape (frames,)
        Arrival of the frame in s since 1970-01-01 UTC.
    device_ms : array, shape (frames,)
        Board's clock at the start of the scan in ms; it restarts after a reset.
    sequence, missed, lost, session : array, shape (frames,)
        See `FRAME_FIELDS`.
    event_time : array, shape (events,)
        Times of events in s on the recording's time axis.
    event_label : tuple of str
        Labels of at most 16 ASCII characters.

    Raises InputError if lengths disagree.
    """

    host_time: Array
    device_ms: NDArray[np.uint32]
    sequence: NDArray[np.uint32]
    missed: NDArray[np.uint16]
    lost: NDArray[np.uint32]
    session: NDArray[np.uint16]
    event_time: Array
    event_label: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len({len(getattr(self, name)) for name, *_ in FRAME_FIELDS}) != 1:
            raise InputError(f"{PATH}: the frames' fields differ in length")
        if len(self.event_time) != len(self.event_label):
            raise InputError(f"{PATH}: event_time and event_label differ in length")

    def write(self, entry: h5py.Group, time: Array) -> None:
        """Write the group `acquisition` with the frames' time as its axis."""
        group = entry.create_group("acquisition")
        hdf5.set_attributes(group, NX_class="NXcollection")
        hdf5.write_scale(group, "time", time, "s", "time of the frame")
        for name, kind, units, long_name in FRAME_FIELDS:
            hdf5.write_dataset(
                group, name, getattr(self, name).astype(kind), units, long_name, ("time",)
            )
        if self.event_label:
            hdf5.write_dataset(group, "event_time", self.event_time, "s", "time of the event")
            labels = hdf5.ascii_array([label or "?" for label in self.event_label])
            hdf5.write_dataset(group, "event_label", labels, "1", "label of the event")

    def start(self, first: float) -> str | None:
        """Return the host's date and time at 0 s, ISO 8601 in UTC, or None.

        `first` is the time of frame 0 in s.
        """
        seconds = float(self.host_time[0]) - first
        with suppress(ValueError, OverflowError):  # beyond the year 9999
            if seconds > 0:
                return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
        return None

    @classmethod
    def read(cls, file: h5py.File, part: slice) -> "Acquisition | None":
        """Return the acquisition data of a range of frames; None without the group.

        Raises InputError if invalid.
        """
        if not hdf5.has(file, PATH):
            return None
        fields = {
            name: hdf5.read_array(
                file, f"{PATH}/{name}", 1, part=part, kind=None if kind == "f8" else kind
            )
            for name, kind, *_ in FRAME_FIELDS
        }
        if not (hdf5.has(file, f"{PATH}/event_time") and hdf5.has(file, f"{PATH}/event_label")):
            return cls(**fields, event_time=np.zeros(0))
        times = hdf5.read_array(file, f"{PATH}/event_time", 1).astype(float)
        labels = hdf5.read_texts(file, f"{PATH}/event_label")
        events = min(len(times), len(labels))
        return cls(**fields, event_time=times[:events], event_label=labels[:events])


class Rows(NamedTuple):
    """Datasets of a growing file with a row for every frame, or for every event.

    A checksum of each row belongs to them.

    Attributes
    ----------
    datasets : tuple of Dataset
        In the order in which a row's bytes enter its checksum.
    checksum : Dataset
    """

    datasets: tuple[Dataset, ...]
    checksum: Dataset

    @classmethod
    def of_frames(cls, circuit: Readout, *, sums: bool = True, estimates: bool = False) -> "Rows":
        """Return the datasets with a row for every frame.

        `sums` of codes and `estimates` are those of the board.
        """
        names = ["recorded", "time", "role"]
        names += ["raw_sums"] * sums + ["board_log_change"] * estimates
        fields = stored_fields(circuit)
        acquired = [
            (f"acquisition/{name}", kind, units, words) for name, kind, units, words in FRAME_FIELDS
        ]
        return cls(
            (*(fields[name] for name in names), *acquired),
            ("acquisition/crc32", "u4", "1", "CRC-32 of all that belongs to the frame"),
        )

    @classmethod
    def of_file(cls, file: h5py.File, circuit: Readout) -> "Rows":
        """Return the datasets of a growing file with a row for every frame."""
        sums, estimates = (hdf5.has(file, f"/entry/{path}") for path in (SUMS, ESTIMATES))
        return cls.of_frames(circuit, sums=sums, estimates=estimates)

    @property
    def sums(self) -> bool:
        """Whether the board sends sums of codes."""
        return any(SUMS in dataset for dataset in self.datasets)

    @property
    def estimates(self) -> bool:
        """Whether the board estimates cells."""
        return any(ESTIMATES in dataset for dataset in self.datasets)

    def append(self, file: h5py.File, values: Sequence[Sequence[Any] | NDArray[Any]]) -> None:
        """Append rows to all datasets, and then their checksums, once the rows are in the file.

        Raises InputError if the file cannot be written.
        """
        try:
            paths = (f"entry/{path}" for path, *_ in self.datasets)
            columns = [
                _extend(file[path], column) for path, column in zip(paths, values, strict=True)
            ]
            file.flush()
            sums = file[f"entry/{self.checksum[0]}"]
            _extend(sums, checksums(columns, sums.attrs.get(SALT, b""), len(sums)))
            file[f"entry/{self.checksum[0]}"].flush()
        except (OSError, RuntimeError) as error:
            raise InputError(
                f"{file.filename}: cannot be written ({' '.join(str(error).split())})"
            ) from error

    def stored(self, file: h5py.File, part: slice) -> list[NDArray[Any]]:
        """Return a range of rows of each dataset. Raises InputError if one cannot be read."""
        return [
            np.array(
                [text.encode() for text in hdf5.read_texts(file, f"/entry/{path}", part=part)],
                dtype=kind,
            )
            if kind == LABEL
            else hdf5.read_array(file, f"/entry/{path}", (1, 3), part=part)
            for path, kind, *_ in self.datasets
        ]

    def undamaged(self, file: h5py.File) -> Mask:
        """Return which rows of an unfinished file are complete and agree with their checksum."""
        paths = [f"/entry/{path}" for path, *_ in (self.checksum, *self.datasets)]
        count, *lengths = (hdf5.length_of(file, path) for path in paths)
        right = np.zeros(count, dtype=np.bool_)
        salt = hdf5.read_attribute(file, paths[0], SALT) or ""
        for part in blocks(min(count, *lengths), prod(hdf5.shape_of(file, paths[1])[1:])):
            expected = checksums(self.stored(file, part), str(salt).encode(), part.start)
            right[part] = expected == hdf5.read_array(file, paths[0], 1, part=part)
        return right


EVENTS = Rows(
    (
        ("acquisition/event_time", "f8", "s", "time of the event"),
        ("acquisition/event_label", LABEL, "1", "label of the event"),
    ),
    ("acquisition/event_crc32", "u4", "1", "CRC-32 of all that belongs to the event"),
)


def _extend(dataset: h5py.Dataset, values: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
    """Append values in the dataset's type, integers clipped to its maximum, and return them."""
    if dataset.dtype.kind == "u":
        values = np.minimum(np.asarray(values, np.uint64), np.iinfo(dataset.dtype).max)
    column = np.asarray(values, dataset.dtype)
    length = dataset.shape[0]
    dataset.resize(length + len(column), axis=0)
    dataset[length:] = column
    return column


def checksums(columns: Sequence[NDArray[Any]], salt: bytes, first: int) -> NDArray[np.uint32]:
    """Return the CRC-32 of each row.

    The CRC covers the salt, the number of the row from `first` on, and the row of all columns.
    Without a salt, as in files of older versions, it covers the columns alone.
    """
    sums = np.empty(len(columns[0]), dtype=np.uint32)
    for row in range(len(sums)):
        place = salt + (first + row).to_bytes(8, "little") if salt else b""
        sums[row] = crc32(place + b"".join(column[row : row + 1].tobytes() for column in columns))
    return sums


def undamaged_frames(file: h5py.File, scene: Scene) -> slice:
    """Return the frames of a finished file, or those written so far.

    Raises InputError if one is damaged.
    """
    if "lampest_unfinished" not in file.attrs:
        return hdf5.ALL
    intact = Rows.of_file(file, scene.circuit).undamaged(file)
    damaged = np.flatnonzero(~intact)
    if len(damaged) or not np.all(EVENTS.undamaged(file)):
        fault = "an event is damaged"
        if len(damaged):
            fault = f"{len(damaged)} of {len(intact)} frames are damaged, first frame {damaged[0]}"
        raise InputError(
            f"{file.filename}: {fault}; lampest check --repair keeps the undamaged rest"
        )
    return slice(len(intact))


def blocks(frames: int, crossings: int) -> Iterator[slice]:
    """Yield ranges of frames that fit into memory at once."""
    length = max(1, hdf5.CHUNK // crossings)
    return (slice(begin, min(begin + length, frames)) for begin in range(0, frames, length))


def recorded_of_sums(scene: Scene, sums: NDArray[Any], readings: int) -> Array:
    """Return recorded values of sums of codes by the readout of each module.

    The sums have the shape (…, rows, columns); the value of NO_SUM is NaN.
    """
    layout = scene.panel.layout
    parts = layout.split(sums)
    recorded = np.empty(parts.shape)
    for module, numbers in scene.alike:
        assert module.readout is not None
        own = parts[..., numbers, :, :]
        values = module.readout.recorded_from_volt(module.readout.volt_from_code(own / readings))
        recorded[..., numbers, :, :] = np.where(own == NO_SUM, np.nan, values)
    return layout.joined(recorded)
