"""Frames that are called unloaded, and have a load.

The two successive frames that differ least are the quiet ones: what differs between them is noise.
A load changes some cells against these and leaves most as they are, where water, the supply and
the film move all of them.
"""

import numpy as np

from lampest.inference.readings.order import MIN_COVERED, cell_changes, scores
from lampest.panel.panel import Mask, Numbers
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

CELLS = MIN_COVERED**2  # that a load covers at least
# Change of these cells over the median one, beyond that of noise, water, the supply and creep.
MIN_CONTRAST = 6.0
MIN_FRAMES = 3  # unloaded ones: of two that differ, none is the quiet one


def loaded_frames(scene: Scene, readings: Readings, unloaded: Mask) -> Numbers:
    """Return the numbers of unloaded frames in which a load lies on a part of the panel.

    Parameters
    ----------
    scene : Scene
    readings : Readings
        (frames, rows, columns).
    unloaded : boolean array, shape (frames,)
    """
    seen = (readings.seen > 0) & unloaded[:, None, None]
    numbers = np.flatnonzero(seen.any(axis=(1, 2)))
    if len(numbers) < MIN_FRAMES or min(scene.panel.shape) < MIN_FRAMES or not scene.whole:
        return numbers[:0]
    at_rest = readings[numbers]
    both = seen[numbers[1:]] & seen[numbers[:-1]]
    squares = np.where(both, np.diff(np.log(at_rest.value), axis=0) ** 2, 0.0)
    count = both.sum(axis=(1, 2))
    if not count.any():
        return numbers[:0]
    steps = np.where(count > 0, squares.sum(axis=(1, 2)) / np.maximum(count, 1), np.inf)
    quiet = np.zeros(len(numbers), dtype=bool)
    first = int(np.argmin(steps))
    quiet[first : first + 2] = True
    changes = cell_changes(scene, at_rest, quiet)
    noise = changes.noise * np.sqrt(1 + 1 / changes.unloaded)
    found = [
        scores(image, noise).any()
        and np.sort(np.abs(image), axis=None)[-CELLS] > MIN_CONTRAST * np.median(np.abs(image))
        for image in changes.loaded
    ]
    return np.asarray(numbers[~quiet][np.array(found, dtype=bool)])
