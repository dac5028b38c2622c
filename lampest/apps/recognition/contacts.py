"""Contacts: neighbouring cells that conduct more than at rest.

A cover spreads pressure, and errors of the circuit change the neighbours of a heavy load a little.
Both join separate contacts. Contacts are therefore divided where the change between them is faint,
as a watershed divides two lakes, and a contact has the cells that changed by more than a share of
its strongest one. Errors of the cells must not explain a division: between the cells of one foot on
a real insole they did.
"""

import numpy as np

from lampest.apps.recognition.suction import MIN_FALL
from lampest.files.levels import NOISE_REACH
from lampest.panel.panel import Array, Mask, Numbers, Panel

# Of the strongest ln r0/r of a contact: cells with less are its surroundings. Between two feet
# under a soft cover it is a fifth, under the arch of one foot a half.
FAINT_SHARE = 0.3
SMALL_CELLS = 3
# Likewise for contacts of fewer cells: between two feet in a circuit with grounded lines up to
# 0.12.
SMALL_SHARE = 0.15
# Of the strongest ln r0/r of all cells: errors of the circuit beside a heavy load.
GHOST_SHARE = 0.05


def contacts_of(panel: Panel, change: Array, sd: Array) -> list[Mask]:
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
    basin = _basins(panel, strength, sd, touched)
    joined = _joined(panel, strength, sd, basin)
    clear_of = {
        peak: touched & (basin == peak) & ~_is_faint(strength, sd, peak)
        for peak in set(basin[touched])
    }
    peaks = sorted(set(joined[touched]), key=lambda cell: -strength.flat[cell])
    contacts = [
        np.any([clear_of[part] for part in set(basin[joined == peak])], axis=0) for peak in peaks
    ]
    least = SMALL_SHARE * strength[clear].max()
    return [
        cells for cells in contacts if cells.sum() >= SMALL_CELLS or strength[cells].max() >= least
    ]


def _is_faint(strength: Array, sd: Array, peak: int) -> Mask:
    """Return whether cells changed by clearly less than a share of a contact's strongest cell."""
    error = np.hypot(sd, FAINT_SHARE * sd.flat[peak])
    return FAINT_SHARE * strength.flat[peak] - strength > NOISE_REACH * error


def _cells_beside(panel: Panel) -> dict[int, list[int]]:
    """Return the numbers of the neighbours of every cell."""
    first, second, _ = panel.neighbours
    beside: dict[int, list[int]] = {}
    for cell, neighbour in zip((*first, *second), (*second, *first), strict=True):
        beside.setdefault(int(cell), []).append(int(neighbour))
    return beside


def _joined(panel: Panel, strength: Array, sd: Array, basin: Numbers) -> Numbers:
    """Return the basins, joined where the cells between them may have changed as they have.

    One such cell between two basins is enough. Of a cell whose readings are bounds, or of a dead
    line, nothing is known: it divides no contact.
    """
    joined = basin.copy()
    for cell, neighbours in _cells_beside(panel).items():
        if basin.flat[cell] >= 0:
            continue
        peaks = sorted(
            {int(joined.flat[near]) for near in neighbours} - {-1},
            key=lambda peak: -strength.flat[peak],
        )
        for peak in peaks[1:]:
            if not _is_faint(strength, sd, peak).flat[cell]:
                joined[joined == peak] = peaks[0]
    return joined


def _basins(panel: Panel, strength: Array, sd: Array, touched: Mask) -> Numbers:
    """Return the number of the strongest cell of every touched cell's contact.

    Shape (rows, columns); −1 elsewhere. Cells are added from the strongest to the weakest. A cell
    that connects two groups joins them unless it is faint for the weaker one.
    """
    beside = _cells_beside(panel)
    basin = np.full(strength.size, -1, dtype=np.intp)
    order = np.argsort(-strength, axis=None, kind="stable")
    for cell in order[touched.flat[order]]:
        peaks = {int(basin[near]) for near in beside.get(int(cell), []) if basin[near] >= 0}
        strongest = max(peaks, key=lambda peak: strength.flat[peak], default=int(cell))
        basin[cell] = strongest
        for peak in peaks - {strongest}:
            if not _is_faint(strength, sd, peak).flat[cell]:
                basin[basin == peak] = strongest
    return basin.reshape(strength.shape)
