"""The time course of a load: approach, attachment, breathing rhythm, release."""

import dataclasses
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar

import numpy as np

from lampest.panel.panel import Array


@dataclass(frozen=True)
class Course:
    """Factors of contact and suction over time; the defaults are a load that is fully there from the first moment.

    Parameters
    ----------
    start_s : first touch, in seconds after the first measured frame; negative: before it, after the last unloaded one.
    approach_s : how long the contact grows to its full pressure; 0: at once.
    attachment_s : how long, after the approach, the suction grows; 0: at once.
    breathing_hz, breathing_depth : rhythm and relative amplitude by which contact and suction swing together.
    release_at_s, release_s : when the release begins, and how long it takes; None: never.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    start_s: float = 0.0
    approach_s: float = 0.0
    attachment_s: float = 0.0
    breathing_hz: float = 0.0
    breathing_depth: float = 0.0
    release_at_s: float | None = None
    release_s: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not (isfinite(value) and (value >= 0 or field.name == "start_s")):
                raise ValueError(f"{field.name} must be zero or positive, and finite")
        if self.breathing_depth >= 1:
            raise ValueError("breathing_depth must be below 1")

    def contact(self, time: Array) -> Array:
        """Factor of the contact pressure, (frames) s → 1."""
        touched = time - self.start_s
        return ramp(touched, self.approach_s) * self._breathing(touched) * self._held(time)

    def suction(self, time: Array) -> Array:
        """Factor of the suction, (frames) s → 1; it begins when the approach is over."""
        touched = time - self.start_s
        return ramp(touched - self.approach_s, self.attachment_s) * self._breathing(touched) * self._held(time)

    def _breathing(self, touched: Array) -> Array:
        return np.asarray(1 + self.breathing_depth * np.sin(2 * np.pi * self.breathing_hz * touched))

    def _held(self, time: Array) -> Array:
        if self.release_at_s is None:
            return np.ones_like(time)
        return 1 - ramp(time - self.release_at_s, self.release_s)


def ramp(time: Array, length: float) -> Array:
    """3x² − 2x³ with x = time/length held within 0 and 1; a step at 0 for no length."""
    if length == 0:
        return (time >= 0).astype(float)
    part = np.clip(time / length, 0, 1)
    return np.asarray(part**2 * (3 - 2 * part))
