"""Tare: other frames of a recording as the unloaded ones."""

import re
import sys
from dataclasses import replace

import numpy as np

from lampest.files.errors import InputError
from lampest.recording.recording import MEASURED, UNLOADED, Recording


def frames_named(text: str, frames: int | None = None) -> range:
    """Return the range of frames for a text such as '40:50', frames 40 to 49.

    Either side may be omitted. `frames` is the number of frames of the recording, if it is known.
    Raises InputError for an invalid or empty range.
    """
    match = re.fullmatch(r"\s*(\d{0,9})\s*:\s*(\d{0,9})\s*", text)
    if match is None:
        raise InputError(
            f"--frames must be FIRST:END such as 40:50, which is 40 to 49, not {text!r}"
        )
    named = range(int(match[1] or 0), int(match[2] or frames or sys.maxsize))
    if frames is not None and not named.start < named.stop <= frames:
        raise InputError(
            f"--frames {text}: the recording has frames 0 to {frames - 1}, and some must be named"
        )
    return named


def tared(recording: Recording, frames: range) -> tuple[Recording, float]:
    """Return the recording with given frames as the only unloaded ones.

    Raises InputError if no measured frame would remain.

    Returns
    -------
    recording : Recording
    change : float
        Largest relative change of a reading from the first half of these frames to the second, or 0
        for a single frame.
    """
    if len(frames) == len(recording.role):
        raise InputError(
            f"{recording.name}: where all frames are unloaded, none is left to measure"
        )
    role = np.full(len(recording.role), MEASURED, dtype=np.uint8)
    role[frames.start : frames.stop] = UNLOADED
    shown = recording.readings()[frames.start : frames.stop].shown
    half = len(shown) // 2
    change = 0.0
    if half:
        known = np.isfinite(shown).all(axis=0)
        before = shown[:half, known].mean(axis=0)
        after = shown[half:, known].mean(axis=0)
        change = float(np.abs(after / before - 1).max(initial=0.0))
    return replace(recording, role=role), change
