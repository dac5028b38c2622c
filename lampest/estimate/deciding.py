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


def deciding_frames(
    recording: Recording, readings: Readings, resting: Readings
) -> NDArray[np.intp]:
    """Return the measured frame that differs most from rest, and frames that decide with it.

    These are spread evenly over the frames that differ half as far from rest. Frames without enough
    readings are left out.
    """
    frames = recording.measured_frames()
    frames = frames[readings.enough(recording.scene)[frames]]
    if not len(frames):
        return frames
    change = mean_change(readings.plain_values, resting.value)
    strongest = strongest_frame(readings.plain_values, resting.value, frames)
    loaded = frames[(change[frames] >= change[strongest] / 2) & (frames != strongest)]
    spread = np.linspace(0, len(loaded) - 1, MAX_NEIGHBOURS if len(loaded) else 0)
    return np.append(strongest, loaded[np.unique(spread.round().astype(int))])
