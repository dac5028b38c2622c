"""Known faults of a panel.

Faults are cells and lines that are broken, lines that touch, and modules that are not read.
"""

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from lampest.files.typed import Configuration
from lampest.panel.panel import Mask, Modules, Panel

Places = tuple[tuple[int, int], ...]  # (row, column) of cells, or of modules
LinesOfSide = tuple[int, ...]  # numbers of rows, or of columns


@dataclass(frozen=True)
class Faults(Configuration):
    """Known faults by (row, column) or line; broken parts are removed from the model.

    Attributes
    ----------
    open : pairs of int
        Cells that carry no current.
    shorted : pairs of int
        Cells that join their lines; their readings carry no information.
    dead_rows, dead_columns : tuple of int
        Lines without contact: no readings, no current through their cells.
    dead_modules : pairs of int
        Modules that are not read; their cells are not estimated.
    joined_rows, joined_columns : tuples of int
        Groups of lines that touch at their terminals. Such lines are one node with equal readings,
        which determine only the sum of the conductances of their cells on one crossing line.

    >>> lampest.Faults(dead_rows=(1,)).open_cells(lampest.Panel(2, 3)).sum()
    np.int64(3)
    """

    open: Places = ()
    shorted: Places = ()
    dead_rows: LinesOfSide = ()
    dead_columns: LinesOfSide = ()
    joined_rows: tuple[LinesOfSide, ...] = ()
    joined_columns: tuple[LinesOfSide, ...] = ()
    dead_modules: Places = ()

    def open_cells(self, panel: Panel) -> Mask:
        """Return whether a cell carries no current, boolean (rows, columns)."""
        cells = np.zeros(panel.shape, dtype=bool)
        for row, column in self.open:
            cells[row, column] = True
        cells[list(self.dead_rows)] = True
        cells[:, list(self.dead_columns)] = True
        return cells

    def shorted_cells(self, panel: Panel) -> Mask:
        """Return whether a cell shorts its lines, boolean (rows, columns)."""
        return Faults(open=self.shorted).open_cells(panel)

    def blind(self, panel: Panel) -> Mask:
        """Return whether a reading is missing because of a fault, boolean (rows, columns)."""
        return replace(self, open=self.shorted).open_cells(panel)

    def joined(self, panel: Panel) -> tuple[LinesOfSide, ...]:
        """Return the groups of lines that are one node, by the numbers of the lines, rows first."""
        return (
            *self.joined_rows,
            *(tuple(panel.rows + line for line in group) for group in self.joined_columns),
        )

    def check(self, panel: Panel) -> None:
        """Raise ValueError unless all faults are on the panel, agree, and leave an intact part."""
        lines = self.dead_rows or self.dead_columns or self.joined_rows or self.joined_columns
        if panel.modules is not None and lines:
            raise ValueError(
                "faults: every module has lines of its own; "
                "name those under modules: [{at: ..., faults: ...}]"
            )
        for place in self.dead_modules:
            if not panel.has_module(place):
                raise ValueError(f"faults: there is no module {list(place)}")
        for row, column in (*self.open, *self.shorted):
            if not (0 <= row < panel.rows and 0 <= column < panel.columns):
                raise ValueError(f"faults: there is no cell [{row}, {column}]")
        for dead, joined, count, name in (
            (self.dead_rows, self.joined_rows, panel.rows, "row"),
            (self.dead_columns, self.joined_columns, panel.columns, "column"),
        ):
            touching = list(chain.from_iterable(joined))
            if any(len(group) < 2 for group in joined) or len(set(touching)) < len(touching):
                raise ValueError(
                    f"faults: joined_{name}s lists groups of two or more, each {name} once"
                )
            if set(touching) & set(dead):
                raise ValueError(f"faults: a {name} cannot be dead and joined to another")
            for line in (*dead, *touching):
                if not 0 <= line < count:
                    raise ValueError(f"faults: there is no {name} {line}")
        if np.any(self.open_cells(panel) & self.shorted_cells(panel)):
            raise ValueError("faults: a cell cannot be open and shorted")
        read = panel.present & ~self.blind(panel)
        conducting = panel.present & ~self.open_cells(panel)
        all_dead = len(set(self.dead_modules)) == panel.layout.count
        if not (read.any() and conducting.any()) or all_dead:
            raise ValueError("faults: nothing is left of the panel")

    def of_module(
        self, layout: Modules, number: int, module_faults: "Faults | None"
    ) -> "Faults | None":
        """Return the faults of one module by its own rows and columns, with its `module_faults`.

        The result is None without any.
        """
        rows, columns = layout.cells(number)
        module_faults = module_faults or Faults()

        def inside(cells: Places) -> list[tuple[int, int]]:
            return [
                (row - rows.start, column - columns.start)
                for row, column in cells
                if rows.start <= row < rows.stop and columns.start <= column < columns.stop
            ]

        merged = replace(
            module_faults,
            open=(*module_faults.open, *inside(self.open)),
            shorted=(*module_faults.shorted, *inside(self.shorted)),
        )
        return None if merged == Faults() else merged
