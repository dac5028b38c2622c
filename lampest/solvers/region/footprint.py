"""Whether a reading that stands out alone is a load's: a cell that changes leaves a footprint in its row and column.

A cell of an M × N panel moves the other readings of its row and column, all by about a 1/N or 1/M of what it moves its
own; a converter's error moves no other reading. And no cell, opened or shorted, moves its own reading by more than its
share of it, while an error may be of any size.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data
from lampest.panel.network import Network
from lampest.panel.panel import Array

HALF = 0.5  # of what a load would do: nearer to all of it than to nothing
UNSURE = 0.2  # of the same, a median's standard deviation: beyond, noise hides which of both it is
OF_MEDIAN = 1.2533  # √(π/2): standard deviation of a median of normal values, in units of a mean's


def moved_lines(
    network: Network, data: Data, change: Array, noise: Array, alone: NDArray[np.bool_], doubted: bool
) -> NDArray[np.bool_]:
    """(rows, columns) which of the readings that stand out alone come of their cells.

    change : of the logarithm of readings, beyond what `network` explains; NaN where it says nothing. noise : its
    standard deviation. doubted : whether those that noise leaves open are taken for errors.
    """
    found = np.zeros_like(alone)
    for row, column in np.argwhere(alone):
        found[row, column] = _moved(network, data, change, noise, (int(row), int(column)), doubted)
    return found


def _moved(network: Network, data: Data, change: Array, noise: Array, place: tuple[int, int], doubted: bool) -> bool:
    row, column = place
    block = (slice(row, row + 1), slice(column, column + 1))
    given = (data.measured[0][block], 1 / data.upper[0][block], np.ones((1, 1), dtype=bool))
    ahead = np.log(data.readout.fitted_block(network, block, *given).reading() / network.reading())
    if abs(ahead[place]) < HALF * abs(change[place]):
        return False
    common = np.nanmedian(change)
    for line, own in ((np.s_[row, :], column), (np.s_[:, column], row)):
        expected = float(np.median(np.delete(ahead[line], own))) if ahead[line].size > 1 else 0.0
        if expected == 0.0:
            continue
        others = np.delete(change[line], own)
        error = OF_MEDIAN * float(np.median(noise)) / np.sqrt(others.size) / abs(expected)
        seen = (float(np.nanmedian(others)) - common) / expected
        if (error <= UNSURE and seen < HALF) or (error > UNSURE and doubted):
            return False
    return True
