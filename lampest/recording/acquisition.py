"""What a board adds to a recording's frames: clocks, sequence numbers, gaps, and the events that were marked."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.typed import Validated
from lampest.panel.panel import Array

PATH = "/entry/acquisition"
LABEL_BYTES = 16
LAST_SECOND = 253_402_300_800.0  # of the year 9999
# name, type, units, what it is; for every frame
FRAME_FIELDS = (
    ("host_time", "f8", "s", "host clock when the frame arrived, since 1970-01-01 UTC"),
    ("device_ms", "u4", "ms", "board clock at the start of the scan"),
    ("sequence", "u4", "1", "number of the frame since the board was started"),
    ("missed", "u2", "1", "scans that the board could not begin in time before this one"),
    ("lost", "u4", "1", "frames that are missing before this one"),
    ("session", "u2", "1", "grows by one where the board was unplugged or restarted before the frame"),
)


@dataclass(frozen=True, eq=False)
class Acquisition(Validated):
    """Where each frame came from.

    Parameters
    ----------
    host_time : (frames) s since 1970-01-01 UTC, when the frame arrived.
    device_ms : (frames) ms, the board's clock at the start of the scan; begins again after a reset.
    sequence : (frames) number of the frame since the board was started.
    missed : (frames) scans that the board could not begin in time.
    lost : (frames) frames that are missing before this one; the gaps.
    session : (frames) grows by one where the board was unplugged or restarted.
    event_time : (events) s on the recording's time axis.
    event_label : (events) texts of at most 16 ASCII characters.

    Raises InputError where the lengths disagree.
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
            hdf5.write_dataset(group, name, getattr(self, name).astype(kind), units, long_name, ("time",))
        if self.event_label:
            hdf5.write_dataset(group, "event_time", self.event_time, "s", "time of the event")
            labels = hdf5.ascii_array([label or "?" for label in self.event_label])
            hdf5.write_dataset(group, "event_label", labels, "1", "what was marked")

    def start(self, first: float) -> str | None:
        """Date and time at 0 s by the host's clock, ISO 8601 in UTC; None where it has none.

        first : of the first frame on the time axis, s.
        """
        seconds = float(self.host_time[0]) - first
        if not 0 < seconds < LAST_SECOND:
            return None
        return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")

    @classmethod
    def read(cls, file: h5py.File, kept: slice) -> "Acquisition | None":
        """The group of an open file, the kept frames of it; None where there is none. Raises InputError."""
        if not hdf5.has(file, PATH):
            return None
        fields: dict[str, Any] = {name: _values(file, name, kind, kept) for name, kind, *_ in FRAME_FIELDS}
        times, labels = np.zeros(0), tuple[str, ...]()
        if hdf5.has(file, f"{PATH}/event_time") and hdf5.has(file, f"{PATH}/event_label"):
            times = hdf5.read_array(file, f"{PATH}/event_time", 1).astype(float)
            labels = hdf5.read_texts(file, f"{PATH}/event_label")
        events = min(len(times), len(labels))
        return cls(**fields, event_time=times[:events], event_label=labels[:events])


def _values(file: h5py.File, name: str, kind: str, kept: slice) -> Any:
    path = f"{PATH}/{name}"
    if kind == "f8":
        return hdf5.read_array(file, path, 1, part=kept).astype(kind)
    return hdf5.read_whole(file, path, kind, 1, part=kept)
