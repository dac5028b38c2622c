"""From frames to events: touched, attached, moved, released."""

from dataclasses import dataclass

import numpy as np

from lampest.loads.recognition.candidates import AND, LOADS, NOTHING, UNIFORM
from lampest.loads.recognition.verdict import OR
from lampest.panel.panel import Array
from lampest.report.detect.detection import NOT_SOLVED, Detection

AWAY = frozenset(candidate.label for candidate in UNIFORM)
SUCKING = frozenset(load.label for load in LOADS if load.sucks)
MOVED_MM, MOVED_SD = 3.0, 4.0
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
