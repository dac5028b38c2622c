"""From frames to events: touched, attached, moved, released."""

from dataclasses import dataclass

import numpy as np

from lampest.loads.recognition.loads import CUP, FLAT, LAMPREY, NOTHING
from lampest.loads.recognition.verdict import OR
from lampest.panel.panel import Array
from lampest.report.detect.detection import NOT_SOLVED, Detection

AWAY = frozenset((NOTHING.label, FLAT.label))
SUCKING = frozenset((CUP.label, LAMPREY.label))
MOVED_MM, MOVED_SD = 3.0, 4.0


@dataclass(frozen=True, eq=False)
class Event:
    """Something that changed.

    kind : 'touched' something presses, 'attached' it sucks, 'moved' its centre, 'released' nothing is there any more.
    place, frame, time : place among the frames, index into the recording, s: of the first frame that shows it.
    label : what it was called most often until the next event.
    values, errors : (quantities) medians over the frames until the next event. The errors of neighbouring frames are
        alike: a mean over them would hardly be better than one.
    """

    kind: str
    place: int
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
    solved = [place for place, label in enumerate(labels) if label != NOT_SOLVED]
    state = frozenset((NOTHING.label,))
    held: dict[int, frozenset[str]] = {}
    before: tuple[int, frozenset[str]] | None = None
    for place in solved:
        shown = frozenset(labels[place].split(OR))
        if before is not None:
            agreed = shown | before[1]
            if not state <= agreed:
                state = agreed
                held[before[0]] = state
        held[place] = state
        before = place, shown
    order = {label: rank for rank, label in enumerate(dict.fromkeys(part for one in labels for part in one.split(OR)))}
    found, last = [], frozenset((NOTHING.label,))
    for place in range(len(labels)):
        last = held.get(place, last)
        found.append(OR.join(sorted(last, key=lambda label: order.get(label, -1))))
    return tuple(found)


def events(detection: Detection) -> tuple[Event, ...]:
    """What happened, in the order of time."""
    shown = [frozenset(state.split(OR)) for state in states(detection.labels)]
    marks: list[tuple[str, int]] = []
    present = attached = False
    reference = np.full(2, np.nan)
    for place, state in enumerate(shown):
        if present and state <= AWAY:
            present = attached = False
            marks.append(("released", place))
        elif not present and not state & AWAY:
            present = True
            marks.append(("touched", place))
            reference = detection.values[place, :2]
        if present and not attached and state <= SUCKING:
            attached = True
            if marks and marks[-1] == ("touched", place):
                marks.pop()
            marks.append(("attached", place))
            reference = detection.values[place, :2]
        elif present and _moved(detection, place, reference):
            marks.append(("moved", place))
            reference = detection.values[place, :2]
    ends = [place for _, place in marks] + [len(shown)]
    return tuple(_event(detection, kind, place, end) for (kind, place), end in zip(marks, ends[1:], strict=True))


def _moved(detection: Detection, place: int, reference: Array) -> bool:
    """Whether the centre is away from its reference in this frame and the next, by mm and by its uncertainty."""
    frames = slice(place, place + 2)
    step = detection.values[frames, :2] - reference
    error = np.hypot(*detection.errors[frames, :2].T)
    far = np.hypot(*step.T) > np.maximum(MOVED_MM, MOVED_SD * error)
    return len(far) == 2 and bool(np.all(far))


def _event(detection: Detection, kind: str, place: int, end: int) -> Event:
    labels = states(detection.labels)[place:end]
    label = max(dict.fromkeys(labels), key=labels.count)
    medians = [_medians(numbers[place:end]) for numbers in (detection.values, detection.errors)]
    return Event(kind, place, int(detection.frame[place]), float(detection.time[place]), label, *medians)


def _medians(numbers: Array) -> Array:
    """Of every column's finite numbers; NaN where there is none."""
    columns = [column[np.isfinite(column)] for column in numbers.T]
    return np.array([np.median(column) if column.size else np.nan for column in columns])
