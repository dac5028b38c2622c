"""Frames that are called unloaded, and have a load.

The two successive frames that differ least are the quiet ones: what differs between them is noise.
A load changes some cells against these and leaves most as they are, where water, the supply and
the film move all of them.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.inference.readings.order import cell_changes, scores
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

MAX_SHARE = 0.5  # of the cells that a load changes
MIN_FRAMES = 3  # unloaded ones: of two that differ, none is the quiet one


def loaded_frames(
    scene: Scene, readings: Readings, unloaded: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """Return the numbers of unloaded frames in which a load lies on a part of the panel.

    Parameters
    ----------
    scene : Scene
    readings : Readings
        (frames, rows, columns).
    unloaded : boolean array, shape (frames,)
    """
    numbers = np.flatnonzero(unloaded)
    if len(numbers) < MIN_FRAMES or min(scene.panel.shape) < MIN_FRAMES or not scene.whole:
        return numbers[:0]
    at_rest = readings[numbers]
    value = np.where(at_rest.seen > 0, at_rest.value, np.nan)
    steps = np.nanmean(np.diff(np.log(value), axis=0) ** 2, axis=(1, 2))
    quiet = np.zeros(len(numbers), dtype=bool)
    first = int(np.argmin(steps))
    quiet[first : first + 2] = True
    changes = cell_changes(scene, at_rest, quiet)
    noise = changes.noise * np.sqrt(1 + 1 / changes.unloaded)
    scored = np.array([scores(image, noise) != 0 for image in changes.loaded])
    share = scored.mean(axis=(1, 2))
    return np.asarray(numbers[~quiet][(share > 0) & (share < MAX_SHARE)])
