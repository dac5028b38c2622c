"""Lines that opened while a panel is watched.

Suction raises the cells of a mouth. Only an open line raises nearly all resistances of a row or a
column.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from lampest.panel.panel import Array

# Resistances of an open line over those at rest, and the share of its readings that have them:
# mouths raise up to five cells of a row of ten.
OPEN_RATIO = 2.0
OPEN_SHARE = 0.8


class Line(NamedTuple):
    """A row or a column.

    Attributes
    ----------
    axis : int
        0 for rows, 1 for columns.
    number : int
    """

    axis: int
    number: int

    @property
    def name(self) -> str:
        """The line in words, such as 'row 3'."""
        return f"{('row', 'column')[self.axis]} {self.number}"


def open_lines(measured: Array, sigma: Array, at_rest: Array) -> list[Line]:
    """Return the open lines of a frame.

    Parameters
    ----------
    measured, sigma : array, shape (rows, columns)
        Resistances, ohm, and their standard deviations; one without a finite σ does not count.
    at_rest : array, shape (rows, columns)
        Resistances without a load, ohm.
    """
    counts = np.isfinite(sigma)
    raised = np.where(counts, measured, 0.0) / at_rest > OPEN_RATIO
    lines = list[Line]()
    for axis in (0, 1):
        read = np.maximum(counts.sum(axis=1 - axis), 1)
        opened = raised.sum(axis=1 - axis) > OPEN_SHARE * read
        lines += [Line(axis, int(number)) for number in np.flatnonzero(opened)]
    return lines


def without_lines(sigma: Array, lines: Iterable[Line]) -> Array:
    """Return σ, infinite for the readings of the lines."""
    excluded = sigma.copy()
    for line in lines:
        np.moveaxis(excluded, line.axis, 0)[line.number] = np.inf
    return excluded
