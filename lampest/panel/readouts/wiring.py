"""Exact networks with wire resistance, contacts and touching lines between terminals and cells.

The path to every cell has one segment of wire more than the path to the previous cell; the first
cell has one segment, as in badcrossbar (Joksas & Mehonic, SoftwareX 12, 2020). A contact is in
series with the first segment. Lines touch between their contacts and their wire.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import Configuration
from lampest.panel.panel import Array
from lampest.panel.readouts.lines import PerLine, check_lines, per_line


@dataclass(frozen=True)
class Lines(Configuration):
    """Resistance of the lines themselves (conductive thread, ITO).

    Attributes
    ----------
    row_ohm_per_cell, column_ohm_per_cell : float
        Resistance in ohm of a row from column to column, and of a column from row to row. The
        segment from the terminal to the first cell has the same resistance. Zero: none.
    rows_enter : {'left', 'right'}
        Side of the rows' terminals; at the left, column 0 is the nearest.
    columns_leave : {'bottom', 'top'}
        Side of the columns' terminals; at the bottom, the last row is the nearest.

    >>> lampest.Lines(row_ohm_per_cell=1.0).resist
    True
    """

    row_ohm_per_cell: float = 0.0
    column_ohm_per_cell: float = 0.0
    rows_enter: Literal["left", "right"] = "left"
    columns_leave: Literal["bottom", "top"] = "bottom"

    def __post_init__(self) -> None:
        check_lines("row_ohm_per_cell", self.row_ohm_per_cell)
        check_lines("column_ohm_per_cell", self.column_ohm_per_cell)

    @property
    def resist(self) -> bool:
        """Whether there is any resistance."""
        return self.row_ohm_per_cell > 0 or self.column_ohm_per_cell > 0


@dataclass(frozen=True)
class ContactPrior(Configuration):
    """Prior of the contact resistances of one side's lines; a number, or one for each line.

    Attributes
    ----------
    mean_ohm, sd_ohm : PerLine
        Mean and standard deviation in ohm; a deviation of 0 means that the contact is known.

    >>> lampest.ContactPrior(mean_ohm=5.0, sd_ohm=2.0).sd_ohm
    2.0
    """

    mean_ohm: PerLine = 0.0
    sd_ohm: PerLine = 0.0

    def __post_init__(self) -> None:
        check_lines("mean_ohm", self.mean_ohm)
        check_lines("sd_ohm", self.sd_ohm)


@dataclass(frozen=True)
class Contacts(Configuration):
    """Prior of the resistance between every line and its terminal, the same in all frames.

    Attributes
    ----------
    rows, columns : ContactPrior
        Contacts of the lines of either side.

    >>> lampest.Contacts(rows=lampest.ContactPrior(5.0, 2.0)).rows.mean_ohm
    5.0
    """

    rows: ContactPrior = ContactPrior()
    columns: ContactPrior = ContactPrior()

    def mean(self, shape: tuple[int, ...]) -> Array:
        """Return the means of all lines, (lines,) ohm, rows first.

        Raises ValueError if a list has another length.
        """
        return self._of_lines("mean_ohm", shape)

    def deviation(self, shape: tuple[int, ...]) -> Array:
        """Return the standard deviations of all lines, (lines,) ohm.

        Raises ValueError if a list has another length.
        """
        return self._of_lines("sd_ohm", shape)

    def _of_lines(self, name: str, shape: tuple[int, ...]) -> Array:
        """Return a field of the priors for all lines, (lines,) ohm, rows first."""
        sides = zip(("rows", "columns"), (self.rows, self.columns), shape, strict=True)
        return np.concatenate(
            [
                per_line(f"contacts.{side}.{name}", getattr(lines, name), n)
                for side, lines, n in sides
            ]
        )

    @classmethod
    def of(cls, mean: Array, deviation: Array, rows: int) -> "Contacts":
        """Return the contacts from means and deviations, (lines,) ohm each, rows first."""
        means = np.asarray(mean, dtype=float).tolist()
        deviations = np.asarray(deviation, dtype=float).tolist()
        return cls(
            rows=ContactPrior(tuple(means[:rows]), tuple(deviations[:rows])),
            columns=ContactPrior(tuple(means[rows:]), tuple(deviations[rows:])),
        )


@dataclass(frozen=True)
class Wiring:
    """Lines, contacts and joined lines of a panel.

    Attributes
    ----------
    lines : Lines
        Wire of the lines.
    joined : tuple of tuple of int
        Groups of lines that touch, by their numbers, rows first.
    contacts : Contacts or None
        Prior of the contacts.
    """

    lines: Lines = Lines()
    joined: tuple[tuple[int, ...], ...] = ()
    contacts: Contacts | None = None

    def contact_ohm(self, shape: tuple[int, ...]) -> Array:
        """Return the mean contact resistances, (lines,) ohm; zero without contacts."""
        return np.zeros(sum(shape)) if self.contacts is None else self.contacts.mean(shape)

    def path_ohm(self, shape: tuple[int, ...]) -> Array:
        """Return the resistance of wire and contacts of every cell, (rows, columns) ohm.

        The path of a cell leads from terminal to terminal. Contacts count with their means plus
        NOISE_REACH standard deviations.
        """
        rows, columns = shape
        # Segments from the terminal of the row, and of the column, to every cell.
        along = np.arange(1, columns + 1)
        down = np.arange(1, rows + 1)
        along = along[::-1] if self.lines.rows_enter == "right" else along
        down = down[::-1] if self.lines.columns_leave == "bottom" else down
        wire = self.lines.row_ohm_per_cell * along + self.lines.column_ohm_per_cell * down[:, None]
        if self.contacts is None:
            return np.asarray(wire)
        most = self.contacts.mean(shape) + NOISE_REACH * self.contacts.deviation(shape)
        return np.asarray(wire + most[:rows, None] + most[rows:])

    def nodes(self, count: int) -> Array:
        """Return E, (lines, nodes), 1 where a line belongs to a node.

        Lines that touch are one node.
        """
        # Every line belongs to the node of the first line that its group names.
        first = np.arange(count)
        for group in self.joined:
            first[list(group)] = group[0]
        return np.asarray(first[:, None] == np.unique(first), dtype=float)
