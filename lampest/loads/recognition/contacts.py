"""Contacts: neighbouring cells that conduct more than at rest.

A cover spreads pressure, and errors of the circuit change cells beside a heavy load a little. Both join what lies
apart. Contacts are therefore divided where the change between them is faint, as a watershed divides two lakes, and a
contact has the cells that changed by more than a share of its strongest one.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import NOISE_REACH
from lampest.loads.recognition.suction import MIN_FALL
from lampest.panel.panel import Array, Panel

# Of the strongest ln r0/r of a contact: cells with less are its surroundings. Between two feet under a soft cover it is
# a fifth, under the arch of one foot a half.
FAINT_SHARE = 0.3
GHOST_SHARE = 0.05  # of the strongest ln r0/r of all cells: errors of the circuit beside a heavy load


def contacts_of(panel: Panel, change: Array, sd: Array) -> list[NDArray[np.bool_]]:
    """Return the cells of every contact, boolean (rows, columns) each, the strongest one first.

    Parameters
    ----------
    panel : Panel
    change, sd : array, shape (rows, columns)
        ln r/r0 and its standard deviation. Only cells that conduct more count.
    """
    strength = -change
    clear = strength > np.maximum(MIN_FALL, NOISE_REACH * sd)
    if not clear.any():
        return []
    touched = clear & (strength > GHOST_SHARE * strength[clear].max())
    basin = _basins(panel, strength, touched)
    peaks = sorted(set(basin[touched]), key=lambda cell: -strength.flat[cell])
    return [touched & (basin == peak) & (strength >= FAINT_SHARE * strength.flat[peak]) for peak in peaks]


def _basins(panel: Panel, strength: Array, touched: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the number of the strongest cell of every touched cell's contact, (rows, columns); −1 elsewhere.

    Cells are added from the strongest to the weakest. A cell that connects two groups joins them unless it is faint for
    the weaker one.
    """
    first, second, _ = panel.neighbours
    beside: dict[int, list[int]] = {}
    for one, other in zip((*first, *second), (*second, *first), strict=True):
        beside.setdefault(int(one), []).append(int(other))
    basin = np.full(strength.size, -1, dtype=np.intp)
    for cell in np.argsort(-strength, axis=None, kind="stable"):
        if not touched.flat[cell]:
            continue
        peaks = {int(basin[near]) for near in beside.get(int(cell), []) if basin[near] >= 0}
        strongest = max(peaks, key=lambda peak: strength.flat[peak], default=int(cell))
        basin[cell] = strongest
        for peak in peaks - {strongest}:
            if strength.flat[cell] >= FAINT_SHARE * strength.flat[peak]:
                basin[basin == peak] = strongest
    return basin.reshape(strength.shape)
