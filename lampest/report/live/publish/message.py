"""The one message that all ways carry; docs/reference/stream.md explains it."""

import json
import time
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from lampest.panel.panel import Array, Panel
from lampest.report.live.verdict import UNSOLVED
from lampest.report.live.view import Picture, View

FORMAT = "lampest stream 1"


@dataclass(frozen=True, eq=False)
class Message:
    """One frame for other programs.

    panel : rows, columns, pitch. picture : the frame. view : what was shown when it was solved.
    """

    panel: Panel
    picture: Picture
    view: View

    @classmethod
    def of(cls, view: View) -> "Message | None":
        """The newest frame of a view; None where there is none yet."""
        return None if view.panel is None or view.picture is None else cls(view.panel, view.picture, view)

    @property
    def cells(self) -> Array:
        """(rows, columns) ohm; NaN where the frame failed."""
        return self._map(self.picture.cell_resistance)

    @property
    def pressure(self) -> Array:
        """(rows, columns) kPa; NaN where the frame failed."""
        return self._map(self.picture.pressure)

    @property
    def solved(self) -> bool:
        """Whether the frame has cells."""
        return self.picture.verdict != UNSOLVED

    def text(self) -> str:
        """One line of JSON, docs/reference/stream.schema.json; what is no number is null."""
        panel, picture, view = self.panel, self.picture, self.view
        saturated = np.zeros(panel.shape) if picture.saturated is None else picture.saturated
        content: dict[str, Any] = {
            "format": FORMAT,
            "sequence": picture.number,
            "time": picture.time,
            "panel": {"rows": panel.rows, "columns": panel.columns, "pitch_mm": panel.pitch_mm},
            "cells": _numbers(self.cells, 2),
            "change": _numbers(picture.relative_change, 3),
            "pressure": _numbers(self.pressure, 4),
            "force": _number(picture.total, 4),
            "force_sd": _number(view.deviation, 4),
            "force_sd_of": view.deviation_of or None,
            "verdict": picture.verdict,
            "health": {
                "solved": self.solved,
                "status": picture.status,
                "arrived": picture.arrived,
                "sent": time.time(),
                "solve_seconds": picture.seconds,
                "lost": view.lost,
                "skipped": view.skipped,
                "leaps": picture.leaps,
                "open": np.flatnonzero(picture.open_cell).tolist(),
                "saturated": np.flatnonzero(saturated).tolist(),
                "state": view.state,
                "model": view.model,
                "zero": view.zero,
            },
        }
        return json.dumps(content, allow_nan=False, separators=(",", ":"))

    def _map(self, held: Array | None) -> Array:
        return np.full(self.panel.shape, np.nan) if held is None else held


def _numbers(values: Array, digits: int) -> list[float | None]:
    return [_number(value, digits) for value in values.ravel().tolist()]


def _number(value: float, digits: int) -> float | None:
    return round(value, digits) if isfinite(value) else None
