"""What the page shows, at one moment, and the text that carries it to the browser."""

import json
from bisect import bisect_right
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array, Panel

POINTS = 1800


class Point(NamedTuple):
    """One frame in the history: its number, its time in s, and the total pressure in newton, NaN where it failed."""

    number: int
    time: float
    total: float


@dataclass(frozen=True, eq=False)
class Picture:
    """One reconstructed frame.

    number : of the frame, from 1 on. time : s, on the recording's axis. arrived : s since 1970-01-01 UTC.
    measured_change, relative_change : (rows, columns) percent of the baseline; the latter NaN where the frame failed.
    open_cell : (rows, columns) where a cell cannot be told from an open one. total : newton over the cells
    whose pressure the response tells, NaN where it failed.
    status : how the solve ended, a sentence. seconds : how long it took. skipped : frames passed over for this one.
    cell_resistance, pressure : (rows, columns) ohm and kPa; None where the frame failed. saturated : (rows, columns)
    where the response does not tell the pressure. verdict : one of `verdict.VERDICTS`. total_deviation : newton,
    standard deviation of the total; NaN where it is not known, or comes later. leaps : readings that leapt, in whose
    place the frames before stand.
    """

    number: int
    time: float
    arrived: float
    measured_change: Array
    relative_change: Array
    open_cell: NDArray[np.bool_]
    total: float
    status: str
    seconds: float
    skipped: int
    cell_resistance: Array | None = None
    pressure: Array | None = None
    saturated: NDArray[np.uint8] | None = None
    verdict: str = "unsolved"
    total_deviation: float = float("nan")
    leaps: int = 0


@dataclass(frozen=True, eq=False)
class View:
    """All that the page shows.

    source, method : where frames come from, and what reconstructs them. state : of the port or recording, a sentence.
    model : what is wrong with the scene's circuit or its noise, a sentence; empty where nothing was noticed.
    zero : when zero was taken anew last and why, a sentence; empty: it never was.
    recording : where one stands that the page may begin and end, a sentence, and whether it runs; None: without a port.
    deviation, deviation_of : of the total force, newton, and the number of the frame whose it is, the newest of which
    it is known. frames, lost, skipped : that arrived, were lost on the way here, and were not reconstructed.
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


def view_text(view: View, sent_at: float, known: int = 0) -> str:
    """One line of JSON: the view, its picture and its history as far as they are newer than frame `known`.

    What is no number is null, never a number. `sent_at` : s since 1970-01-01 UTC.
    """
    panel = view.panel
    picture = view.picture if view.picture and view.picture.number > known else None
    first = bisect_right(view.history, known, key=lambda point: point.number)
    content: dict[str, Any] = {
        "source": view.source,
        "method": view.method,
        "state": view.state,
        "model": view.model,
        "zero": view.zero,
        "deviation": _number(view.deviation, 4),
        "recording": view.recording and {"said": view.recording[0], "on": view.recording[1]},
        "sent": sent_at,
        "panel": panel and {"rows": panel.rows, "columns": panel.columns, "pitch_mm": panel.pitch_mm},
        "frames": view.frames,
        "lost": view.lost,
        "skipped": view.skipped,
        "picture": picture and _picture(picture, panel),
        "history": [[point.time, _number(point.total, 4)] for point in view.history[first:]],
    }
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def _picture(picture: Picture, panel: Panel | None) -> dict[str, Any]:
    return {
        "number": picture.number,
        "time": picture.time,
        "arrived": picture.arrived,
        "measured": [_number(value, 2) for value in picture.measured_change.ravel().tolist()],
        "cells": [_number(value, 2) for value in picture.relative_change.ravel().tolist()],
        "open": np.flatnonzero(picture.open_cell).tolist(),
        "total": _number(picture.total, 4),
        "saturated": 0 if picture.saturated is None else int(np.count_nonzero(picture.saturated)),
        "verdict": picture.verdict,
        "centre": _centre(picture, panel),
        "status": picture.status,
        "solved": isfinite(picture.total),
        "seconds": picture.seconds,
        "skipped": picture.skipped,
        "leaps": picture.leaps,
    }


def _centre(picture: Picture, panel: Panel | None) -> list[float] | None:
    """x and y in mm, Σ p x/Σ p over the cells that press; None where nothing does."""
    if panel is None or picture.pressure is None or "pressing" not in picture.verdict:
        return None
    pressing = np.maximum(np.nan_to_num(picture.pressure), 0.0)
    x, y = panel.centres_mm()
    total = pressing.sum()
    return [round(float(at), 1) for at in (pressing.sum(axis=0) @ x / total, pressing.sum(axis=1) @ y / total)]


def _number(value: float, digits: int) -> float | None:
    return round(value, digits) if isfinite(value) else None
