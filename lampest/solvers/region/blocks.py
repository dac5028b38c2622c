"""Blocks of cells: where they lie, and how they grow."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Block
from lampest.panel.panel import Array

MARGIN = 1  # cells round those that stand out: their neighbours feel a load, too


def grown(cells: NDArray[np.bool_], blocks: tuple[Block, ...]) -> tuple[Block, ...]:
    """The rectangles round neighbouring cells with a margin of one, and round earlier blocks; none overlap."""
    covered = covered_by(blocks, cells.shape)
    for row, column in np.argwhere(cells):
        covered[max(row - MARGIN, 0) : row + MARGIN + 1, max(column - MARGIN, 0) : column + MARGIN + 1] = True
    count = -1
    while count != int(covered.sum()):
        count = int(covered.sum())
        found = tuple(patches(covered))
        for block in found:
            covered[block] = True
    return found


def covered_by(blocks: tuple[Block, ...], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(rows, columns) which cells some block holds."""
    covered = np.zeros(shape, dtype=bool)
    for block in blocks:
        covered[block] = True
    return covered


def alone_among(values: Array, share: float) -> NDArray[np.bool_]:
    """(rows, columns) which values have at most one neighbour, corners included, that comes up to a share of them.

    A load of 2 × 2 cells has three; of two wild readings side by side each has one.
    """
    rows, columns = values.shape
    round_it = np.pad(values, 1)
    near = [
        round_it[1 + down : 1 + down + rows, 1 + right : 1 + right + columns] > share * values
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
        if down or right
    ]
    return np.asarray(np.sum(near, axis=0) <= 1)


def patches(cells: NDArray[np.bool_]) -> Iterator[Block]:
    """The rectangle round each group of cells that touch, corners included."""
    left = {(int(row), int(column)) for row, column in np.argwhere(cells)}
    while left:
        group = [left.pop()]
        for row, column in group:  # grows while it is walked through
            near = {(row + down, column + right) for down in (-1, 0, 1) for right in (-1, 0, 1)} & left
            left -= near
            group += near
        sides = [[cell[axis] for cell in group] for axis in (0, 1)]
        down, across = (slice(min(side), max(side) + 1) for side in sides)
        yield down, across


def area(block: Block) -> int:
    """Number of cells."""
    return int((block[0].stop - block[0].start) * (block[1].stop - block[1].start))


def widened(block: Block, by: int, shape: tuple[int, ...]) -> Block:
    """The block with so many more cells on every side, as far as the panel goes."""
    down, across = (
        slice(max(side.start - by, 0), min(side.stop + by, n)) for side, n in zip(block, shape, strict=True)
    )
    return down, across
