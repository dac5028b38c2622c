"""Wire resistance, contacts, touching lines, and leaks between the lines of a panel.

The path to every cell has one segment of wire more than the path to the previous cell; the first
cell has one segment, as in badcrossbar (Joksas & Mehonic, SoftwareX 12, 2020). A contact is in
series with the first segment. Lines touch between their contacts and their wire. Leaks lie between
the terminals of neighbouring lines.
"""

from dataclasses import dataclass
from math import inf
from typing import Literal

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import Configuration
from lampest.panel.lines import PerLine, as_tuple, check_lines, check_resistors, per_line
from lampest.panel.panel import Array, Mask, Numbers, Shape


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

    def mean(self, shape: Shape) -> Array:
        """Return the means of all lines, (lines,) ohm, rows first.

        Raises ValueError if a list has another length.
        """
        return self._of_lines("mean_ohm", shape)

    def deviation(self, shape: Shape) -> Array:
        """Return the standard deviations of all lines, (lines,) ohm.

        Raises ValueError if a list has another length.
        """
        return self._of_lines("sd_ohm", shape)

    def _of_lines(self, name: str, shape: Shape) -> Array:
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
        priors = []
        for side in (slice(rows), slice(rows, None)):
            priors.append(ContactPrior(tuple(mean[side].tolist()), tuple(deviation[side].tolist())))
        return cls(*priors)


@dataclass(frozen=True)
class NeighbourLeaks(Configuration):
    """Constant leaks between neighbouring lines, as one sheet of film under all strips has them.

    Attributes
    ----------
    rows, columns : PerLine
        Resistance in ohm between each two neighbouring rows, and columns: a number, or one for each
        gap. Infinite: none.

    >>> lampest.NeighbourLeaks(rows=6000.0).columns
    inf
    """

    rows: PerLine = inf
    columns: PerLine = inf

    def __post_init__(self) -> None:
        for side, value in (("rows", self.rows), ("columns", self.columns)):
            finite = tuple(ohm for ohm in as_tuple(value) if ohm != inf)
            if finite or value == ():
                check_resistors(f"leak_ohm.{side}", finite)
        if min(*as_tuple(self.rows), *as_tuple(self.columns)) == inf:
            raise ValueError("leak_ohm names no leak: give rows, columns or both")

    def check(self, shape: tuple[int, int]) -> None:
        """Raise ValueError if the leaks do not fit the lines of a panel."""
        for side, value, lines in zip(
            ("rows", "columns"), (self.rows, self.columns), shape, strict=True
        ):
            if lines == 1 and min(as_tuple(value)) < inf:
                raise ValueError(f"leak_ohm.{side}: a single line has no neighbour to leak to")
            if isinstance(value, tuple) and len(value) != lines - 1:
                raise ValueError(
                    f"leak_ohm.{side} lists {len(value)} numbers, but {lines} {side} have "
                    f"{lines - 1} gaps"
                )

    def between(self, shape: Shape) -> tuple[Numbers, Array]:
        """Return the lines and the conductances of all leaks, (2, leaks) and (leaks,) siemens."""
        rows, columns = shape
        first = np.delete(np.arange(rows + columns - 1), rows - 1)
        ohm = np.concatenate(
            [
                per_line("leak_ohm.rows", self.rows, rows - 1),
                per_line("leak_ohm.columns", self.columns, columns - 1),
            ]
        )
        leaking = np.isfinite(ohm)
        return np.stack([first, first + 1])[:, leaking], 1 / ohm[leaking]


@dataclass(frozen=True)
class Wiring:
    """Lines, contacts, joined lines and leaks of a panel.

    Attributes
    ----------
    lines : Lines
        Wire of the lines.
    joined : tuple of tuple of int
        Groups of lines that touch, by their numbers, rows first.
    contacts : Contacts or None
        Prior of the contacts.
    leaks : NeighbourLeaks or None
        Leaks between neighbouring lines.
    """

    lines: Lines = Lines()
    joined: tuple[tuple[int, ...], ...] = ()
    contacts: Contacts | None = None
    leaks: NeighbourLeaks | None = None

    @property
    def at_terminals(self) -> bool:
        """Whether cells lie at the terminals: no wire, contact or touching line is between them."""
        return not (self.joined or self.lines.resist or self.contacts is not None)

    def leak_admittance(self, shape: Shape) -> Array | None:
        """Return the Laplacian of the leaks, (lines, lines) siemens; None without leaks."""
        if self.leaks is None:
            return None
        (first, second), siemens = self.leaks.between(shape)
        admittance = np.zeros((sum(shape),) * 2)
        admittance[first, second] = admittance[second, first] = -siemens
        np.einsum("ii->i", admittance)[:] = -admittance.sum(axis=1)
        return admittance

    def connecting(self, conducting: Mask) -> Mask:
        """Return the crossings (rows, columns) that connect a row and a column, leaks included.

        `conducting` are the crossings whose cells do. Lines count as one where all gaps of their
        side leak.
        """
        if self.leaks is not None:
            for axis, value in enumerate((self.leaks.rows, self.leaks.columns)):
                if max(as_tuple(value)) < inf:
                    conducting = conducting | conducting.any(axis=axis, keepdims=True)
        return conducting

    def contact_ohm(self, shape: Shape) -> Array:
        """Return the mean contact resistances, (lines,) ohm; zero without contacts."""
        return np.zeros(sum(shape)) if self.contacts is None else self.contacts.mean(shape)

    def path_ohm(self, shape: Shape) -> Array:
        """Return the resistance of wire and contacts of every cell, (rows, columns) ohm.

        The path of a cell leads from terminal to terminal. Contacts count with their means plus
        NOISE_REACH standard deviations.
        """
        rows, _ = shape
        along, down = self.wire_ohm(shape)
        if self.contacts is None:
            return along + down
        most = self.contacts.mean(shape) + NOISE_REACH * self.contacts.deviation(shape)
        return along + down + most[:rows, None] + most[rows:]

    def wire_ohm(self, shape: Shape) -> tuple[Array, Array]:
        """Return the wire of rows, (1, columns), and columns, (rows, 1), to every cell in ohm."""
        rows, columns = shape
        along = np.arange(1, columns + 1)[None]
        down = np.arange(1, rows + 1)[:, None]
        along = along[:, ::-1] if self.lines.rows_enter == "right" else along
        down = down[::-1] if self.lines.columns_leave == "bottom" else down
        return self.lines.row_ohm_per_cell * along, self.lines.column_ohm_per_cell * down

    def nodes(self, count: int) -> Array:
        """Return E, (lines, nodes), 1 where a line belongs to a node.

        Lines that touch are one node.
        """
        # Every line belongs to the node of the first line that its group names.
        first = np.arange(count)
        for group in self.joined:
            first[list(group)] = group[0]
        return np.asarray(first[:, None] == np.unique(first), dtype=float)


def connected_parts(conducting: Mask) -> Numbers | None:
    """Return the number of the connected part of each line, (lines,).

    The result is None if the cells connect all lines. `conducting`, (rows, columns), states which
    crossings conduct.
    """
    if conducting.all():
        return None
    from scipy.sparse import coo_array  # for panels with open cells
    from scipy.sparse.csgraph import connected_components

    row, column = np.nonzero(conducting)
    rows, columns = conducting.shape
    links = coo_array((np.ones(len(row)), (row, rows + column)), (rows + columns,) * 2)
    count, parts = connected_components(links, directed=False)
    return None if count == 1 else parts.astype(np.intp)
