"""What lies between the terminals of the lines and the cells: wire, contacts, lines that touch. All exact.

A row is a chain of cells at equal distances; every cell takes one segment of wire more than the one before it, the
first included, so that a row of N cells has N segments from its terminal to its last cell and none beyond. Columns are
alike. This is the convention of badcrossbar (Joksas & Mehonic, SoftwareX 12, 2020). A contact is in series with the
first segment. Lines that touch do so at their terminals, beyond the contacts.
"""

from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.readouts.ladder import Ladder
from lampest.panel.readouts.lines import PerLine, check_lines, per_line

RELAXED = 3.0  # standard deviations that a contact may be larger where it must not make a bound wrong


@dataclass(frozen=True)
class Lines:
    """Resistance of the lines themselves (conductive thread, ITO), in ohm for the way from one cell to the next.

    Parameters
    ----------
    row_ohm_per_cell, column_ohm_per_cell : of a row from column to column, and of a column from row to row; the way
        from the terminal to the first cell counts as one more. Zero: none.
    rows_enter : the side at which the rows' terminals are; at the left, column 0 is the nearest.
    columns_leave : the side at which the columns' terminals are; at the bottom, the last row is the nearest.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    row_ohm_per_cell: float = 0.0
    column_ohm_per_cell: float = 0.0
    rows_enter: Literal["left", "right"] = "left"
    columns_leave: Literal["bottom", "top"] = "bottom"

    def __post_init__(self) -> None:
        for name in ("row_ohm_per_cell", "column_ohm_per_cell"):
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or positive, and finite")

    @property
    def resist(self) -> bool:
        """Whether there is any resistance."""
        return self.row_ohm_per_cell > 0 or self.column_ohm_per_cell > 0


@dataclass(frozen=True)
class ContactPrior:
    """What is known beforehand of the contacts of one side's lines, in ohm: a number, or one for each line.

    Parameters
    ----------
    mean_ohm, sd_ohm : mean and standard deviation. sd_ohm 0: known.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    mean_ohm: PerLine = 0.0
    sd_ohm: PerLine = 0.0

    def __post_init__(self) -> None:
        check_lines("mean_ohm", self.mean_ohm)
        check_lines("sd_ohm", self.sd_ohm)


@dataclass(frozen=True)
class Contacts:
    """Resistance between every line and its terminal, the same in all frames, as far as it is known.

    Parameters
    ----------
    rows, columns : of the lines of either side.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    rows: ContactPrior = ContactPrior()
    columns: ContactPrior = ContactPrior()

    def mean(self, shape: tuple[int, ...]) -> Array:
        """(lines) ohm. Raises ValueError where a list has another length."""
        return self._of_lines("mean_ohm", shape)

    def deviation(self, shape: tuple[int, ...]) -> Array:
        """(lines) ohm. Raises ValueError where a list has another length."""
        return self._of_lines("sd_ohm", shape)

    def _of_lines(self, name: str, shape: tuple[int, ...]) -> Array:
        sides = zip(("rows", "columns"), (self.rows, self.columns), shape, strict=True)
        return np.concatenate(
            [per_line(f"contacts.{side}.{name}", getattr(prior, name), count) for side, prior, count in sides]
        )

    @classmethod
    def of(cls, mean: Array, deviation: Array, rows: int) -> "Contacts":
        """Of (lines) ohm each, rows first."""
        sides = (
            ContactPrior(*(tuple(map(float, part)) for part in both))
            for both in ((mean[:rows], deviation[:rows]), (mean[rows:], deviation[rows:]))
        )
        return cls(*sides)


@dataclass(frozen=True)
class Wiring:
    """lines : their wire. joined : groups of lines that touch, by their numbers, rows first. contacts : or None."""

    lines: Lines = Lines()
    joined: tuple[tuple[int, ...], ...] = ()
    contacts: Contacts | None = None

    def contact_ohm(self, shape: tuple[int, ...]) -> Array:
        """(lines) ohm, as far as it is known."""
        return np.zeros(sum(shape)) if self.contacts is None else self.contacts.mean(shape)

    def path_ohm(self, shape: tuple[int, ...]) -> Array:
        """Wire from terminal to terminal through every cell, (rows, columns) ohm; of contacts as much as may be."""
        rows, columns = shape
        along, down = np.arange(1, columns + 1), np.arange(1, rows + 1)
        if self.lines.rows_enter == "right":
            along = along[::-1]
        if self.lines.columns_leave == "bottom":
            down = down[::-1]
        wire = self.lines.row_ohm_per_cell * along + self.lines.column_ohm_per_cell * down[:, None]
        if self.contacts is None:
            return np.asarray(wire)
        most = self.contacts.mean(shape) + RELAXED * self.contacts.deviation(shape)
        return np.asarray(wire + most[:rows, None] + most[rows:])

    def nodes(self, count: int) -> Array:
        """E (lines, nodes): 1 where a line belongs to a node; lines that touch are one."""
        first = np.arange(count)
        for group in self.joined:
            first[list(group)] = min(group)
        return np.asarray(first[:, None] == np.unique(first), dtype=float)

    def side_by_side(self, shape: tuple[int, ...]) -> NDArray[np.intp] | None:
        """(rows·columns) the number of the pair of nodes that every cell joins; None where each has a pair of its own.

        Cells with one number are parallel, wire aside.
        """
        if not self.joined:
            return None
        node = self.nodes(sum(shape)).argmax(axis=1)
        pairs = node[: shape[0], None] * sum(shape) + node[shape[0] :]
        return np.asarray(np.unique(pairs, return_inverse=True)[1].ravel(), dtype=np.intp)

    def factor(self, cell_resistance: Array) -> Ladder:
        """K for cells (rows, columns) ohm, ready to be solved."""
        rows, columns = cell_resistance.shape
        lines = self.lines
        flip_rows, flip_columns = lines.columns_leave == "top", lines.rows_enter == "right"
        contact = np.split(self.contact_ohm((rows, columns)), [rows])
        ohm = (lines.row_ohm_per_cell, lines.column_ohm_per_cell)
        if columns <= rows:
            return Ladder.of(cell_resistance, False, (flip_rows, flip_columns), ohm, contact)
        return Ladder.of(cell_resistance, True, (not flip_columns, not flip_rows), ohm[::-1], contact[::-1])
