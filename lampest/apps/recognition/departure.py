"""Evidence that a load, which stood on the panel from the first frame, has left."""

import numpy as np

from lampest.apps.recognition.suction import MIN_RISE
from lampest.apps.recognition.verdict import Verdict
from lampest.files.levels import NOISE_REACH

MIN_RELIEVED = 3  # cells that rise where a load left: one or two are even by chance
# Of the unevenness of cells under a load, which is left where it has gone: films keep an eighth.
MAX_REMAINING = 0.25


def relieved_by_departure(verdict: Verdict) -> bool:
    """Return whether the first change of a panel is a load that left.

    Cells that a load leaves rise: half of those that changed, and at least MIN_RELIEVED. Before,
    their deviations from the median of all are as uneven as loads make them; afterwards they have
    less than MAX_REMAINING of the former sum of squares.

    Parameters
    ----------
    verdict : Verdict
        Recognition of the first change.
    """
    frame = verdict.frame
    intact = frame.panel.present & ~frame.baseline.scene.broken
    least = np.maximum(MIN_RISE, NOISE_REACH * frame.free_sd)
    changed = intact & (np.abs(frame.free_map) > least)
    risen = changed & (frame.free_map > 0)
    if risen.sum() < max(MIN_RELIEVED, changed.sum() / 2):
        return False
    before = frame.baseline.logarithm - np.median(frame.baseline.logarithm[intact])
    after = before + frame.free_map
    return bool(np.sum(after[changed] ** 2) < MAX_REMAINING * np.sum(before[changed] ** 2))
