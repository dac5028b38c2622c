"""Places that lines of a table name: rows, columns or cells of the panel.

Names count from 0 or 1. Which it is, the first lines of a file or a port settle once: a later line
alone does not show it.
"""

from collections.abc import Mapping

import numpy as np

from lampest.apps.foreign.arrays import Shape
from lampest.apps.foreign.table import ReadingsTable
from lampest.apps.foreign.words import cell_of
from lampest.panel.panel import Array, Mask


def places_named(table: ReadingsTable, roles: Mapping[str, int], shape: Shape, first: int) -> Array:
    """Return the row and the column that each line names, (lines, 2), counted from 0.

    Both are NaN where a line names none; lines that name a row alone begin in column 0. `first` is
    the number of the first row, column or cell.
    """
    if "cell" not in roles:
        rows = table.line_numbers(roles["row"]) - first
        begins = np.zeros(len(rows))
        columns = table.line_numbers(roles["column"]) - first if "column" in roles else begins
        return np.stack([rows, columns], axis=1)
    numbers = table.line_numbers(roles["cell"]) - first
    places = np.stack(np.divmod(np.where(np.isfinite(numbers), numbers, np.nan), shape[1]), axis=1)
    words = np.flatnonzero(table.words[:, roles["cell"]])
    texts = table.fields[words, roles["cell"]].tolist()
    cells = {text: cell_of(text) for text in set(texts)}
    for line, text in zip(words.tolist(), texts, strict=True):
        places[line] = np.subtract(cells[text] or places[line] + first, first)
    return places


def within_panel(places: Array, shape: Shape) -> Mask:
    """Return whether each row and column, (lines, 2), is one of the panel."""
    return np.asarray((places >= 0) & (places < shape) & (places == np.round(places)))


def first_number(table: ReadingsTable, roles: Mapping[str, int], shape: Shape) -> int:
    """Return the number from which lines count rows, columns or cells, 0 or 1.

    Fewer lines are beyond the panel then: a number may be cut at the beginning of a file or port.
    Where the lines of the panel leave it open, they count from 1.
    """
    zero, one = (
        within_panel(places_named(table, roles, shape, first), shape).all(axis=1)
        for first in (0, 1)
    )
    return int(one.sum() > zero.sum() or (bool(np.any(one)) and np.array_equal(zero, one)))
