"""Which of its ways a table has of holding a panel: frames in lines, single values, or blocks of rows."""

import numpy as np

from lampest.files.errors import InputError
from lampest.recording.foreign.blocks import frames_in_blocks
from lampest.recording.foreign.frames import Frames
from lampest.recording.foreign.headers import line_of, role_of
from lampest.recording.foreign.long_table import frames_of_single_values
from lampest.recording.foreign.table import ForeignTable
from lampest.recording.foreign.wide_table import cell_columns, frames_in_lines


def frames_of(table: ForeignTable, shape: tuple[int, int]) -> Frames:
    """The frames (frames, rows, columns) of a table by its header, and by how many fields its lines have.

    Raises InputError where neither tells, or something does not fit.
    """
    cells, names = shape[0] * shape[1], table.names
    order = _single_values(table, shape)
    if order is not None:
        return frames_of_single_values(table, shape, order)
    if names is not None:
        columns = cell_columns(table.source, names, shape)
        if columns is not None:
            return frames_in_lines(table, shape, columns)
    others = 0 if names is None else sum(role_of(name) in ("time", "date", "frame", "row") for name in names)
    if table.width in (cells, cells + 1, cells + others):
        return frames_in_lines(table, shape, None)
    if table.width in (shape[1], shape[1] + 1, shape[1] + others):
        return frames_in_blocks(table, shape)
    shorter = table.without_empty()
    if shorter.width < table.width:
        return frames_of(shorter, shape)
    turned = table.width in (shape[0], shape[0] + 1)
    raise InputError(
        f"{table.place(0, None)}: {table.width} fields; {shape[0]} × {shape[1]} cells need {cells}, {cells + 1} with "
        f"the time, or 3 or 4 for row, column, value and frame, or {shape[1]} in a line for each row"
        + ("; with --transpose it would fit" if turned else "")
    )


def _single_values(table: ForeignTable, shape: tuple[int, int]) -> dict[str, int] | None:
    """Which field is row, column, value, frame, time or date in a table of single values; None for other tables."""
    cells = shape[0] * shape[1]
    if table.names is not None:
        roles = [role_of(name) for name in table.names]
        short = [name.strip().lower() for name in table.names]
        if {"r", "c"} <= set(short):  # beside a c, an r is no resistance
            roles[short.index("r")], roles[short.index("c")] = "row", "column"
        order = {role: roles.index(role) for role in reversed(roles) if role is not None}
        return order if "value" in order and ({"row", "column"} <= set(order) or "cell" in order) else None
    if table.width not in (3, 4) or table.width in (cells, cells + 1):
        return None
    if table.width in (shape[1], shape[1] + 1) and not _are_indices(table, shape):
        return None
    return dict(zip(("row", "column", "value", "frame"), range(table.width), strict=False))


def _are_indices(table: ForeignTable, shape: tuple[int, int]) -> bool:
    """Whether the first two fields of every line are a row and a column of the panel."""
    for field, size in enumerate(shape):
        numbers = table.numbers[:, field].copy()
        for line in np.flatnonzero(table.words[:, field]):
            named = line_of(table.fields[line, field])
            numbers[line] = np.nan if named is None else named[1]
        if not np.all((numbers == np.round(numbers)) & (numbers >= 0) & (numbers <= size)):
            return False
    return len(table.numbers) == 1 or bool(np.any(np.ptp(table.numbers[:, :2], axis=0) > 0))
