"""Blocks of cells: where they lie, and how they grow."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Block

MARGIN = 1  # cells round those that stand out: their neighbours feel a load, too


def grown(cells: NDArray[np.bool_], blocks: tuple[Block, ...]) -> tuple[Block, ...]:
    """The rectangles round neighbouring cells with a margin of one, and round earlier blocks; none overlap."""
    covered = np.zeros(cells.shape, dtype=bool)
    for row, column in np.argwhere(cells):
        covered[max(row - MARGIN, 0) : row + MARGIN + 1, max(column - MARGIN, 0) : column + MARGIN + 1] = True
    for block in blocks:
        covered[block] = True
    count = -1
    while count != int(covered.sum()):
        count = int(covered.sum())
        found = tuple(patches(covered))
        for block in found:
            covered[block] = True
    return found


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
