"""Readings that stand out: blocks of cells round them, and which of those that stand out alone are a load's.

A cell of an M × N panel that changes leaves a footprint: it moves the other readings of its row and column, all by
about a 1/N or 1/M of what it moves its own. An error of the converter moves no other reading. And no cell, opened or
shorted, moves its own reading by more than its share of it, while an error may be of any size.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data
from lampest.panel.network import Block, Network
from lampest.panel.panel import Array

HALF = 0.5  # of what a load would do: nearer to all of it than to nothing
UNSURE = 0.2  # of the same, a median's standard deviation: beyond, noise hides which of both it is
OF_MEDIAN = 1.2533  # √(π/2): standard deviation of a median of normal values, in units of a mean's


def grown(cells: NDArray[np.bool_], blocks: tuple[Block, ...]) -> tuple[Block, ...]:
    """The rectangles round neighbouring cells with a margin of one, and round earlier blocks; none overlap."""
    covered = covered_by(blocks, cells.shape)
    for row, column in np.argwhere(cells):
        covered[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
    while True:
        found = tuple(_rectangles(covered))
        filled = covered_by(found, cells.shape)
        if np.array_equal(filled, covered):
            return found
        covered = filled


def _rectangles(cells: NDArray[np.bool_]) -> Iterator[Block]:
    """The rectangle round each group of cells that touch, corners included."""
    left = {(int(row), int(column)) for row, column in np.argwhere(cells)}
    while left:
        group = [left.pop()]
        for row, column in group:  # grows while it is walked through
            near = {(row + down, column + right) for down in (-1, 0, 1) for right in (-1, 0, 1)} & left
            left -= near
            group += near
        (top, first), (bottom, last) = np.min(group, axis=0).tolist(), np.max(group, axis=0).tolist()
        yield slice(top, bottom + 1), slice(first, last + 1)


def covered_by(blocks: tuple[Block, ...], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(rows, columns) which cells some block covers."""
    covered = np.zeros(shape, dtype=bool)
    for block in blocks:
        covered[block] = True
    return covered


def widened(block: Block, by: int, shape: tuple[int, ...]) -> Block:
    """The block with so many more cells on every side, as far as the panel goes."""
    sides = zip(block, shape, strict=True)
    down, across = (slice(max(side.start - by, 0), min(side.stop + by, n)) for side, n in sides)
    return down, across


def isolated(values: Array, share: float) -> NDArray[np.bool_]:
    """(rows, columns) which values have at most one neighbour, corners included, that exceeds a share of them.

    A load of 2 × 2 cells has three; of two outliers side by side each has one.
    """
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, 1), (3, 3))
    exceeds = around > share * values[:, :, None, None]
    return np.asarray(exceeds.sum(axis=(2, 3)) - exceeds[:, :, 1, 1] <= 1)


def has_footprint(network: Network, data: Data, change: Array, noise: Array, place: tuple[int, int]) -> bool:
    """Whether an isolated reading that stands out comes of its cell, as far as noise lets that be seen.

    change : of the logarithm of readings, beyond what `network` explains; NaN where unknown. noise : its deviation.
    """
    row, column = place
    block = (slice(row, row + 1), slice(column, column + 1))
    given = (data.measured[0][block], 1 / data.upper[0][block], np.ones((1, 1), dtype=bool))
    predicted = np.log(data.readout.fitted_block(network, block, *given).reading() / network.reading())
    if abs(predicted[place]) < HALF * abs(change[place]):
        return False
    common = np.nanmedian(change)
    for line, own in ((np.s_[row, :], column), (np.s_[:, column], row)):
        others = np.delete(change[line], own)
        expected = float(np.median(np.delete(predicted[line], own))) if others.size else 0.0
        if expected == 0.0:
            continue
        error = OF_MEDIAN * float(np.median(noise)) / np.sqrt(others.size) / abs(expected)
        observed = (float(np.nanmedian(others)) - common) / expected
        if error <= UNSURE and observed < HALF:
            return False
    return True
