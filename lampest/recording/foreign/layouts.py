"""The ways in which a table holds a panel: a frame a line, a value a line, or blocks of rows."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.recording.foreign.blocks import frames_in_blocks
from lampest.recording.foreign.frames import Frames, check_count
from lampest.recording.foreign.table import ForeignTable, timing_of
from lampest.recording.foreign.words import cell_of, line_of, role_of

Cells = dict[int, tuple[int, int]]
LARGEST_INDEX = 1e9


def cell_columns(source: str, names: Sequence[str], shape: tuple[int, int]) -> tuple[Cells, str] | None:
    """Column → (row, column) of the cell that its name holds, and a sentence; None where names hold no cells.

    Raises InputError where a name is beyond the panel, or two are the same cell.
    """
    named = {field: cell for field, name in enumerate(names) if (cell := cell_of(name)) and not role_of(name)}
    if named:
        first = 0 if min(min(cell) for cell in named.values()) == 0 else 1
        cells = {field: (cell.row - first, cell.column - first) for field, cell in named.items()}
        seen: dict[tuple[int, int], int] = {}
        for field, (row, column) in cells.items():
            if seen.setdefault((row, column), field) != field:
                same = f"{names[seen[row, column]]!r} and {names[field]!r}"
                raise InputError(f"{source}: the header's {same} are the same cell")
            if row >= shape[0] or column >= shape[1]:
                turned = "; with --transpose it would fit" if row < shape[1] and column < shape[0] else ""
                sizes = f"{shape[0]} × {shape[1]} cells, counted from {first}"
                raise InputError(f"{source}: the header's {names[field]!r} is beyond the panel of {sizes}{turned}")
        example = f"{names[min(named)]!r} is row {cells[min(named)][0]}, column {cells[min(named)][1]}"
        left = shape[0] * shape[1] - len(cells)
        rest = f"; {left} cells have no column and are missing" if left else ""
        order = ", row by row" if list(cells.values()) == sorted(cells.values()) else ""
        return cells, f"cells by their names{order}, which count from {first} ({example}){rest}"
    return _numbered(names, shape)


def _numbered(names: Sequence[str], shape: tuple[int, int]) -> tuple[Cells, str] | None:
    """Columns that are called by one word and all numbers of the panel's cells."""
    lines = {field: line for field, name in enumerate(names) if (line := line_of(name)) and not role_of(name)}
    numbers = sorted(number for _, number in lines.values())
    count, words = shape[0] * shape[1], {word for word, _ in lines.values()}
    first = numbers[0] if numbers else 0
    if len(words) != 1 or first > 1 or numbers != list(range(first, first + count)):
        return None
    cells = {field: divmod(number - first, shape[1]) for field, (_, number) in lines.items()}
    return cells, f"cells by their numbers from {first}, row by row"


def frames_in_lines(table: ForeignTable, shape: tuple[int, int], named: tuple[Cells, str] | None) -> Frames:
    """One frame a line, its cells by name or, where `named` is None, row by row in the order of the fields."""
    names = table.names or ("",) * table.width
    roles = [role_of(name) for name in names]
    times = [field for field, role in enumerate(roles) if role in ("date", "time")]
    cells_of, sentence = named or _by_position(table, [role in ("date", "time", "frame") for role in roles], shape)
    before = min(cells_of) - 1
    if named is None and not times and before == 0 and roles[0] != "frame" and (names[0] or table.names is None):
        times = [0]  # one field more than cells; where a header leaves it without a name it is a counter
    fields = {cell: field for field, cell in cells_of.items()}
    table.checked(sorted(cells_of))
    values = np.full((len(table.numbers), *shape), np.nan)
    for field, (row, column) in cells_of.items():
        values[:, row, column] = table.numbers[:, field]
    unused = [names[field] for field in range(table.width) if field not in cells_of and field not in times]
    left = f"; left out: {', '.join(name or 'a column without a name' for name in unused[:5])}" if unused else ""

    def place_of(frame: int, row: int, column: int) -> str:
        return table.place(frame, fields.get((row, column), min(cells_of)))

    timing = timing_of(table, times, range(len(values)))
    notes = (*table.notes, f"one frame a line, {sentence}{left}")
    words = tuple(names[field] for field in sorted(cells_of))
    return Frames(values, timing, notes, place_of, words if table.names else ())


def _by_position(table: ForeignTable, others: Sequence[bool], shape: tuple[int, int]) -> tuple[Cells, str]:
    """The last fields that are none of the others as cells, row by row."""
    cells = shape[0] * shape[1]
    rest = [field for field in range(table.width) if not others[field]]
    rest = rest if len(rest) >= cells else list(range(table.width))
    return {field: divmod(number, shape[1]) for number, field in enumerate(rest[-cells:])}, "cells row by row"


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
    """Each line's frame from 0, and how frames are distinguished; nothing where all lines are one frame."""
    if "frame" in order:
        return np.unique(_indices(table, order["frame"]), return_inverse=True)[1], ""
    if "time" not in order:
        return np.zeros(len(cells), dtype=np.intp), ""
    texts = table.fields[:, [order[role] for role in ("date", "time") if role in order]]
    stamps = np.array([" ".join(line) for line in texts])
    _, begins, frames = np.unique(stamps, return_index=True, return_inverse=True)
    if len(begins) < len(cells) or len(cells) == 1:
        by_line = np.argsort(np.argsort(begins))  # in the order in which they come
        return by_line[frames], "; frames by their time"
    return _scans(cells), "; every line has a time of its own, a new frame begins where a cell comes again"


def _scans(cells: NDArray[np.int64]) -> NDArray[np.intp]:
    frame, seen = 0, set[int]()
    frames = np.zeros(len(cells), dtype=np.intp)
    for line, cell in enumerate(cells.tolist()):
        if cell in seen:
            frame, seen = frame + 1, set()
        seen.add(cell)
        frames[line] = frame
    return frames


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
