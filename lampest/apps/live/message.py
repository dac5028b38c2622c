"""Messages of live frames, for other programs and for the page; see docs/reference/stream.md."""

import json
import time
from bisect import bisect_right
from dataclasses import dataclass, replace
from itertools import starmap
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.apps.film.pressure import Force
from lampest.apps.recognition.detect.answer import ANSWERS, Detected, alarming
from lampest.panel.panel import Array, Mask, Panel

FORMAT = "lampest stream 1"
MAP_UNITS = {"change": "percent", "pressure": "kPa", "cells": "ohm"}
Content = dict[str, Any]  # of a message or a part of it, as JSON has it
UNKNOWN = Force(float("nan"), float("nan"))
COMPACT: Content = {"allow_nan": False, "separators": (",", ":")}
HISTORY_FRAMES = 1800  # frames of the page's history, one minute at 30 frames a second
PAIRS = {"x_mm": "millimetre", "y_mm": "millimetre", "diameter_mm": "millimetre"}
PAIRS |= {"suction_kpa": "kilopascal", "breathing_hz": "hertz"}
ANSWER = {
    "answer": "1",
    "probability": "1",
    "alarm": "1",
    "since_s": "second",
    "until_s": "second",
    **PAIRS,
}
HEAD = {"sequence": "1", "force": "newton", "verdict": "1", "solved": "1"}
TAIL = {"force_sd": "newton", **ANSWER}
VERDICTS = "nothing", "pressing", "sucking", "pressing and sucking", "unsolved"
NOTHING, PRESSING, SUCKING, BOTH, UNSOLVED = VERDICTS


class Channel(NamedTuple):
    """Description of a number of a frame; `place` is (x, y) of its cell, m."""

    label: str
    unit: str
    place: tuple[float, float] | None = None


class Point(NamedTuple):
    """Frame of the history: number, time in s, and total force in newton (NaN if unknown)."""

    number: int
    time: float
    total: float


@dataclass(frozen=True, eq=False)
class Picture:
    """A reconstructed frame.

    Attributes
    ----------
    number : int
        Number of the frame, from 1 on.
    time : float
        Seconds on the time axis of the recording.
    arrived : float
        Seconds since 1970-01-01 UTC.
    measured_change, relative_change : array, shape (rows, columns)
        Percent of the baseline; the latter NaN if the frame failed.
    open_cell : boolean array, shape (rows, columns)
        Cells that cannot be distinguished from open ones.
    force : Force
        Total force, unknown if the frame failed or the scene has no response; its deviation may
        follow later.
    status : str
        Outcome of the solve.
    seconds : float
        Duration of the solve.
    skipped : int
        Frames skipped before this one.
    cell_resistance, pressure : array, shape (rows, columns), or None
        Ohm and kPa.
    saturated : array, shape (rows, columns), or None
        Cells whose pressure the response cannot determine.
    verdict : str
        One of VERDICTS.
    outliers : int
        Readings that no cells give, left out of the frame.
    board_change : array, shape (rows, columns), or None
        Change that the board estimated, in percent.
    """

    number: int
    time: float
    arrived: float
    measured_change: Array
    relative_change: Array
    open_cell: Mask
    force: Force
    status: str
    seconds: float
    skipped: int
    cell_resistance: Array | None = None
    pressure: Array | None = None
    saturated: NDArray[np.uint8] | None = None
    verdict: str = UNSOLVED
    outliers: int = 0
    board_change: Array | None = None


@dataclass(frozen=True, eq=False)
class View:
    """Content of the page.

    Attributes
    ----------
    source, method : str
        Source of the frames and name of the estimator.
    state : str
        State of the port or the recording.
    panel : Panel or None
    frames, lost, skipped : int
        Frames that arrived, were lost before arrival, and were not reconstructed.
    picture : Picture or None
        The newest reconstructed frame.
    history : tuple of Point
    model : str
        Warnings about the scene or the frames, one a line.
    zero : str
        When the zero was last renewed, and why.
    deviation, deviation_of : float, int
        Standard deviation of the total force in newton, and the newest frame for which it is known.
    recording : (str, bool) or None
        State of a recording that the page controls, and whether it runs; None without a port.
    detected : Detected or None
        Answer of `lampest detect` after the newest watched frame; None if nothing watches.
    alarm : str
        Sentence of an alarm that is not acknowledged, or ''.
    acknowledged : frozenset of float
        Start times in s of acknowledged attachments.
    """

    source: str
    method: str
    state: str
    panel: Panel | None = None
    frames: int = 0
    lost: int = 0
    skipped: int = 0
    picture: Picture | None = None
    history: tuple[Point, ...] = ()
    model: str = ""
    zero: str = ""
    deviation: float = float("nan")
    deviation_of: int = 0
    recording: tuple[str, bool] | None = None
    detected: Detected | None = None
    alarm: str = ""
    acknowledged: frozenset[float] = frozenset()

    @property
    def detection(self) -> Content | None:
        """Content of the answer, or None before the first one."""
        return None if self.detected is None else self.detected.content()


def with_detected(view: View, detected: Detected) -> View:
    """Return the view with a new answer.

    An attached lamprey raises an alarm that stays until acknowledged.
    """
    raised = any(since not in view.acknowledged for since in alarming(detected))
    return replace(view, detected=detected, alarm=detected.sentence if raised else view.alarm)


def acknowledged(view: View) -> View:
    """Return the view without its alarm; present attachments raise no further one."""
    arrivals = () if view.detected is None else alarming(view.detected)
    return replace(view, alarm="", acknowledged=frozenset(arrivals))


@dataclass(frozen=True, eq=False)
class Message:
    """A frame for other programs, sent again after a change of the answer or the alarm.

    Attributes
    ----------
    panel : Panel
    picture : Picture
        The frame.
    view : View
        The view when it was solved.
    """

    panel: Panel
    picture: Picture
    view: View

    @classmethod
    def of(cls, view: View) -> "Message | None":
        """Return the newest frame of a view, or None."""
        if view.panel is None or view.picture is None:
            return None
        return cls(view.panel, view.picture, view)

    @property
    def signature(self) -> tuple[int, str, str]:
        """Frame number, sentence of the answer and alarm, in this order.

        Messages of equal signature are not sent twice.
        """
        detected = self.view.detected
        return self.picture.number, "" if detected is None else detected.sentence, self.view.alarm

    @property
    def maps(self) -> dict[str, Array]:
        """Maps (rows, columns) in the order of MAP_UNITS, NaN if the frame failed."""
        picture = self.picture
        estimates = (picture.relative_change, picture.pressure, picture.cell_resistance)
        failed = np.full(self.panel.shape, np.nan)
        return {
            name: failed if values is None else values
            for name, values in zip(MAP_UNITS, estimates, strict=True)
        }

    @property
    def solved(self) -> bool:
        """Whether the frame was solved."""
        return self.picture.verdict != UNSOLVED

    def row(self) -> Array:
        """Return the frame as a row of numbers in the order of `channels`; unknown ones are NaN."""
        picture = self.picture
        verdict = VERDICTS.index(picture.verdict)
        head = [picture.number, picture.force.newton, verdict, self.solved]
        known = {"force_sd": self.view.deviation}
        detected = self.view.detected
        if detected is not None:
            known["answer"] = ANSWERS.index(detected.answer)
            known["probability"] = detected.probability
            known["alarm"] = bool(self.view.alarm)
            attachment = detected.chosen
            if attachment is not None:
                pairs = {name: getattr(attachment, name) for name in PAIRS}
                known |= {name: pair[0] for name, pair in pairs.items() if pair is not None}
                known["since_s"] = attachment.since_s
                if attachment.until_s is not None:
                    known["until_s"] = attachment.until_s
        tail = [known.get(name, np.nan) for name in TAIL]
        return np.concatenate([head, *map(np.ravel, self.maps.values()), tail])

    def channels(self) -> list[Channel]:
        """Return the descriptions of the numbers of `row`."""
        panel = self.panel
        places = (panel.places_mm / 1000).reshape(2, -1).T.tolist()
        cells = [
            Channel(f"{name}_{row}_{column}", unit, (x, y) if panel.present[row, column] else None)
            for name, unit in MAP_UNITS.items()
            for (row, column), (x, y) in zip(np.ndindex(panel.shape), places, strict=True)
        ]
        return [*starmap(Channel, HEAD.items()), *cells, *starmap(Channel, TAIL.items())]

    def content(self, sent_at: float) -> Content:
        """Return the content by docs/reference/stream.schema.json.

        `sent_at` is in s since 1970-01-01 UTC.
        """
        picture = self.picture
        view = self.view
        maps = self.maps
        saturated = () if picture.saturated is None else np.flatnonzero(picture.saturated).tolist()
        return {
            "format": FORMAT,
            "sequence": picture.number,
            "time": picture.time,
            "panel": _panel(self.panel),
            **{
                name: _numbers(maps[name], digits)
                for name, digits in (("cells", 2), ("change", 3), ("pressure", 4))
            },
            "force": _number(picture.force.newton, 4),
            "force_saturated": picture.force.saturated,
            "force_sd": _number(view.deviation, 4),
            "force_sd_of": view.deviation_of or None,
            "verdict": picture.verdict,
            "detection": view.detection,
            "alarm": view.alarm,
            "health": {
                "solved": self.solved,
                "status": picture.status,
                "arrived": picture.arrived,
                "sent": sent_at,
                "solve_seconds": picture.seconds,
                "leaps": picture.outliers,
                "open": np.flatnonzero(picture.open_cell).tolist(),
                "saturated": saturated,
                **{
                    name: getattr(view, name)
                    for name in ("lost", "skipped", "state", "model", "zero")
                },
            },
        }

    def text(self) -> str:
        """Return the message as a line of JSON."""
        return json.dumps(self.content(time.time()), **COMPACT)


def view_text(view: View, sent_at: float, known: int = 0) -> str:
    """Return a line of JSON for the page: view, message, and history after frame `known`.

    The message is that of other programs without `cells` and `pressure`, with `measured` (percent),
    `passed` (frames skipped for this one), `centre`, and `board` (percent) where the board
    estimated; `detection` and `alarm` stand in the view. `sent_at` is in s since 1970-01-01 UTC.
    """
    first = bisect_right(view.history, known, key=lambda point: point.number)
    message = Message.of(view)
    picture = None
    if message and message.picture.number > known:
        elsewhere = ("cells", "pressure", "detection", "alarm")
        content = message.content(sent_at)
        picture = {name: value for name, value in content.items() if name not in elsewhere}
        picture |= {
            "measured": _numbers(message.picture.measured_change, 2),
            "passed": message.picture.skipped,
            "centre": _centre(message),
        }
        if (board := message.picture.board_change) is not None:
            picture["board"] = _numbers(board, 2)
    as_they_are = (
        "source",
        "method",
        "state",
        "model",
        "zero",
        "frames",
        "lost",
        "skipped",
        "alarm",
    )
    content = {name: getattr(view, name) for name in as_they_are} | {
        "deviation": _number(view.deviation, 4),
        "detection": view.detection,
        "recording": view.recording and {"said": view.recording[0], "on": view.recording[1]},
        "sent": sent_at,
        "panel": view.panel and _panel(view.panel),
        "picture": picture,
        "history": [[point.time, _number(point.total, 4)] for point in view.history[first:]],
    }
    return json.dumps(content, **COMPACT)


def _centre(message: Message) -> list[float] | None:
    """Return the centre of pressure Σ p x/Σ p in mm over the pressed cells, or None."""
    picture = message.picture
    if picture.pressure is None or "pressing" not in picture.verdict:
        return None
    pressing = np.maximum(np.nan_to_num(picture.pressure), 0.0)
    return [
        round(float(np.nansum(pressing * at) / pressing.sum()), 1) for at in message.panel.places_mm
    ]


def _panel(panel: Panel) -> Content:
    """Return size, pitch in mm, modules and listed places of a panel, as messages have them."""
    about = {name: getattr(panel, name) for name in ("rows", "columns", "pitch_mm")}
    if panel.modules is not None:
        each = panel.modules.each
        about |= {"modules": [each.rows, each.columns], "seam_mm": panel.modules.seam_mm}
    if panel.cells is not None:
        x, y = panel.places_mm
        about |= {"x_mm": _numbers(x, 3), "y_mm": _numbers(y, 3)}
        if panel.heights_mm is not None:
            about["z_mm"] = _numbers(panel.heights_mm, 3)
    return about


def _numbers(values: Array, digits: int) -> list[float | None]:
    return [_number(value, digits) for value in values.ravel().tolist()]


def _number(value: float, digits: int) -> float | None:
    return round(value, digits) if isfinite(value) else None
