"""Answer of `lampest detect`: a sentence, attachments and events; as a table, JSON and a file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.breath import Pair, too_slow
from lampest.apps.recognition.breathing import MIN_WINDOW_S
from lampest.apps.recognition.hypotheses import MIN_DEPTH
from lampest.files import hdf5
from lampest.files.errors import counted
from lampest.panel.panel import Array, Panel
from lampest.report.compare import MAX_SHOWN, Table

FORMAT = "detections/2"
FILE = "detections.h5"
ERRORS = "_errors"  # after the name of a quantity: its standard deviations in the file
ANSWERS = ("lamprey", "sucks", "suction cup", "presses", "nothing", "cannot say")
LAMPREY, SUCKS, CUP, PRESSES, NOTHING, CANNOT_SAY = ANSWERS
# Assumed probability that a panel without any step is bare: weak loads cause no step.
BARE_PROBABILITY = 0.99
MIN_PROBABILITY = 0.9  # from which an attachment is called a lamprey, or a suction cup
MIN_PUMP_MINUTES = 10.0  # three of the longest published intervals between pumps
# Assumed longest pause between two contacts of one disturbance, s: plants wave and bodies beat
# several times a minute, and a visit after a longer pause counts as another.
MAX_PAUSE_S = 20.0
CHANCES = {
    "sucks": ("1", "probability that it sucks"),
    "breathes": ("1", "probability that its suction changes as breathing does"),
    "pumps": ("1", "probability that its suction decays and is pumped up again"),
}
NUMBERS = {
    "since_s": ("s", "time at which it came"),
    "until_s": ("s", "time at which it left; NaN: still present"),
    "cells": ("1", "number of touched cells"),
    "pump_count": ("1", "number of times that the suction was pumped up; NaN: not observed"),
    "pump_interval_s": ("s", "mean time between pumps"),
}
PAIRS = {
    "x_mm": ("mm", "centre across the columns, column 0 at 0"),
    "y_mm": ("mm", "centre across the rows, row 0 at 0"),
    "diameter_mm": ("mm", "outer diameter"),
    "suction_kpa": ("kPa", "pressure inside against the surroundings, typical of the attachment"),
    "strongest_kpa": ("kPa", "the same where it was strongest"),
    "breathing_hz": ("Hz", "rate at which the suction changes"),
    "breathing_depth": ("1", "relative amplitude of that"),
    "area_mm2": ("mm2", "area of the touched cells"),
    "conductance_s": ("S", "conductance of the touched cells beyond that at rest"),
}


class Event(NamedTuple):
    """An event of an attachment.

    Attributes
    ----------
    kind : str
        'touched', 'attached' (it sucks), 'moved' or 'released'.
    time_s : float
    number : int
        Number of the attachment.
    """

    kind: str
    time_s: float
    number: int


@dataclass(frozen=True, eq=False)
class Detected:
    """Answer to one recording.

    Attributes
    ----------
    recording : str
        Name of the recording.
    answer : str
        One of ANSWERS.
    probability : float
        Probability of the answer.
    why : str
        Reason why the answer is no more specific, in a sentence, or ''.
    frames_per_second : float or None
    notes : tuple of str
        Assumptions and inputs.
    attachments : tuple of Attachment
        Loads in the order of their arrival.
    course : array, shape (2, frames), or None
        Times in s, and the deviation of the readings from rest in standard deviations.
    change : array, shape (rows, columns), or None
        ln r/r0 at the last recognition.
    panel : Panel or None
    warnings : tuple of str
        Doubts about the recording, a line each.
    threshold : float
        Probability from which an attachment is called a lamprey, or a suction cup.
    start_time : str or None
        Date and time at 0 s.
    end_s : float or None
        Time of the last frame, s.
    mat : bool
        Whether the panel is a mat, on which nothing can suck.
    """

    recording: str
    answer: str
    probability: float
    why: str = ""
    frames_per_second: float | None = None
    notes: tuple[str, ...] = ()
    attachments: tuple[Attachment, ...] = ()
    course: Array | None = None
    change: Array | None = None
    panel: Panel | None = None
    warnings: tuple[str, ...] = ()
    threshold: float = MIN_PROBABILITY
    start_time: str | None = None
    end_s: float | None = None
    mat: bool = False

    @classmethod
    def of(
        cls, recording: str, attachments: Sequence[Attachment], rate: float, **known: Any
    ) -> "Detected":
        """Return the answer by the most alarming attachment.

        Among equals it is by a present one, then by the last one. Contacts of one disturbance are
        one attachment, but on a mat.

        Parameters
        ----------
        recording : str
        attachments : sequence of Attachment
        rate : float
            Frames per second.
        **known
            Further attributes.
        """
        if not known.get("mat", False):
            attachments = disturbances(attachments)
        # present ones first, and the last one first
        loads = sorted(attachments, key=lambda load: load.present)[::-1]
        called = [answer_of(load, rate, known.get("threshold", MIN_PROBABILITY)) for load in loads]
        chosen = min(
            called, key=lambda load: ANSWERS.index(load[0]), default=(NOTHING, BARE_PROBABILITY, "")
        )
        return cls(recording, *chosen, rate, attachments=tuple(attachments), **known)

    @classmethod
    def unknown(cls, recording: str, why: str) -> "Detected":
        """Return the answer 'cannot say' with its reason."""
        return cls(recording, CANNOT_SAY, 1.0, why)

    @property
    def called(self) -> list[str]:
        """The answer by each attachment alone."""
        return [name for name, _, _ in self._answers]

    @property
    def _answers(self) -> list[tuple[str, float, str]]:
        rate = self.frames_per_second or 0.0
        return [answer_of(load, rate, self.threshold) for load in self.attachments]

    @property
    def chosen(self) -> Attachment | None:
        """The attachment of the answer: the last one that is present, or the last one."""
        pairs = zip(reversed(self.attachments), reversed(self.called), strict=True)
        own = (load for load, name in pairs if name == self.answer)
        return max(own, key=lambda load: load.present, default=None)

    @property
    def sentence(self) -> str:
        """The answer in words: the attachment of the answer, or all present contacts."""
        load = self.chosen
        why = f": {self.why}" if self.why else ""
        if load is None:
            return self.answer + why
        odds = f"P = {self.probability:.2f}" if self.probability < 0.995 else "P > 0.99"
        present = [attachment for attachment in self.attachments if attachment.present]
        if self.answer == PRESSES and len(present) > 1:
            shown = [*map(_described, present[:MAX_SHOWN])]
            shown += [f"{len(present) - MAX_SHOWN} more"] if len(present) > MAX_SHOWN else []
            return f"{len(present)} contacts: {'; '.join(shown)} ({odds})"
        visits = sum(name in (LAMPREY, SUCKS, CUP) for name in self.called)
        earlier = f"{headline(self.called)}; last: " if visits > 1 else ""
        name = {SUCKS: "something that sucks (lamprey or cup)", PRESSES: "contact"}.get(
            self.answer, self.answer
        )
        messages = [f"{name}{' attached' if load.sucks > 0.5 else ''} {_described(load)}"]
        if self.answer == LAMPREY and load.pumps >= self.threshold:
            messages.append("pumping up its suction")
        hertz = load.breathing_hz
        depth = load.breathing_depth
        if self.answer == LAMPREY and load.breathes > 0.5 and hertz and depth:
            percent = _shown((100 * depth[0], 100 * depth[1]), "%")
            messages += [f"breathing {hertz[0]:.1f} Hz", percent]
        others = len(present) - load.present
        if others:
            messages.append(f"and {others} more")
        return f"{earlier}{', '.join(messages)} ({odds}){why}"

    @property
    def events(self) -> tuple[Event, ...]:
        """All events in the order of time."""
        events = list[Event]()
        for number, load in enumerate(self.attachments):
            touched = load.since_s if load.sucks_s is None or load.sucks_s > load.since_s else None
            times = [
                ("touched", touched),
                ("attached", load.sucks_s),
                *(("moved", time) for time in load.moved_s),
                ("released", load.until_s),
            ]
            events += [Event(kind, time, number) for kind, time in times if time is not None]
        return tuple(sorted(events, key=lambda event: event.time_s))

    def content(self) -> dict[str, Any]:
        """Return the content of `--json`."""
        rate = self.frames_per_second
        pairs = zip(self.attachments, self._answers, strict=True)
        return {
            "recording": self.recording,
            "answer": self.answer,
            "probability": round(self.probability, 4),
            "sentence": self.sentence,
            "frames_per_second": None if rate is None else round(rate, 4),
            "why": self.why,
            "notes": list(self.notes),
            "warnings": list(self.warnings),
            "attachments": [
                {"answer": answer, "probability": round(probability, 4), "why": why}
                | {name: round(getattr(load, name), 4) for name in CHANCES}
                | {name: _rounded(getattr(load, name)) for name in (*NUMBERS, *PAIRS)}
                for load, (answer, probability, why) in pairs
            ],
            "events": [
                {"event": kind, "time_s": _rounded(time), "attachment": number}
                for kind, time, number in self.events
            ],
        }


def disturbances(attachments: Sequence[Attachment]) -> tuple[Attachment, ...]:
    """Return attachments in which each contact is joined to the last one in its place.

    The pause between both is at most MAX_PAUSE_S, and neither sucks. The joined contact has the
    figures of the clearest one, from the first arrival to the last departure.
    """
    joined = list[Attachment]()
    for load in sorted(attachments, key=lambda attachment: attachment.since_s):
        for number, former in enumerate(joined):
            pause_s = load.since_s - (inf if former.until_s is None else former.until_s)
            presses = max(former.sucks, load.sucks) <= 0.5
            if presses and 0 <= pause_s <= MAX_PAUSE_S and former.adjoins(load):
                clearest = max(former, load, key=lambda contact: contact.clear)
                joined[number] = replace(clearest, since_s=former.since_s, until_s=load.until_s)
                break
        else:
            joined.append(load)
    return tuple(joined)


def answer_of(
    load: Attachment, rate: float, threshold: float = MIN_PROBABILITY
) -> tuple[str, float, str]:
    """Return the answer by one load.

    Parameters
    ----------
    load : Attachment
    rate : float
        Frames per second.
    threshold : float
        Probability from which it is called a lamprey, or a suction cup.

    Returns
    -------
    answer : str
    probability : float
    reason : str
        Why the answer is no more specific, or ''.
    """
    breath = load.breath
    alive = load.sucks * load.lives
    lifeless = load.sucks * (1 - load.lives)
    if load.sucks <= 0.5:
        small = "it is too small for this pitch: no cell would show whether it sucks"
        return PRESSES, 1 - load.sucks, small if load.small else ""
    if alive >= threshold:
        return LAMPREY, alive, ""
    if too_slow(rate):
        minutes = 0.0 if load.track is None else load.track.observed_s / 60
        pumps = "whether suction is pumped up again shows within minutes"
        if minutes >= MIN_PUMP_MINUTES:
            pumps = (
                f"in {minutes:.0f} minutes it was not pumped up in a way "
                f"that tells a mouth (P = {load.pumps:.2f})"
            )
        why = f"{too_slow(rate)}; {pumps}"
    elif breath.odds > 0 and breath.suction < 0.5:
        why = "it moves at a breathing rate, but probably not by its suction: it may be shaken"
    elif breath.hertz is None and np.isfinite(breath.judged_s):
        why = (
            "its readings are never steady for long enough to show breathing, "
            "or too many frames are missing"
        )
    elif breath.hertz is None:
        after = f"it moved at {load.moved_s[-1]:.1f} s, and " if load.moved_s else ""
        why = f"{after}breathing shows when it has been in its place for {MIN_WINDOW_S:g} s"
    elif lifeless < threshold:
        why = f"whether it breathes is not clear (P = {load.breathes:.2f})"
    elif breath.max_depth < MIN_DEPTH:
        return CUP, lifeless, ""
    else:
        why = "no breath shows, but no full window excludes one as deep as a mouth's"
    return SUCKS, load.sucks, why


def headline(called: Sequence[str]) -> str:
    """Return the counts of visits in words, such as '7 lamprey visits, 2 unsure, 1 suction cup'.

    If there are only contacts, the text is their number, such as '3 contacts'.
    """
    lampreys, unsure, cups = map(called.count, (LAMPREY, SUCKS, CUP))
    contacts = len(called) - lampreys - unsure - cups
    if called and contacts == len(called):
        return counted(contacts, "contact")
    messages = [counted(lampreys, "lamprey visit")]
    messages += [f"{unsure} unsure"] * (unsure > 0)
    messages += [counted(cups, "suction cup")] * (cups > 0)
    messages += [counted(contacts, "other contact")] * (contacts > 0)
    return ", ".join(messages)


def alarming(detected: Detected) -> list[float]:
    """Return the arrival times, s, of lampreys.

    If the frame rate shows no breathing, also those of all loads that suck.
    """
    alarms = (LAMPREY, SUCKS) if too_slow(detected.frames_per_second or 0.0) else (LAMPREY,)
    pairs = zip(detected.attachments, detected.called, strict=True)
    return [load.since_s for load, name in pairs if name in alarms]


def _described(load: Attachment) -> str:
    """Return the times, the place and the size of an attachment in words."""
    until = "since {:.1f} s" if load.until_s is None else "from {:.1f} s to {:.1f} s"
    diameter = f", {_shown(load.diameter_mm, 'mm')}" if load.diameter_mm else ""
    messages = [
        f"{until.format(load.since_s, load.until_s)}{diameter} at "
        f"({load.x_mm[0]:.0f}, {load.y_mm[0]:.0f}) mm"
    ]
    if load.suction_kpa and load.sucks > 0.5:
        messages.append(_shown(load.suction_kpa, "kPa"))
    if load.diameter_mm is None and load.area_mm2 is not None:
        messages += [counted(load.cells, "cell"), _shown(load.area_mm2, "mm²")]
    return ", ".join(messages)


def _rounded(value: Pair | float | None) -> Any:
    """Return a number, or each of a pair, with six significant digits.

    Counts and None are unchanged.
    """
    if isinstance(value, tuple):
        return [_rounded(number) for number in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _shown(pair: Pair | None, unit: str = "") -> str:
    """Return 'value ± standard deviation' with the digits of the latter; '' for None."""
    if pair is None:
        return ""
    value, sd = pair
    digits = 2 - (sd >= 0.05) - (sd >= 1)
    error = max(sd, 0.01)
    return f"{value:.{digits}f} ± {error:.{digits}f} {unit}".replace("-", "−").strip()


def event_table(answers: Sequence[Detected]) -> Table:
    """Return a table with a row for each event."""
    rows = []
    for answer in answers:
        called = answer.called
        for kind, time, number in answer.events:
            load = answer.attachments[number]
            place = f"{load.x_mm[0]:.0f}, {load.y_mm[0]:.0f}"
            numbers = map(_shown, (load.diameter_mm, load.suction_kpa, load.breathing_hz))
            rows.append((answer.recording, f"{time:.1f}", kind, called[number], place, *numbers))
    shape = ("x, y [mm]", "diameter [mm]", "inside [kPa]", "breathing [Hz]")
    return Table(("recording", "time [s]", "event", "what", *shape), tuple(rows))


def load_table(answers: Sequence[Detected]) -> Table:
    """Return a table with a row for each attachment, with figures of its touched cells.

    Probabilities are left out if all panels are mats.
    """
    shown = () if all(answer.mat for answer in answers) else tuple(CHANCES)
    rows = []
    for answer in answers:
        for load in answer.attachments:
            since = f"{load.since_s:.1f}"
            chances = [f"{getattr(load, chance):.3f}" for chance in shown]
            area = load.area_mm2 and f"{load.area_mm2[0]:.0f}"
            conductance = load.conductance_s and f"{1e3 * load.conductance_s[0]:.3g}"
            cells = str(load.cells)
            rows.append((answer.recording, since, *chances, cells, area or "", conductance or ""))
    chances = [f"P({chance})" for chance in shown]
    return Table(
        ("recording", "since [s]", *chances, "cells", "area [mm²]", "conductance [mS]"), tuple(rows)
    )


def write_detections(path: Path, answers: Sequence[Detected]) -> Path:
    """Write all answers into one HDF5 file atomically.

    Raises InputError where it cannot be written. Each recording has a group with the names of
    `Detected.content`. A number of an attachment is one dataset, a pair two datasets, the second of
    which is `<name>_errors`.
    """
    with hdf5.new_file(path) as file:
        hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT)
        entry = file.create_group("entry")
        hdf5.set_attributes(entry, NX_class="NXentry")
        for order, answer in enumerate(answers):
            content = answer.content()
            rate = answer.frames_per_second
            about = {
                "answer": content["answer"],
                "sentence": content["sentence"],
                "why": content["why"],
                "probability": answer.probability,
                "frames_per_second": np.nan if rate is None else rate,
                "notes": "\n".join(answer.notes),
                "start_time": answer.start_time or "",
                "end_s": np.nan if answer.end_s is None else answer.end_s,
            }
            group = entry.create_group(answer.recording)
            hdf5.set_attributes(group, NX_class="NXsubentry", order=order, **about)
            if answer.attachments:
                _write_attachments(_collection(group, "attachments"), content["attachments"])
                kinds, times, numbers = zip(*answer.events, strict=True)
                write = _collection(group, "events")
                names = hdf5.ascii_array(kinds)
                write("event", names, "1", "touched, attached, moved or released")
                write("time", np.array(times), "s", "when it was first seen")
                write("attachment", np.array(numbers), "1", "number of the attachment")
    return path


def _collection(entry: Any, name: str) -> Callable[..., None]:
    """Return the writer of datasets of a new collection."""
    group = entry.create_group(name)
    hdf5.set_attributes(group, NX_class="NXcollection")
    return partial(hdf5.write_dataset, group)


def _write_attachments(write: Callable[..., None], loads: Sequence[dict[str, Any]]) -> None:
    """Write attachments as in `Detected.content`."""
    write("answer", hdf5.ascii_array([load["answer"] for load in loads]), "1", "what it is")
    reasons = hdf5.ascii_array([load["why"] for load in loads])
    write("why", reasons, "1", "why the answer is no more specific")
    probabilities = np.array([load["probability"] for load in loads])
    write("probability", probabilities, "1", "probability of the answer")
    for name, (units, text) in (CHANCES | NUMBERS).items():
        write(name, np.array([load[name] for load in loads], dtype=float), units, text)
    for name, (units, text) in PAIRS.items():
        values, errors = np.array([load[name] or (None, None) for load in loads], dtype=float).T
        write(name, values, units, text)
        write(f"{name}{ERRORS}", errors, units, f"standard deviation: {text}")
