"""The ways in which a table holds a panel: a frame a line, a value a line, or blocks of rows."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.foreign.frames import Frames, check_count
from lampest.recording.foreign.table import ForeignTable, kind_of
from lampest.recording.foreign.words import cell_of, line_of, role_of, side_of

Cells = dict[int, tuple[int, int]]
Shape = tuple[int, int]


def frames_of(table: ForeignTable, shape: Shape) -> Frames:
    """The frames (frames, rows, columns) of a table by its header, and by how many fields its lines have.

    Raises InputError where neither determines it, or something does not fit.
    """
    cells, names = shape[0] * shape[1], table.names
    order = _single_values(table, shape)
    if order is not None:
        return _frames_of_single_values(table, shape, order)
    named = None if names is None else _cells_by_name(table.rows.source, names, shape)
    others = sum(role_of(name) in ("time", "date", "frame", "row") for name in names or ())
    if named is not None or table.width in (cells, cells + 1, cells + others):
        return _frames_in_lines(table, shape, named)
    if table.width in (shape[1], shape[1] + 1, shape[1] + others):
        return _frames_in_blocks(table, shape)
    shorter = table.without_empty()
    if shorter.width < table.width:
        return frames_of(shorter, shape)
    turned = table.width in (shape[0], shape[0] + 1)
    raise InputError(
        f"{table.place(0, None)}: {table.width} fields; {shape[0]} × {shape[1]} cells need {cells}, {cells + 1} with "
        f"the time, or 3 or 4 for row, column, value and frame, or {shape[1]} in a line for each row"
        + ("; with --transpose it would fit" if turned else "")
    )


# A frame a line.


def _cells_by_name(source: str, names: Sequence[str], shape: Shape) -> tuple[Cells, str] | None:
    """Column → (row, column) of the cell that its name holds, and a sentence; None where names hold no cells."""
    named = {field: cell for field, name in enumerate(names) if (cell := cell_of(name)) and not role_of(name)}
    if not named:
        return _cells_by_number(names, shape)
    first = 0 if min(map(min, named.values())) == 0 else 1
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


def _cells_by_number(names: Sequence[str], shape: Shape) -> tuple[Cells, str] | None:
    """Columns that are called by one word and all numbers of the panel's cells."""
    lines = {field: line for field, name in enumerate(names) if (line := line_of(name)) and not role_of(name)}
    numbers = sorted(number for _, number in lines.values())
    first = numbers[0] if numbers else 0
    one_word = len({word for word, _ in lines.values()}) == 1
    if not one_word or first > 1 or numbers != list(range(first, first + shape[0] * shape[1])):
        return None
    cells = {field: divmod(number - first, shape[1]) for field, (_, number) in lines.items()}
    return cells, f"cells by their numbers from {first}, row by row"


def _frames_in_lines(table: ForeignTable, shape: Shape, named: tuple[Cells, str] | None) -> Frames:
    """One frame a line, its cells by name or, where `named` is None, row by row in the order of the fields."""
    names = table.names or ("",) * table.width
    roles = [role_of(name) for name in names]
    times = [field for field, role in enumerate(roles) if role in ("date", "time")]
    if named is None:
        cells = shape[0] * shape[1]
        rest = [field for field, role in enumerate(roles) if role not in ("date", "time", "frame")]
        rest = (rest if len(rest) >= cells else list(range(table.width)))[-cells:]
        if not times and rest[0] == 1 and roles[0] != "frame" and (names[0] or table.names is None):
            times = [0]  # one field more than cells; where a header leaves it without a name it is a counter
        named = {field: divmod(number, shape[1]) for number, field in enumerate(rest)}, "cells row by row"
    cells_of, sentence = named
    table.checked(sorted(cells_of))
    number = np.full((len(table.lines), *shape), -1)
    for field, cell in cells_of.items():
        number[:, *cell] = np.arange(len(number)) * table.width + field
    unused = [names[field] for field in range(table.width) if field not in cells_of and field not in times]
    left = f"; left out: {', '.join(name or 'a column without a name' for name in unused[:5])}" if unused else ""
    note = f"one frame a line, {sentence}{left}"
    return table.frames(number, table.timing(times, range(len(number))), note, sorted(cells_of))


# A value a line.


def _single_values(table: ForeignTable, shape: Shape) -> dict[str, int] | None:
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
    if table.width in (shape[1], shape[1] + 1):
        numbers = np.stack([_line_numbers(table, field) for field in (0, 1)], axis=1)
        indices = np.all((numbers == np.round(numbers)) & (numbers >= 0) & (numbers <= shape))
        if not indices or (len(numbers) > 1 and not np.any(np.ptp(numbers, axis=0) > 0)):
            return None
    return dict(zip(("row", "column", "value", "frame"), range(table.width), strict=False))


def _line_numbers(table: ForeignTable, field: int) -> Array:
    """Row or column numbers of all lines: 3, R3 or 'row 3'; NaN for any other text."""
    values, unread = table.numbers[:, field].copy(), table.words[:, field]
    texts = table.fields[unread, field]
    lines = {text: line_of(text) for text in set(texts)}
    values[unread] = [np.nan if (line := lines[text]) is None else line[1] for text in texts]
    return values


def _indices(table: ForeignTable, field: int) -> NDArray[np.int64]:
    """The same as whole numbers. Raises InputError where one is none."""
    values = _line_numbers(table, field)
    bad = ~np.isfinite(values) | (values != np.round(values)) | (np.abs(values) > np.iinfo(np.int32).max)
    if np.any(bad):
        at = int(np.argmax(bad))
        raise InputError(f"{table.place(at, field)}: {table.fields[at, field][:40] or 'nothing'} is no index")
    return values.astype(np.int64)


def _frames_of_single_values(table: ForeignTable, shape: Shape, order: dict[str, int]) -> Frames:
    """Frames from lines that hold row, column and value, and the frame's number or time; others are missing."""
    table.checked([order["value"]])
    rows, columns, first = _cells_of_lines(table, order, shape)
    frames, how = _frame_numbers(table, rows * shape[1] + columns, order)
    count = int(frames.max()) + 1
    check_count(table.rows.source, count * shape[0] * shape[1])
    where = np.full((count, *shape), -1)
    for line, cell in enumerate(zip(frames.tolist(), rows.tolist(), columns.tolist(), strict=True)):
        if where[cell] >= 0:
            hint = "" if how else "; several frames need a field with the frame's number"
            earlier = table.called(int(where[cell]))
            raise InputError(f"{table.place(line, None)}: the same cell as in {earlier}{hint}")
        where[cell] = line
    begins = np.unique(frames, return_index=True)[1].tolist()
    times = [order[role] for role in ("date", "time") if role in order]
    said = ", ".join(sorted(order, key=order.__getitem__))
    number = np.where(where >= 0, where * table.width + order["value"], -1)
    note = f"one value a line as {said}; indices count from {first}{how}"
    return table.frames(number, table.timing(times, begins), note, [order["value"]])


def _cells_of_lines(
    table: ForeignTable, order: dict[str, int], shape: Shape
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Row and column of all lines from 0, and where the file counts from; one field may name or number the cell."""
    shift = 0
    if {"row", "column"} <= set(order):
        rows, columns = _indices(table, order["row"]), _indices(table, order["column"])
        first = shift = 0 if min(rows.min(), columns.min()) <= 0 else 1
    else:
        texts = table.fields[:, order["cell"]]
        cells = {text: cell_of(text) for text in set(texts)}
        if all(cells.values()):
            rows, columns = np.array([cells[text] or (0, 0) for text in texts], dtype=np.int64).T
            first = shift = 0 if min(rows.min(), columns.min()) <= 0 else 1
        else:
            numbers = _indices(table, order["cell"])
            first = 0 if numbers.min() <= 0 else 1
            rows, columns = np.divmod(numbers - first, shape[1])
    for name, values, size in (("row", rows, shape[0]), ("column", columns, shape[1])):
        bad = (values < shift) | (values >= shift + size)
        if np.any(bad):
            at = int(np.argmax(bad))
            place = table.place(at, order.get(name, order.get("cell")))
            raise InputError(f"{place}: {name} {values[at]} is beyond the panel's {shift} to {shift + size - 1}")
    return rows - shift, columns - shift, first


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
    frame, seen = 0, set[int]()
    scans = np.zeros(len(cells), dtype=np.intp)
    for line, cell in enumerate(cells.tolist()):
        if cell in seen:
            frame, seen = frame + 1, set()
        seen.add(cell)
        scans[line] = frame
    return scans, "; every line has a time of its own, a new frame begins where a cell comes again"


# A line for each row: blocks of lines, apart by blank lines, titles, labels, or by their number alone. A block is the
# line at which it begins, and its lines; it has none where nobody knows which row was lost.

Block = tuple[int, list[int]]


def _frames_in_blocks(table: ForeignTable, shape: Shape) -> Frames:
    """Frames from lines that hold a row each; one field more is the row's name or the time."""
    titles = ""
    if table.width > 2 and np.any(table.counts == 1) and np.any(table.counts > 1):
        table, titles = table.only(table.counts > 1), "; a number alone in a line is taken as a title"
    cut = (table.counts != table.width) & np.any(table.words[:, -shape[1] :], axis=1)
    table = table.only(~cut) if not np.all(cut) else table
    extra = table.width - shape[1]
    labels, times = _before_the_row(table, extra, shape[0])
    columns, order = _column_order(table, extra, shape[1])
    table.checked(list(range(extra, table.width)))
    blocks, left_out, title = _blocks(table, shape[0]) if labels is None else _labelled_blocks(table, labels)
    where = np.full((len(blocks), shape[0]), -1)
    for frame, (_, lines) in enumerate(blocks):
        where[frame, np.arange(len(lines)) if labels is None else labels[lines]] = lines
    number = np.where(where[..., None] >= 0, where[..., None] * table.width + extra + np.array(columns), -1)
    begins = [begin for begin, _ in blocks]
    timing = table.timing(times, begins) or table.title_timing(begins, title)
    named = "rows from top to bottom" if labels is None else "rows by their names"
    note = f"one row a line, {shape[0]} lines a frame; {named}, {order}{left_out}{titles}"
    return table.frames(number, timing, note, range(min(extra, 1)))


def _before_the_row(table: ForeignTable, extra: int, rows: int) -> tuple[NDArray[np.int64] | None, list[int]]:
    """(lines) row numbers from 0 by the lines' names, or None; and the columns that hold times."""
    names = table.names or ("",) * table.width
    times = [field for field in range(extra) if role_of(names[field]) in ("time", "date")]
    labelled = [field for field in range(extra) if field not in times and role_of(names[field]) != "frame"]
    if not labelled:
        return None, times
    texts = table.fields[:, labelled[-1]]
    lines = [line_of(text) for text in texts]
    numbers = np.array([-1 if line is None else line[1] for line in lines])
    if table.names is None and numbers.max(initial=0) > rows:
        return None, [labelled[-1]]
    first = 0 if numbers.min() == 0 else 1
    if np.any(bad := (numbers < 0) | (numbers - first >= rows)):
        at = int(np.argmax(bad))
        raise InputError(f"{table.place(at, labelled[-1])}: {texts[at][:40]!r} is none of the panel's {rows} rows")
    if any(line is not None and side_of(line[0]) == "column" for line in lines):
        raise InputError(f"{table.place(0, labelled[-1])}: {texts[0]!r} names a column; --transpose swaps the two")
    return numbers - first, times


def _column_order(table: ForeignTable, extra: int, columns: int) -> tuple[list[int], str]:
    """Which field of a line is which column of the panel, by names that number them, else in order."""
    names = (table.names or ())[extra:]
    lines = [line for name in names if (line := line_of(name))]
    numbers = [number for _, number in lines]
    if len(names) != columns or sorted(numbers) not in (list(range(columns)), list(range(1, columns + 1))):
        return list(range(columns)), "columns from left to right"
    if any(side_of(word) == "row" for word, _ in lines):
        raise InputError(f"{table.rows.source}: the header's {names[0]!r} names a row; --transpose swaps")
    first = min(numbers)
    return [numbers.index(number + first) for number in range(columns)], f"columns by their names from {first}"


def _labelled_blocks(table: ForeignTable, labels: NDArray[np.int64]) -> tuple[list[Block], str, None]:
    """A frame begins where a row comes again, and after lines of a kind that comes about once a frame."""
    frames = int(np.bincount(labels).max())
    kinds = table.kinds_before
    often = Counter(kind for before in kinds for kind in before)
    titles = {kind for kind, times in often.items() if frames / 2 <= times <= 1.5 * frames}
    groups: list[list[int]] = []
    for line, before in enumerate(kinds):
        if not groups or labels[line] in labels[groups[-1]] or before & titles:
            groups.append([])
        groups[-1].append(line)
    return [(lines[0], lines) for lines in groups], "", None


def _blocks(table: ForeignTable, rows: int) -> tuple[list[Block], str, str | None]:
    """The frames, a sentence on those that are cut and on lines that were skipped, and the kind of their titles."""
    groups, title = _grouped(table, rows)
    blocks: list[Block] = []
    said: list[str] = []
    for number, lines in enumerate(groups):
        whole, rest = divmod(len(lines), rows)
        first, last = number == 0 and len(groups) > 1, number == len(groups) - 1
        if first and rest and not whole:
            said.append(f"the first block ({table.called(lines[0])}) is cut and left out")
        elif rest and not last:
            said.append(f"the block at {table.called(lines[0])} has {len(lines)} of {rows} lines and is missing")
            blocks.append((lines[0], []))
        else:
            blocks += [(lines[at], lines[at : at + rows]) for at in range(0, len(lines), rows)]
    between = [passed for before in table.before[1:] for passed in before if title is not None and passed.text]
    skipped = [passed.called for passed in between if kind_of(passed.text) != title]
    said += [f"skipped between rows: {', '.join(skipped)}"] if skipped else []
    return blocks, "".join(f"; {sentence}" for sentence in said), title


def _grouped(table: ForeignTable, rows: int) -> tuple[list[list[int]], str | None]:
    """Lines frame by frame, and the kind of what stands between frames; None: anything, or nothing."""
    kinds = table.kinds_before
    apart = [line for line in range(1, len(kinds)) if kinds[line]]
    often = Counter(kind for line in apart for kind in kinds[line])

    def split(begins: Sequence[int]) -> list[list[int]]:
        return [list(range(first, end)) for first, end in pairwise([0, *begins, len(kinds)])]

    def whole(groups: Sequence[Sequence[int]]) -> int:
        """How many frames are whole; lines of one group may be cut at their end."""
        return sum(len(group) // rows for group in groups if len(group) % rows == 0 or len(groups) == 1)

    options: list[tuple[list[list[int]], str | None]] = [(split(apart), None)]
    for kind, _ in often.most_common(8):  # titles are among the most frequent
        options.append((split([line for line in apart if kind in kinds[line]]), kind))
    best, alone = max(options, key=lambda option: whole(option[0])), split([])
    if rows > 1 and (len(best[0]) == len(kinds) or 2 * len(best[0]) < whole(alone)):
        return alone, None
    long = next((group for group in best[0] if len(group) > rows), None)
    if long and not whole(best[0]):
        raise InputError(f"{table.place(long[0], None)}: a block of {len(long)} lines, where the panel has {rows} rows")
    return best
