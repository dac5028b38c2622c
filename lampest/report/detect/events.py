"""From frames to events: touched, attached, moved, released; as a table, and with all frames as a file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.loads.recognition.candidates import AND, KINDS, LOADS, NOTHING, UNIFORM
from lampest.loads.recognition.verdict import OR
from lampest.panel.panel import Array
from lampest.report.compare import Table
from lampest.report.detect.detection import NOT_SOLVED, QUANTITIES, Detection
from lampest.runs.case import SHARED

FORMAT, FILE = "detections/1", "detections.h5"
READINGS = "readings"  # what tables call detections from the readings themselves
ORDINALS = ("second", "third")  # groups of the loads beside the first
LEAST_ERROR = 0.1  # mm or kPa: no error is shown as ± 0.0
AWAY = frozenset(candidate.label for candidate in UNIFORM)
SUCKING = frozenset(load.label for load in LOADS if load.sucks)
MOVED_MM, MOVED_SD = 3.0, 4.0  # a movement has begun once the centre is away by both, over two frames
STILL_FRAMES, STILL_MM = 3, 1.5  # a movement is over once the centre stays within so much over so many frames


@dataclass(frozen=True, eq=False)
class Event:
    """Something that changed.

    kind : 'touched' something presses, 'attached' it sucks, 'moved' its centre begins to, 'released' nothing is there
        any more.
    number, frame, time : number among the detection's frames, index into the recording, s: of the first that shows it.
    label : what it was called most often until the next event.
    values, errors : (quantities) medians over the frames until the next event. The errors of neighbouring frames are
        alike: a mean over them would hardly be better than one.
    """

    kind: str
    number: int
    frame: int
    time: float
    label: str
    values: Array
    errors: Array


def states(labels: tuple[str, ...]) -> tuple[str, ...]:
    """(frames) what the sequence may be called: two frames in a row change the state, not one alone.

    From the first of them on it is what either of them may be called, unless that includes all it was already. Frames
    that were not solved change nothing.
    """
    solved = [number for number, label in enumerate(labels) if label != NOT_SOLVED]
    state = frozenset((NOTHING.label,))
    held: dict[int, frozenset[str]] = {}
    before: tuple[int, frozenset[str]] | None = None
    for number in solved:
        shown = frozenset(labels[number].split(OR))
        if before is not None:
            agreed = shown | before[1]
            if not state <= agreed:
                state = agreed
                held[before[0]] = state
        held[number] = state
        before = number, shown
    order = {label: rank for rank, label in enumerate(dict.fromkeys(part for one in labels for part in one.split(OR)))}
    calm, last = [], frozenset((NOTHING.label,))
    for number in range(len(labels)):
        last = held.get(number, last)
        calm.append(OR.join(sorted(last, key=lambda label: order.get(label, -1))))
    return tuple(calm)


def events(detection: Detection) -> tuple[Event, ...]:
    """What happened, in the order of time."""
    shown = [frozenset(state.split(OR)) for state in states(detection.labels)]
    marks: list[tuple[str, int]] = []
    present = attached = moving = False
    reference = np.full(2, np.nan)
    for number, state in enumerate(shown):
        if present and state <= AWAY:
            present = attached = moving = False
            marks.append(("released", number))
        elif not present and not state & AWAY:
            present = True
            marks.append(("touched", number))
            reference = detection.values[number, :2]
        if present and not attached and all(_sucks(label) for label in state):
            attached = True
            if marks and marks[-1] == ("touched", number):
                marks.pop()
            marks.append(("attached", number))
            reference = detection.values[number, :2]
        elif moving:
            moving = not _still(detection, number)
            reference = detection.values[number, :2]
        elif present and _moved(detection, number, reference):
            moving = True
            marks.append(("moved", number))
            reference = detection.values[number, :2]
    ends = [number for _, number in marks] + [len(shown)]
    return tuple(_event(detection, kind, number, end) for (kind, number), end in zip(marks, ends[1:], strict=True))


def _sucks(label: str) -> bool:
    """Whether something that sucks is among the loads of a label."""
    return any(load in SUCKING for load in label.split(AND))


def _moved(detection: Detection, number: int, reference: Array) -> bool:
    """Whether the centre is away from its reference in this frame and the next, by mm and by its uncertainty."""
    frames = slice(number, number + 2)
    step = detection.values[frames, :2] - reference
    error = np.hypot(*detection.errors[frames, :2].T)
    far = np.hypot(*step.T) > np.maximum(MOVED_MM, MOVED_SD * error)
    return len(far) == 2 and bool(np.all(far))


def _still(detection: Detection, number: int) -> bool:
    """Whether the centre stays where it is in this frame and the ones before it, by mm or by its uncertainty."""
    frames = slice(max(0, number - STILL_FRAMES + 1), number + 1)
    step = detection.values[frames, :2] - detection.values[number, :2]
    error = np.hypot(*detection.errors[frames, :2].T)
    return bool(np.all(np.hypot(*step.T) <= np.maximum(STILL_MM, 2 * error)))


def _event(detection: Detection, kind: str, number: int, end: int) -> Event:
    labels = states(detection.labels)[number:end]
    label = max(dict.fromkeys(labels), key=labels.count)
    medians = [_medians(values[number:end]) for values in (detection.values, detection.errors)]
    return Event(kind, number, int(detection.frame[number]), float(detection.time[number]), label, *medians)


def _medians(numbers: Array) -> Array:
    """Of every column's finite numbers; NaN where there is none."""
    columns = [column[np.isfinite(column)] for column in numbers.T]
    return np.array([np.median(column) if column.size else np.nan for column in columns])


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
            x, y, *others = (_plus_minus(*pair) for pair in zip(event.values, event.errors, strict=True))
            rows.append((*names, *when, ", ".join(filter(None, (x, y))), *others))
    return Table(headers, tuple(rows))


def _plus_minus(value: float, error: float) -> str:
    error = max(error, LEAST_ERROR)
    digits = 0 if error >= 10 else 1
    return f"{value:.{digits}f} ± {error:.{digits}f}".replace("-", "−") if np.isfinite(value) else ""


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


def _write(group: Any, one: Detection) -> None:
    hdf5.set_attributes(group, NX_class="NXdata", signal="diameter", axes=["time"], source=source_name(one.source))
    hdf5.write_scale(group, "time", np.asarray(one.time, dtype=float), "s", "time of the frame")
    state = hdf5.ascii_array(states(one.labels))
    why = "why the unloaded panel was taken anew after the frame; empty: it was not"
    columns = [
        ("frame", one.frame, "1", "index of the frame in the recording"),
        ("label", hdf5.ascii_array(one.labels), "1", "what the frame may be called"),
        ("state", state, "1", "label on which two frames in a row agree"),
        *(
            (f"probability/{kind.replace(' ', '_')}", shares, "1", f"probability of {kind}")
            for kind, shares in zip(KINDS, one.probabilities.T, strict=True)
        ),
        *_numbers("", one.values, one.errors, ""),
    ]
    for ordinal, numbers in zip(ORDINALS, one.further, strict=True):
        columns += _numbers(f"{ordinal}/", *numbers, f"{ordinal} load: ")
    columns += [
        ("count", one.count, "1", "number of loads at once"),
        ("goodness", one.goodness, "1", "chi-square per reading of the best load"),
        ("tared", hdf5.ascii_array(one.tared), "1", why),
    ]
    for column in columns:
        hdf5.write_dataset(group, *column, ("time",))
    for folder in ("probability", *ORDINALS):
        hdf5.set_attributes(group[folder], NX_class="NXcollection")
    _write_events(group.create_group("events"), events(one))


def _numbers(folder: str, values: Array, errors: Array, of_what: str) -> list[tuple[str, Any, str, str]]:
    """Name, values, units and meaning of every quantity of a load, then of their standard deviations."""
    return [
        (f"{folder}{quantity.name}{suffix}", part, quantity.units, prefix + of_what + quantity.long_name)
        for suffix, numbers, prefix in (("", values, ""), ("_errors", errors, "standard deviation: "))
        for quantity, part in zip(QUANTITIES, numbers.T, strict=True)
    ]


def _write_events(group: Any, happened: Sequence[Event]) -> None:
    """A table by columns; none where nothing happened."""
    hdf5.set_attributes(group, NX_class="NXcollection", events=len(happened))
    if not happened:
        return
    kinds, labels = (hdf5.ascii_array([getattr(one, name) for one in happened]) for name in ("kind", "label"))
    columns = [
        ("event", kinds, "1", "touched, attached, moved or released"),
        ("label", labels, "1", "what it is called until the next event"),
        ("time", np.array([one.time for one in happened]), "s", "time of the first frame"),
        ("frame", np.array([one.frame for one in happened]), "1", "index of the first frame in the recording"),
    ]
    for number, quantity in enumerate(QUANTITIES):
        for suffix, part in (("", [one.values for one in happened]), ("_errors", [one.errors for one in happened])):
            text = f"{quantity.long_name}, until the next event"
            columns.append((quantity.name + suffix, np.array(part)[:, number], quantity.units, text))
    for column in columns:
        hdf5.write_dataset(group, *column)
