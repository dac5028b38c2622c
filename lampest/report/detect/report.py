"""Detections as a table of events and as a file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.loads.recognition.candidates import KINDS
from lampest.panel.panel import Array
from lampest.report.compare import Table
from lampest.report.detect.detection import QUANTITIES, Detection
from lampest.report.detect.events import Event, events, states
from lampest.runs.case import SHARED

FORMAT = "detections/1"
FILE = "detections.h5"
READINGS = "readings"  # what tables call detections from the readings themselves
ORDINALS = ("second", "third")  # groups of the loads beside the first
MINUS = "−"
LEAST_ERROR = 0.1  # mm or kPa: nothing is told to ± 0.0


def source_name(source: str) -> str:
    """What tables and pictures call an estimator, or the readings themselves."""
    return READINGS if source == SHARED else source


def event_table(detections: Sequence[Detection]) -> Table:
    """One row for each event; a recording in which nothing happened has one row that says so."""
    numbers = tuple(f"{quantity.header} [{quantity.units}]" for quantity in QUANTITIES[2:])
    headers = ("recording", "from", "event", "frame", "time [s]", "what", "x, y [mm]", *numbers)
    rows = []
    for detection in detections:
        names = (detection.recording, source_name(detection.source))
        happened = events(detection)
        if not happened:
            rows.append((*names, "nothing attached", *[""] * (len(headers) - 3)))
        for event in happened:
            when = (event.kind, str(event.frame), f"{event.time:g}", event.label)
            x, y, *others = (_plus_minus(event, number) for number in range(len(QUANTITIES)))
            rows.append((*names, *when, ", ".join(filter(None, (x, y))), *others))
    return Table(headers, tuple(rows))


def _plus_minus(event: Event, quantity: int) -> str:
    value, error = event.values[quantity], max(event.errors[quantity], LEAST_ERROR)
    if not np.isfinite(value):
        return ""
    digits = 0 if error >= 10 else 1
    return f"{value:.{digits}f} ± {error:.{digits}f}".replace("-", MINUS)


def write_detections(path: str | Path, detections: Sequence[Detection]) -> Path:
    """Write all detections into one file, whole or not at all. Raises InputError where it cannot be written."""
    path = Path(path)
    recordings = list(dict.fromkeys(detection.recording for detection in detections))
    with hdf5.new_file(path) as file:
        hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT)
        entry = file.create_group("entry")
        hdf5.set_attributes(entry, NX_class="NXentry", **({"default": recordings[0]} if recordings else {}))
        for order, recording in enumerate(recordings):
            group = entry.create_group(recording)
            hdf5.set_attributes(group, NX_class="NXsubentry", default=SHARED, order=order)
            for detection in detections:
                if detection.recording == recording:
                    _write(group.create_group(detection.source), detection)
    return path


def _write(group: Any, detection: Detection) -> None:
    axes = ("time",)
    hdf5.set_attributes(group, NX_class="NXdata", signal="diameter", axes=list(axes))
    hdf5.set_attributes(group, source=source_name(detection.source))
    hdf5.write_scale(group, "time", np.asarray(detection.time, dtype=float), "s", "time of the frame")
    hdf5.write_dataset(group, "frame", detection.frame, "1", "index of the frame in the recording", axes)
    hdf5.write_dataset(group, "label", hdf5.ascii_array(detection.labels), "1", "what the frame may be called", axes)
    calm = hdf5.ascii_array(states(detection.labels))
    hdf5.write_dataset(group, "state", calm, "1", "label on which two frames in a row agree", axes)
    for number, kind in enumerate(KINDS):
        name = f"probability/{kind.replace(' ', '_')}"
        hdf5.write_dataset(group, name, detection.probabilities[:, number], "1", f"probability of {kind}", axes)
    hdf5.set_attributes(group["probability"], NX_class="NXcollection")
    _write_numbers(group, "", (detection.values, detection.errors), "")
    for ordinal, numbers in zip(ORDINALS, detection.further, strict=True):
        _write_numbers(group, f"{ordinal}/", numbers, f"{ordinal} load: ")
        hdf5.set_attributes(group[ordinal], NX_class="NXcollection")
    hdf5.write_dataset(group, "count", detection.count, "1", "number of loads at once", axes)
    hdf5.write_dataset(group, "goodness", detection.goodness, "1", "chi-square per reading of the best load", axes)
    why = "why the unloaded panel was taken anew after the frame; empty: it was not"
    hdf5.write_dataset(group, "tared", hdf5.ascii_array(detection.tared), "1", why, axes)
    _write_events(group.create_group("events"), events(detection))


def _write_numbers(group: Any, folder: str, numbers: tuple[Array, Array], of_what: str) -> None:
    """Every quantity of a load and its standard deviation."""
    for suffix, part, prefix in (("", numbers[0], ""), ("_errors", numbers[1], "standard deviation: ")):
        for place, quantity in enumerate(QUANTITIES):
            name, text = f"{folder}{quantity.name}{suffix}", prefix + of_what + quantity.long_name
            hdf5.write_dataset(group, name, part[:, place], quantity.units, text, ("time",))


def _write_events(group: Any, happened: Sequence[Event]) -> None:
    """A table by columns; none where nothing happened."""
    hdf5.set_attributes(group, NX_class="NXcollection", events=len(happened))
    if not happened:
        return
    texts: list[tuple[str, Sequence[str], str]] = [
        ("event", [event.kind for event in happened], "touched, attached, moved or released"),
        ("label", [event.label for event in happened], "what it is called until the next event"),
    ]
    for name, values, text in texts:
        hdf5.write_dataset(group, name, hdf5.ascii_array(values), "1", text)
    hdf5.write_dataset(group, "time", np.array([event.time for event in happened]), "s", "time of the first frame")
    frames = np.array([event.frame for event in happened])
    hdf5.write_dataset(group, "frame", frames, "1", "index of the first frame in the recording")
    for number, quantity in enumerate(QUANTITIES):
        parts: tuple[tuple[str, Array], ...] = (
            (quantity.name, np.array([event.values[number] for event in happened])),
            (quantity.name + "_errors", np.array([event.errors[number] for event in happened])),
        )
        for name, numbers in parts:
            hdf5.write_dataset(group, name, numbers, quantity.units, f"{quantity.long_name}, until the next event")
