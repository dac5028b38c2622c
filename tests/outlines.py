"""Panels that are no full rectangle, as tests draw them."""

import numpy as np

from lampest import Panel

PITCH = 8.0


def foot(rng: np.random.Generator) -> Panel:
    """Half of the crossings of 8 × 6 lines, at random places of a lattice that lies askew."""
    cells = []
    half = PITCH / 2**0.5
    for row, column in (divmod(int(cell), 6) for cell in np.sort(rng.permutation(48)[:24])):
        # As tables do.
        cells.append(
            (row, column, round((row + column) * half, 1), round((row - column) * half, 1))
        )
    return Panel(8, 6, PITCH, tuple(cells))


def glove(rng: np.random.Generator) -> Panel:
    """Return five separate strips of four cells, with two rows and two columns each."""
    cells = [
        (2 * strip + at // 2, 2 * strip + at % 2, 20.0 * strip, PITCH * at)
        for strip in range(5)
        for at in range(4)
    ]
    return Panel(10, 10, PITCH, tuple(cells))


def ring(rng: np.random.Generator) -> Panel:
    """Electrodes round an arm: row j crosses columns j and j + 1."""
    cells = []
    for at in range(16):
        angle = 2 * np.pi * at / 16
        cells.append(
            (at // 2, (at + 1) // 2 % 8, 40 * float(np.cos(angle)), 40 * float(np.sin(angle)))
        )
    return Panel(8, 8, PITCH, tuple(cells))


def lonely(rng: np.random.Generator) -> Panel:
    """A block of 3 × 3, a cell on a row and a column of its own, and lines without any cell."""
    block = [(row, column, PITCH * column, PITCH * row) for row in range(3) for column in range(3)]
    return Panel(5, 5, PITCH, (*block, (4, 4, 60.0, 60.0)))


def hand(rng: np.random.Generator) -> Panel:
    """A palm of 4 × 5 and fingers of two to four cells above it, which share the palm's columns."""
    palm = [(row, column, PITCH * column, PITCH * row) for row in range(4) for column in range(5)]
    fingers = [
        (4 + at, column, 1.2 * PITCH * column, PITCH * (4.5 + at))
        for column, length in enumerate((2, 4, 4, 4, 3))
        for at in range(length)
    ]
    return Panel(8, 5, PITCH, (*palm, *fingers))


OUTLINES = {outline.__name__: outline for outline in (foot, glove, ring, lonely, hand)}
