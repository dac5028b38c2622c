"""Driven lines that are held at a potential all the time, each through its resistance: at the supply or at ground.

A resistance of zero has no tie, but its limit is plain: readings depart from it by Rd·ΣG of a driven line's cells,
which LEAST_DRIVE makes some 1e-8 of ordinary cells, below what any converter sees.
"""

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.lines import PerLine, Side, per_line

LEAST_DRIVE = 1e-6  # ohm
LEAST_REST = 1e-4  # the load's share of a sensed line's current, and it is small only where noise can make it nothing
LEAST_VOLTAGE = 1e-9  # of the frame's largest


def drives_of(drive_ohm: PerLine, lines: int) -> Array:
    """Rd (lines) ohm, never below LEAST_DRIVE."""
    return np.maximum(per_line("drive_ohm", drive_ohm, lines), LEAST_DRIVE)


def at_ideal_drives(driven: Side, share: Array, load: Array) -> Array:
    """r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij: cells (…, rows, columns) ohm that give v where Rd = 0.

    share : v (…, rows, columns), the sensed lines' voltages in units of the supply. load : Rs, all that stands between
    a sensed line and ground, to be broadcast to (rows, columns). Then no sensed line knows of another, and with its
    load or without, all others stay as they are.
    """
    voltage = np.maximum(share, LEAST_VOLTAGE * share.max(axis=(-2, -1), keepdims=True))
    rest = 1 - voltage.sum(axis=-2 if driven == "rows" else -1, keepdims=True)
    return np.asarray(load * np.maximum(rest, LEAST_REST) / voltage)
