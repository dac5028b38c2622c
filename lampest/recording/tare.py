"""Another zero for a recording: which frames are the unloaded ones."""

import re
from dataclasses import replace

import numpy as np

from lampest.files.errors import InputError
from lampest.recording.recording import MEASURED, UNLOADED, Recording

STILL = (
    0.01  # relative change of readings within the frames beyond which something may have come or gone: far above drift
)
LAST = 2**31


def frames_named(text: str, frames: int) -> range:
    """'40:50' → frames 40 to 49 as Python counts, from 0 on; either side may be left out.

    Raises InputError unless these are frames of a recording with so many.
    """
    named = frames_between(text, frames)
    first, end = named.start, named.stop
    if not first < end <= frames:
        raise InputError(f"--frames {text}: the recording has frames 0 to {frames - 1}, and some must be named")
    return range(first, end)


def frames_between(text: str, most: int = LAST) -> range:
    """The same of a recording of which nobody knows how many frames it has; most : where no end is named.

    Raises InputError unless the text names frames.
    """
    match = re.fullmatch(r"\s*(\d{0,9})\s*:\s*(\d{0,9})\s*", text)
    if match is None:
        raise InputError(f"--frames must be FIRST:END such as 40:50, which is 40 to 49, not {text!r}")
    return range(int(match[1] or 0), int(match[2] or most))


def tared(recording: Recording, frames: range) -> tuple[Recording, float]:
    """(the recording whose unloaded frames are these and no others, how much its readings change within them).

    All other frames are measured ones, those that were unloaded before, too; no reading changes. The change is the
    largest over the cells, relative, from the first half of the frames to the second; 0 for a single frame.

    Raises InputError where no frame would be left to measure.
    """
    if len(frames) == len(recording.role):
        raise InputError(f"{recording.name}: where all frames are unloaded, none is left to measure")
    role = np.full(len(recording.role), MEASURED, dtype=np.uint8)
    role[frames.start : frames.stop] = UNLOADED
    shown = recording.readings()[frames.start : frames.stop].shown
    half, change = len(shown) // 2, 0.0
    if half:
        known = np.isfinite(shown).all(axis=0)
        before, after = shown[:half, known].mean(axis=0), shown[half:, known].mean(axis=0)
        change = float(np.abs(after / before - 1).max(initial=0.0))
    return replace(recording, role=role), change
