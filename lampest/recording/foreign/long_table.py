"""One value a line with its row and column; frames by their number, by their time, or by cells that come again."""

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.foreign.frames import Frames, check_count
from lampest.recording.foreign.headers import cell_of, line_of
from lampest.recording.foreign.table import ForeignTable
from lampest.recording.foreign.wide_table import timing_of

LARGEST_INDEX = 1e9


def frames_of_single_values(table: ForeignTable, shape: tuple[int, int], order: dict[str, int]) -> Frames:
    """Frames from lines that hold row, column and value, and the frame's number or time; what has no line is missing.

    Raises InputError where an index is none or beyond the panel, or a cell comes twice in a frame.
    """
    table.checked([order["value"]])
    rows, columns, first = _lines_of_cells(table, order, shape)
    frames, how = _frame_numbers(table, rows * shape[1] + columns, order)
    count = int(frames.max()) + 1
    check_count(table.source, count * shape[0] * shape[1])
    where = np.full((count, *shape), -1)
    for number, cell in enumerate(zip(frames.tolist(), rows.tolist(), columns.tolist(), strict=True)):
        if where[cell] >= 0:
            hint = "" if how else "; several frames need a field with the frame's number"
            earlier = table.called(int(where[cell]))
            raise InputError(f"{table.place(number, None)}: the same cell as in {earlier}{hint}")
        where[cell] = number
    values = np.where(where >= 0, table.numbers[np.maximum(where, 0), order["value"]], np.nan)
    begins = np.unique(frames, return_index=True)[1].tolist()
    times = [order[role] for role in ("date", "time") if role in order]
    said = ", ".join(sorted(order, key=order.__getitem__))
    notes = (*table.notes, f"one value a line as {said}; indices count from {first}{how}")

    def place(frame: int, row: int, column: int) -> str:
        line = int(where[frame, row, column])
        if line < 0:
            return f"{table.source}: row {row + first}, column {column + first} of frame {frame}"
        return table.place(line, order["value"])

    words = (table.names[order["value"]],) if table.names else ()
    return Frames(values, timing_of(table, times, begins), notes, place, words)


def _lines_of_cells(
    table: ForeignTable, order: dict[str, int], shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Row and column of all lines from 0, and where the file counts from; one field may name or number the cell."""
    if {"row", "column"} <= set(order):
        rows, columns = _indices(table, order["row"]), _indices(table, order["column"])
    else:
        texts = table.fields[:, order["cell"]]
        cells = {text: cell_of(text) for text in set(texts)}
        if not all(cells.values()):
            numbers = _indices(table, order["cell"])
            first = 0 if numbers.min() <= 0 else 1
            rows, columns = np.divmod(numbers - first, shape[1])
            _check_range(table, rows, columns, 0, shape, order)
            return rows, columns, first
        named = [cells[text] or (0, 0) for text in texts]
        rows, columns = np.array(named, dtype=np.int64).T
    first = 0 if min(rows.min(), columns.min()) <= 0 else 1
    _check_range(table, rows, columns, first, shape, order)
    return rows - first, columns - first, first


def _indices(table: ForeignTable, field: int) -> NDArray[np.int64]:
    """Row or column numbers of all lines: 3, R3 or 'row 3'."""
    values = table.numbers[:, field].copy()
    unread = table.words[:, field]
    texts = table.fields[:, field]
    lines = {text: line_of(text) for text in set(texts[unread])}
    values[unread] = [np.nan if (line := lines[text]) is None else line[1] for text in texts[unread]]
    bad = ~np.isfinite(values) | (values != np.round(values)) | (np.abs(values) > LARGEST_INDEX)
    if np.any(bad):
        at = int(np.argmax(bad))
        raise InputError(f"{table.place(at, field)}: {texts[at][:40] or 'nothing'} is no index")
    return values.astype(np.int64)


def _check_range(
    table: ForeignTable,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    first: int,
    shape: tuple[int, int],
    order: dict[str, int],
) -> None:
    """Raise InputError for the first number beyond the panel."""
    for name, values, size in (("row", rows, shape[0]), ("column", columns, shape[1])):
        bad = (values < first) | (values >= first + size)
        if np.any(bad):
            at = int(np.argmax(bad))
            place = table.place(at, order.get(name, order.get("cell")))
            raise InputError(f"{place}: {name} {values[at]} is beyond the panel's {first} to {first + size - 1}")


def _frame_numbers(
    table: ForeignTable, cells: NDArray[np.int64], order: dict[str, int]
) -> tuple[NDArray[np.intp], str]:
    """Each line's frame from 0, and how frames are told apart; nothing where all lines are one frame."""
    if "frame" in order:
        return _ranks(_indices(table, order["frame"]).astype(float)), ""
    if "time" not in order:
        return np.zeros(len(cells), dtype=np.intp), ""
    texts = table.fields[:, [order[role] for role in ("date", "time") if role in order]]
    stamps = np.array([" ".join(line) for line in texts])
    _, begins, frames = np.unique(stamps, return_index=True, return_inverse=True)
    if len(begins) < len(cells) or len(cells) == 1:
        by_line = np.argsort(np.argsort(begins))  # in the order in which they come
        return by_line[frames], "; frames by their time"
    return _scans(cells), "; every line has a time of its own, a new frame begins where a cell comes again"


def _ranks(values: Array) -> NDArray[np.intp]:
    return np.unique(values, return_inverse=True)[1]


def _scans(cells: NDArray[np.int64]) -> NDArray[np.intp]:
    frame, seen = 0, set[int]()
    frames = np.zeros(len(cells), dtype=np.intp)
    for line, cell in enumerate(cells.tolist()):
        if cell in seen:
            frame, seen = frame + 1, set()
        seen.add(cell)
        frames[line] = frame
    return frames
