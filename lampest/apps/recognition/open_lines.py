"""Lines that opened while a panel is watched.

Suction raises the cells of a mouth. Only an open line raises nearly all resistances of a row or a
column.
"""

import numpy as np

from lampest.panel.panel import Array

# Resistances of an open line over those at rest, and the share of its readings that have them:
# mouths raise up to five cells of a row of ten.
OPEN_RATIO = 2.0
OPEN_SHARE = 0.8


def without_open_lines(measured: Array, sigma: Array, at_rest: Array) -> tuple[Array, list[str]]:
    """Return σ, infinite for the readings of open lines, and the lines, such as 'row 3'.

    Parameters
    ----------
    measured, sigma : array, shape (rows, columns)
        Resistances, ohm, and their standard deviations; one without a finite σ does not count.
    at_rest : array, shape (rows, columns)
        Resistances without a load, ohm.
    """
    counts = np.isfinite(sigma)
    raised = np.where(counts, measured, 0.0) / at_rest > OPEN_RATIO
    remaining = sigma.copy()
    lines = list[str]()
    for axis, name in enumerate(("row", "column")):
        read = np.maximum(counts.sum(axis=1 - axis), 1)
        opened = np.flatnonzero(raised.sum(axis=1 - axis) > OPEN_SHARE * read)
        np.moveaxis(remaining, axis, 0)[opened] = np.inf
        lines += [f"{name} {number}" for number in opened]
    return remaining, lines
