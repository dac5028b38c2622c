"""What is known to be broken of a panel, and what that leaves of its readings and cells."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.typed import Configuration
from lampest.panel.panel import Modules, Panel


@dataclass(frozen=True)
class Faults(Configuration):
    """What is known to be broken, by (row, column) or line; it leaves the model.

    open : cells that carry nothing. shorted : cells that join their lines; their readings say nothing.
    dead_rows, dead_columns : lines without contact: their readings say nothing, their cells carry nothing.
    dead_modules : modules by (row, column) that are not read at all: nothing is known of their cells.
    joined_rows, joined_columns : groups of lines that touch each other at their terminals: they are one node, either is
        read alike, and of their cells on one crossing only the sum of conductances is ever seen.

    >>> lampest.Faults(dead_rows=(1,)).open_cells(lampest.Panel(2, 3)).sum()
    np.int64(3)
    """

    open: tuple[tuple[int, int], ...] = ()
    shorted: tuple[tuple[int, int], ...] = ()
    dead_rows: tuple[int, ...] = ()
    dead_columns: tuple[int, ...] = ()
    joined_rows: tuple[tuple[int, ...], ...] = ()
    joined_columns: tuple[tuple[int, ...], ...] = ()
    dead_modules: tuple[tuple[int, int], ...] = ()

    def open_cells(self, panel: Panel) -> NDArray[np.bool_]:
        """(rows, columns) where a cell carries nothing."""
        cells = np.zeros(panel.shape, dtype=bool)
        for row, column in self.open:
            cells[row, column] = True
        cells[list(self.dead_rows)] = True
        cells[:, list(self.dead_columns)] = True
        return cells

    def shorted_cells(self, panel: Panel) -> NDArray[np.bool_]:
        return Faults(open=self.shorted).open_cells(panel)

    def blind(self, panel: Panel) -> NDArray[np.bool_]:
        """(rows, columns) where a reading is missing."""
        return replace(self, open=self.shorted).open_cells(panel)

    def joined(self, panel: Panel) -> tuple[tuple[int, ...], ...]:
        """Groups of lines that are one node, by the numbers of lines, rows first."""
        return (*self.joined_rows, *(tuple(panel.rows + line for line in group) for group in self.joined_columns))

    def check(self, panel: Panel) -> None:
        """Raise ValueError unless every fault lies on the panel, none is two things at once, and something is left."""
        layout, lines = panel.modules, self.dead_rows or self.dead_columns or self.joined_rows or self.joined_columns
        if layout is not None and lines:
            raise ValueError(
                "faults: every module has lines of its own; name those under modules: [{at: ..., faults: ...}]"
            )
        for place in self.dead_modules:
            if layout is None or not (0 <= place[0] < layout.rows and 0 <= place[1] < layout.columns):
                raise ValueError(f"faults: there is no module {list(place)}")
        for row, column in (*self.open, *self.shorted):
            if not (0 <= row < panel.rows and 0 <= column < panel.columns):
                raise ValueError(f"faults: there is no cell [{row}, {column}]")
        sides = (
            (self.dead_rows, self.joined_rows, panel.rows, "row"),
            (self.dead_columns, self.joined_columns, panel.columns, "column"),
        )
        for dead, joined, count, name in sides:
            touching = [line for group in joined for line in group]
            if any(len(group) < 2 for group in joined) or len(set(touching)) < len(touching):
                raise ValueError(f"faults: joined_{name}s lists groups of two or more, each {name} once")
            if set(touching) & set(dead):
                raise ValueError(f"faults: a {name} cannot be dead and joined to another")
            for line in (*dead, *touching):
                if not 0 <= line < count:
                    raise ValueError(f"faults: there is no {name} {line}")
        if np.any(self.open_cells(panel) & self.shorted_cells(panel)):
            raise ValueError("faults: a cell cannot be open and shorted")
        read, conducting = (panel.present & ~gone for gone in (self.blind(panel), self.open_cells(panel)))
        all_dead = layout is not None and len(set(self.dead_modules)) == layout.count
        if not (read.any() and conducting.any()) or all_dead:
            raise ValueError("faults: nothing is left of the panel")

    def of_module(self, layout: Modules, number: int, own: "Faults | None") -> "Faults | None":
        """Of one module, by its own rows and columns: what lies on it, and what only it has; None: nothing."""
        rows, columns = layout.cells(number)
        own = own or Faults()

        def inside(cells: tuple[tuple[int, int], ...]) -> list[tuple[int, int]]:
            moved = ((row - rows.start, column - columns.start) for row, column in cells)
            return [
                place for place in moved if 0 <= place[0] < layout.each.rows and 0 <= place[1] < layout.each.columns
            ]

        merged = replace(own, open=(*own.open, *inside(self.open)), shorted=(*own.shorted, *inside(self.shorted)))
        return None if merged == Faults() else merged
