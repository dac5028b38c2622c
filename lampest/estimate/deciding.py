"""The frames that stand for a recording: at rest, and under the strongest load."""

import numpy as np
from numpy.typing import NDArray

from lampest.recording.readings import Readings, mean_change, strongest_frame
from lampest.recording.recording import UNLOADED, Recording

MAX_NEIGHBOURS = 2  # frames or networks that decide with the strongest one


def baseline_readings(recording: Recording, readings: Readings) -> Readings:
    """Return the mean of the unloaded frames.

    Without any, or where too little of them was read, the first frame of which enough was read.
    """
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    mean = readings[unloaded if len(unloaded) else [0]].mean()
    usable = np.flatnonzero(readings.enough(recording.scene))
    return mean if mean.enough(recording.scene) or not len(usable) else readings[usable[:1]].mean()


def deciding_frame(recording: Recording, readings: Readings, resting: Readings) -> int | None:
    """Return the measured frame, of those with enough readings, that differs most from rest.

    None where there is none.
    """
    frames = recording.measured_frames()
    frames = frames[readings.enough(recording.scene)[frames]]
    return strongest_frame(readings.plain_values, resting.value, frames) if len(frames) else None


def frames_beside(recording: Recording, readings: Readings, resting: Readings, frame: int) -> NDArray[np.intp]:
    """Return frames that decide with the deciding one: spread evenly over those that differ half as far from rest."""
    frames = recording.measured_frames()
    frames = frames[readings.enough(recording.scene)[frames]]
    change = mean_change(readings.plain_values, resting.value)
    loaded = frames[(change[frames] >= change[frame] / 2) & (frames != frame)]
    spread = np.linspace(0, len(loaded) - 1, MAX_NEIGHBOURS if len(loaded) else 0)
    return np.asarray(loaded[np.unique(spread.round().astype(int))])
