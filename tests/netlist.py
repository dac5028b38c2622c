"""A panel as a list of resistors, solved as such: an oracle that shares nothing with the house. No test stands here."""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from lampest import Array, Scene

Resistor = tuple[int, int, float]


def resistors(cells: Array, scene: Scene) -> Iterable[Resistor]:
    """(node, node, ohm) of cells (rows, columns) ohm and all wire; nodes 0 … M + N − 1 are the terminals, rows first.

    Of every crossing the row's node is M + N + 2·number, the column's the next one; behind the contacts, the lines' own
    nodes come last.
    """
    rows, columns = cells.shape
    lines, faults = scene.lines, scene.faults
    row_ohm, column_ohm = (0.0, 0.0) if lines is None else (lines.row_ohm_per_cell, lines.column_ohm_per_cell)

    def crossing(row: int, column: int) -> int:
        return rows + columns + 2 * (row * columns + column)

    behind = rows + columns + 2 * rows * columns
    contacts = np.zeros(rows + columns) if scene.contacts is None else scene.contacts.mean((rows, columns))
    yield from ((line, behind + line, float(ohm)) for line, ohm in enumerate(contacts))
    for row in range(rows):
        order = list(range(columns))
        if lines is not None and lines.rows_enter == "right":
            order.reverse()
        chain = [behind + row, *(crossing(row, column) for column in order)]
        yield from ((one, other, row_ohm) for one, other in pairwise(chain))
    for column in range(columns):
        order = list(range(rows))
        if lines is None or lines.columns_leave == "bottom":
            order.reverse()
        chain = [behind + rows + column, *(crossing(row, column) + 1 for row in order)]
        yield from ((one, other, column_ohm) for one, other in pairwise(chain))
    for row in range(rows):
        for column in range(columns):
            yield crossing(row, column), crossing(row, column) + 1, float(cells[row, column])
    if faults is not None:
        yield from ((group[0], line, 0.0) for group in faults.joined_rows for line in group[1:])
        yield from ((rows + group[0], rows + line, 0.0) for group in faults.joined_columns for line in group[1:])


def impedance_of(cells: Array, scene: Scene, ties: Array) -> Array:
    """Z (lines, lines) ohm between the terminals, ties (lines) siemens to ground; nodes joined by 0 ohm are one."""
    parts = list(resistors(cells, scene))
    lines, count = sum(cells.shape), 1 + max(max(one, other) for one, other, _ in parts)
    name = list(range(count))
    for one, other, ohm in parts:
        if ohm == 0:
            first, second = sorted((name[one], name[other]))
            name = [first if label == second else label for label in name]
    labels = sorted(set(name))
    node = [labels.index(label) for label in name]
    matrix = np.zeros((len(labels), len(labels)))
    for one, other, ohm in parts:
        if ohm:
            pair = [node[one], node[other]]
            matrix[np.ix_(pair, pair)] += np.array([[1, -1], [-1, 1]]) / ohm
    for line in range(lines):
        matrix[node[line], node[line]] += ties[line]
    potentials = np.linalg.inv(matrix)
    return np.asarray(potentials[np.ix_(node[:lines], node[:lines])])
