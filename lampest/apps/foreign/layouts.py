"""Layouts of panels in tables: assignment of the numbers of a file to frames and cells."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lampest.apps.foreign.arrays import Frames, Index, Shape
from lampest.apps.foreign.beside import described, with_one_clock
from lampest.apps.foreign.breaks import WholeFrames, whole_parts
from lampest.apps.foreign.table import ReadingsTable, kind_of
from lampest.apps.foreign.words import COLUMN, ROW, cell_of, line_of, role_of
from lampest.files.errors import InputError, counted
from lampest.panel.panel import Array

Cells = dict[int, tuple[int, int]]


def frames_of(table: ReadingsTable, shape: Shape) -> Frames:
    """Return the frames of a table.

    The layout is found by its header and by the number of fields of its lines.

    Raises InputError if these do not determine the layout, or if the table does not fit the panel.
    """
    table = with_one_clock(table)
    if _begins_with_a_separator(table, shape):
        note = "a separator before the first value of every line"
        shorter = table.only(columns=list(range(1, table.width)))
        return frames_of(replace(shorter, notes=(*table.notes, note)), shape)
    # One value a line; else one frame a line; else one row a line; else again without empty
    # columns.
    order = _single_values(table, shape)
    if order is not None:
        return _frames_of_single_values(table, shape, order)
    table = described(table, shape)
    cells = shape[0] * shape[1]
    names = table.names
    if table.width == 1 and shape[1] > 1 and len(table.lines) >= cells:
        cells = shape[0] * shape[1]
        blocks = _blocks(table, cells, [0])
        row, column = np.divmod(blocks.row, shape[1])
        timing = table.timing([], blocks.begins) or table.title_timing(blocks.begins, blocks.title)
        note = f"one number a line, {cells} lines a frame; row by row{blocks.left_out}"
        at = (blocks.frame[:, None], row[:, None], column[:, None])
        return table.frames(at, [0], shape, timing, note)
    named = _cells_by_name(table.source.source, names, shape) or _cells_by_number(names, shape)
    extra = sum(role_of(name) in ("time", "date", "frame", "row") for name in names)
    if named is not None or table.width in (cells, cells + 1, cells + extra):
        return _frames_in_lines(table, shape, named)
    if table.width in (shape[1], shape[1] + 1, shape[1] + extra):
        return _frames_in_blocks(table, shape)
    filled = np.any(table.fields != "", axis=0)
    if not np.all(filled):
        empty = ", ".join(names[field] or f"field {field + 1}" for field in np.flatnonzero(~filled))
        shorter = table.only(columns=np.flatnonzero(filled))
        return frames_of(
            replace(shorter, notes=(*table.notes, f"empty columns left out: {empty}")), shape
        )
    raise InputError(
        f"{table.place(0, None)}: {counted(table.width, 'field')}; "
        f"{shape[0]} × {shape[1]} cells need {cells}, {cells + 1} with the time, "
        f"or 3 or 4 for row, column, value and frame, or {shape[1]} in a line for each row; "
        "`layout` says what each field is"
    )


def _begins_with_a_separator(table: ReadingsTable, shape: Shape) -> bool:
    """Return whether the first field of every line is empty and no reading of the panel.

    A program that prints a tab before each value leaves such a field.
    """
    if table.width in (1, shape[0] * shape[1], shape[1]) or table.names[0]:
        return False
    empty = np.all(table.fields[:, :2] == "", axis=0)
    return bool(empty[0] and not empty[1])


def _cells_by_name(source: str, names: Sequence[str], shape: Shape) -> tuple[Cells, str] | None:
    """Return (row, column) of the cells in the names of columns, by column, and a sentence.

    The result is None without such names.
    """
    named: dict[int, tuple[int, int]] = {}
    for field, name in enumerate(names):
        cell = cell_of(name)
        if cell is not None and not role_of(name):
            named[field] = cell
    if not named:
        return None
    first = min(1, *map(min, named.values()))
    cells = {field: (row - first, column - first) for field, (row, column) in named.items()}
    fields: dict[tuple[int, int], int] = {}
    for field, (row, column) in cells.items():
        if fields.setdefault((row, column), field) != field:
            headers = f"{names[fields[row, column]]!r} and {names[field]!r}"
            raise InputError(f"{source}: the header's {headers} are the same cell")
        if row >= shape[0] or column >= shape[1]:
            sizes = f"{shape[0]} × {shape[1]} cells, counted from {first}"
            raise InputError(
                f"{source}: the header's {names[field]!r} is beyond the panel of {sizes}"
            )
    example = f"{names[min(named)]!r} is row {cells[min(named)][0]}, column {cells[min(named)][1]}"
    unnamed = shape[0] * shape[1] - len(cells)
    gap = f"; {counted(unnamed, 'cell')} without a column, missing" if unnamed else ""
    order = ", row by row" if list(cells.values()) == sorted(cells.values()) else ""
    return cells, f"cells by their names{order}, which count from {first} ({example}){gap}"


def _cells_by_number(names: Sequence[str], shape: Shape) -> tuple[Cells, str] | None:
    """Return the cells of columns named by one word and the numbers of all cells, or None.

    A sentence is returned with the cells.
    """
    lines: dict[int, tuple[str, int]] = {}
    for field, name in enumerate(names):
        line = line_of(name)
        if line is not None and not role_of(name):
            lines[field] = line
    first = min((number for _, number in lines.values()), default=0)
    one_word = len({word for word, _ in lines.values()}) == 1
    ways = {
        "row by row": (shape[1], (0, 1)),
        "a digit for the row and one for the column": (10, (0, 11)),
    }
    for way, (base, firsts) in ways.items():
        cells = {field: divmod(number - first, base) for field, (_, number) in lines.items()}
        if one_word and first in firsts and sorted(cells.values()) == list(np.ndindex(shape)):
            return cells, f"cells by their numbers from {first}, {way}"
    return None


def _frames_in_lines(table: ReadingsTable, shape: Shape, named: tuple[Cells, str] | None) -> Frames:
    """Return the frames of a table with one frame a line.

    `named` contains the cells by column, and a sentence. None: cells row by row in the order of the
    fields.
    """
    names = table.names
    roles = [role_of(name) for name in names]
    times = [field for field, role in enumerate(roles) if role in ("date", "time")]
    if named is None:
        cells = shape[0] * shape[1]
        values = [
            field for field, role in enumerate(roles) if role not in ("date", "time", "frame")
        ]
        values = (values if len(values) >= cells else list(range(table.width)))[-cells:]
        if not times and values[0] == 1 and roles[0] != "frame" and (names[0] or not any(names)):
            # One field more than cells; where a header leaves it without a name it is a counter.
            times = [0]
        unknown = (
            f"; {names[values[0]]!r} and the other names tell no cells"
            if any(names[field] for field in values)
            else ""
        )
        named = dict(zip(values, np.ndindex(shape), strict=True)), f"cells row by row{unknown}"
    fields = sorted(named[0])
    rows, columns = np.transpose([named[0][field] for field in fields])
    unused = [
        names[field] for field in range(table.width) if field not in fields and field not in times
    ]
    omitted = (
        f"; left out: {', '.join(name or 'a column without a name' for name in unused[:5])}"
        if unused
        else ""
    )
    index = np.arange(len(table.lines))
    note = f"one frame a line, {named[1]}{omitted}"
    return table.frames(
        (index[:, None], rows, columns), fields, shape, table.timing(times, range(len(index))), note
    )


def _single_values(table: ReadingsTable, shape: Shape) -> dict[str, int] | None:
    """Return the fields of a table of single values by role, or None.

    The roles are row, column, cell, value, frame, time, date.
    """
    cells = shape[0] * shape[1]
    if any(table.names):
        roles = [role_of(name) for name in table.names]
        short = [name.strip().lower() for name in table.names]
        if {"r", "c"} <= set(short):  # beside a c, an r is no resistance
            roles[short.index("r")] = "row"
            roles[short.index("c")] = "column"
        order = {role: roles.index(role) for role in reversed(roles) if role is not None}
        has_place = {"row", "column"} <= set(order) or "cell" in order
        return order if "value" in order and has_place else None
    if table.width == 2 and shape[1] > 2 and _count_cells(table, cells):
        return {"cell": 0, "value": 1}
    counter = _counter_before_cells(table, shape)
    if counter:
        return {counter: 0, "row": 1, "column": 2, "value": 3}
    if table.width not in (3, 4) or table.width in (cells, cells + 1):
        return None
    if table.width in (shape[1], shape[1] + 1):
        numbers = np.stack([_line_numbers(table, field) for field in (0, 1)], axis=1)
        indices = np.all((numbers == np.round(numbers)) & (numbers >= 0) & (numbers <= shape))
        if not indices or (len(numbers) > 1 and not np.any(np.ptp(numbers, axis=0) > 0)):
            return None
    return dict(zip(("row", "column", "value", "frame"), range(table.width), strict=False))


def _counter_before_cells(table: ReadingsTable, shape: Shape) -> str | None:
    """Return whether the first of four fields is a 'frame' or a 'time'; None for neither.

    The other three fields are row, column and value. A counter's value precedes most cells of the
    panel, and none of them twice; readings do not repeat in this way.
    """
    counter, row, column = (
        (table.values[:, field] for field in range(3)) if table.width == 4 else (np.empty(0),) * 3
    )
    rows, columns = (np.unique(numbers).tolist() for numbers in (row, column))
    complete = [[*map(list, map(range, shape))], [list(range(1, size + 1)) for size in shape]]
    if [rows, columns] not in complete or not np.all(np.diff(counter) >= 0):
        return None
    frames = np.unique(counter)
    lines = len(np.unique(np.stack([counter, row, column]), axis=1).T)
    if lines < len(counter) or 2 * lines < len(frames) * shape[0] * shape[1] or min(shape) == 1:
        return None
    return "frame" if np.all(np.diff(frames) == 1) and float(frames[0]).is_integer() else "time"


def _count_cells(table: ReadingsTable, cells: int) -> bool:
    """Return whether the first field counts all cells of a frame."""
    numbers = table.values[:, 0]
    first = numbers[0]
    return bool(
        first in (0, 1)
        and numbers.max() - first == cells - 1
        and np.all(numbers == np.round(numbers))
    )


def _line_numbers(table: ReadingsTable, field: int) -> Array:
    """Return the row or column numbers in a field of all lines, from 3, R3 or 'row 3'.

    The result is NaN for any other text.
    """
    values = table.values[:, field].copy()
    unread = table.words[:, field]
    texts = table.fields[unread, field]
    lines = {text: line_of(text) or ("", np.nan) for text in set(texts)}
    values[unread] = [lines[text][1] for text in texts]
    return values


def _indices(table: ReadingsTable, field: int) -> Index:
    """Return the row or column numbers in a field as integers.

    Raises InputError for any other text.
    """
    values = _line_numbers(table, field)
    bad = (
        ~np.isfinite(values)
        | (values != np.round(values))
        | (np.abs(values) > np.iinfo(np.int32).max)
    )
    table.refuse(bad, field, "{0} is no index")
    return values.astype(np.intp)


def _frames_of_single_values(table: ReadingsTable, shape: Shape, order: dict[str, int]) -> Frames:
    """Return the frames of a table of single values, with the fields `order` by role.

    Other cells are missing.
    """
    rows, columns, first = _cells_of_lines(table, order, shape)
    cells = rows * shape[1] + columns
    frames, how = _frame_numbers(table, cells, order)
    _, begins, again = np.unique(
        np.stack([frames, cells]), axis=1, return_index=True, return_inverse=True
    )
    twice = np.flatnonzero(begins[again.ravel()] < np.arange(len(cells)))
    if len(twice):
        hint = (
            ""
            if how or "frame" in order
            else "; several frames need a field with the frame's number"
        )
        earlier = table.source.called(int(table.lines[begins[again.ravel()[twice[0]]]]))
        raise InputError(f"{table.place(int(twice[0]), None)}: the same cell as in {earlier}{hint}")
    times = [order[role] for role in ("date", "time") if role in order]
    timing = table.timing(times, np.unique(frames, return_index=True)[1].tolist())
    roles = ", ".join(sorted(order, key=order.__getitem__))
    note = f"one value a line as {roles}; indices count from {first}{how}"
    at = (frames[:, None], rows[:, None], columns[:, None])
    return table.frames(at, [order["value"]], shape, timing, note)


def _cells_of_lines(
    table: ReadingsTable, order: dict[str, int], shape: Shape
) -> tuple[Index, Index, int]:
    """Return row and column of all lines, counted from 0, and the file's first index (0 or 1).

    A single field may name or number the cell.
    """
    if "cell" in order and not {"row", "column"} <= set(order):
        texts = table.fields[:, order["cell"]]
        cells = {text: cell_of(text) for text in set(texts)}
        if all(cells.values()):
            rows, columns = np.array([cells[text] or (0, 0) for text in texts], dtype=np.intp).T
        else:
            numbers = _indices(table, order["cell"])
            first = int(numbers.min() > 0)
            rows, columns = (part + first for part in np.divmod(numbers - first, shape[1]))
    else:
        rows = _indices(table, order["row"])
        columns = _indices(table, order["column"])
    first = int(min(rows.min(), columns.min()) > 0)
    for name, values, size in (("row", rows, shape[0]), ("column", columns, shape[1])):
        name = name if name in order else "cell"
        bad = (values < first) | (values >= first + size)
        table.refuse(
            bad, order[name], f"{name} {{0}} is beyond the panel's {first} to {first + size - 1}"
        )
    return rows - first, columns - first, first


def _frame_numbers(table: ReadingsTable, cells: Index, order: dict[str, int]) -> tuple[Index, str]:
    """Return each line's frame, counted from 0, and a note on how frames are distinguished."""
    if "frame" in order:
        return np.unique(_indices(table, order["frame"]), return_inverse=True)[1], ""
    often = np.bincount(cells)
    repeated: Index = np.cumsum(_begins_again(cells, [False] * len(cells)), dtype=np.intp)
    if "time" not in order:
        if often.min() > 1 and repeated[-1] + 1 == often.max():
            return repeated, "; a new frame begins where a cell comes again"
        return 0 * cells, ""
    texts = table.fields[:, [order[role] for role in ("date", "time") if role in order]]
    stamps = [" ".join(line) for line in texts]
    # In the order in which they come.
    number = {stamp: at for at, stamp in enumerate(dict.fromkeys(stamps))}
    if len(number) < len(cells) or len(cells) == 1:
        return np.array(
            [number[stamp] for stamp in stamps], dtype=np.intp
        ), "; frames by their time"
    how = "; every line has a time of its own, a new frame begins where a cell comes again"
    return repeated, how


def _begins_again(numbers: Index, ended: Sequence[bool]) -> NDArray[np.bool_]:
    """Return whether a frame begins at a line, (lines,).

    A frame begins where a number of the current frame occurs again, and after a title.
    """
    numbers_of_frame = set[int]()
    begins = np.zeros(len(numbers), dtype=bool)
    for line, number in enumerate(numbers.tolist()):
        if number in numbers_of_frame or (ended[line] and line):
            begins[line] = True
            numbers_of_frame = set()
        numbers_of_frame.add(number)
    return begins


def _frames_in_blocks(table: ReadingsTable, shape: Shape) -> Frames:
    """Return the frames of a table with one row of the panel a line.

    Further fields are the row's name or the time.
    """
    extra = table.width - shape[1]
    labels, times = _before_the_row(table, extra, shape[0])
    columns, order = _column_order(table, extra, shape[1])
    fields = list(range(extra, table.width))
    if labels is None:
        blocks = _blocks(table, shape[0], fields)
    else:
        often = Counter(kind for kinds in table.kinds for kind in kinds)
        frames = int(np.bincount(labels).max())
        ends = {kind for kind, times in often.items() if frames / 2 <= times <= 1.5 * frames}
        numbered = [
            field for field, name in enumerate(table.names[:extra]) if role_of(name) == "frame"
        ]
        changes = np.zeros(len(labels), dtype=bool)
        for field in numbered:
            changes[1:] |= table.fields[1:, field] != table.fields[:-1, field]
        ended = [
            bool(kinds & ends) or bool(new) for kinds, new in zip(table.kinds, changes, strict=True)
        ]
        frame = np.cumsum(_begins_again(labels, ended), dtype=np.intp)
        begins = np.unique(frame, return_index=True)[1].tolist()
        blocks = _Blocks(frame, labels, begins, "", None)
    timing = table.timing(times, blocks.begins) or table.title_timing(blocks.begins, blocks.title)
    named = "rows from top to bottom" if labels is None else "rows by their names"
    note = f"one row a line, {shape[0]} lines a frame; {named}, {order}{blocks.left_out}"
    at = (blocks.frame[:, None], blocks.row[:, None], columns)
    return table.frames(at, fields, shape, timing, note)


def _before_the_row(table: ReadingsTable, extra: int, rows: int) -> tuple[Index | None, list[int]]:
    """Return the rows by the names of the lines, or None; and the columns with times.

    The rows are (lines,), counted from 0.
    """
    roles = [role_of(name) for name in table.names[:extra]]
    times = [field for field, role in enumerate(roles) if role in ("time", "date")]
    labelled = [field for field, role in enumerate(roles) if role not in ("time", "date", "frame")]
    if not labelled:
        return None, times
    texts = table.fields[:, labelled[-1]]
    lines = [line_of(text) or ("", -1) for text in texts]
    numbers = np.array([number for _, number in lines], dtype=np.intp)
    if not any(table.names) and numbers.max() > rows:
        return None, [labelled[-1]]
    first = 0 if numbers.min() == 0 else 1
    bad = (numbers < 0) | (numbers - first >= rows)
    table.refuse(bad, labelled[-1], f"{{0!r}} is none of the panel's {rows} rows")
    columns = np.array([re.fullmatch(COLUMN, word) is not None for word, _ in lines])
    table.refuse(columns, labelled[-1], "{0!r} names a column; `transpose` swaps the two")
    return numbers - first, times


def _column_order(table: ReadingsTable, extra: int, columns: int) -> tuple[list[int], str]:
    """Return the panel's column of each field, and a note.

    The columns are found by numbers in the names of the fields or in their order.
    """
    names = table.names[extra:]
    lines = list(filter(None, map(line_of, names)))
    numbers = [number for _, number in lines]
    from_zero = list(range(columns))
    from_one = list(range(1, columns + 1))
    if len(names) != columns or sorted(numbers) not in (from_zero, from_one):
        return list(range(columns)), "columns from left to right"
    if any(re.fullmatch(ROW, word) for word, _ in lines):
        raise InputError(
            f"{table.source.source}: the header's {names[0]!r} names a row; `transpose` swaps"
        )
    first = min(numbers)
    return [number - first for number in numbers], f"columns by their names from {first}"


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Assignment of lines without row names to frames and rows.

    Attributes
    ----------
    frame, row : array of int, shape (lines,)
        Frame, -1 for none, and row of every line.
    begins : list of int
        First line of every frame.
    left_out : str
        Note on skipped lines.
    title : str or None
        Kind of the titles between frames.
    """

    frame: Index
    row: Index
    begins: list[int]
    left_out: str
    title: str | None


def _blocks(table: ReadingsTable, rows: int, fields: Sequence[int]) -> _Blocks:
    """Return the assignment of lines without row names to frames and rows.

    `fields` are those with readings. Without marks between frames the readings show whether lines
    are lost or doubled; raises InputError if lines are, and the readings do not show which.
    """
    groups, title = _grouped(table, rows)
    parts = whole_parts(table.values[:, fields], rows) if len(groups) == 1 else ()
    if parts is None:
        raise InputError(
            f"{table.source.source}: {counted(len(table.lines), 'line')} "
            f"are no whole number of frames of {rows} lines, "
            "and the readings do not show which are lost, doubled or of a cut frame; "
            "leave the lines before the first whole frame and behind the last one out"
        )
    frame = np.full(len(table.lines), -1)
    row = np.zeros(len(table.lines), dtype=np.intp)
    begins: list[int] = []
    notes: list[str] = []

    def take(lines: range) -> None:
        frame[lines] = len(begins) + np.arange(len(lines)) // rows
        row[lines] = np.arange(len(lines)) % rows
        begins.extend(lines[::rows])

    for passed, part in pairwise([WholeFrames(0, 0), *parts]) if len(groups) == 1 else ():
        first, last = (table.source.called(int(table.lines[at])) for at in (passed.end, part.begin))
        if passed.end:
            notes.append(
                f"lines are lost or doubled between {first} and {last}: a frame is missing"
            )
            begins.append(passed.end)
        elif part.begin:
            notes.append(f"the lines before {last} are of a cut frame, and left out")
        take(range(part.begin, part.end))
    if len(groups) == 1 and (rest := (parts[-1].end - parts[-1].begin) % rows):
        notes.append(f"the last frame has {rest} of {rows} lines")
    for number, lines in enumerate(groups) if len(groups) > 1 else ():
        place = table.source.called(int(table.lines[lines[0]]))
        cut = len(lines) % rows
        if number == 0 and len(groups) > 1 and len(lines) < rows:
            notes.append(f"the first block ({place}) is cut and left out")
        elif cut and number < len(groups) - 1:  # the lost row is unknown
            notes.append(f"the block at {place} has {len(lines)} of {rows} lines and is missing")
            begins.append(lines[0])
        else:
            take(lines)
    skipped: list[str] = []
    if title is not None:
        for before in table.before[1:]:
            skipped += [place for text, place in before.items() if text and kind_of(text) != title]
    if skipped:
        notes.append(f"skipped between rows: {', '.join(skipped)}")
    return _Blocks(frame, row, begins, "".join(f"; {sentence}" for sentence in notes), title)


def _grouped(table: ReadingsTable, rows: int) -> tuple[list[range], str | None]:
    """Group the lines of a table into frames.

    Returns
    -------
    frames : list of range
        Lines of every frame.
    kind : str or None
        Kind of the titles between frames; None for titles of any kind, or none.
    """
    kinds = table.kinds
    separators = [line for line in range(1, len(kinds)) if kinds[line]]
    often = Counter(kind for line in separators for kind in kinds[line])

    def split(begins: Sequence[int]) -> list[range]:
        return [range(first, end) for first, end in pairwise([0, *begins, len(kinds)])]

    def whole(groups: Sequence[range]) -> int:
        """Return the number of complete frames; lines of a single group may be cut at the end."""
        return sum(
            len(group) // rows for group in groups if len(group) % rows == 0 or len(groups) == 1
        )

    options: list[tuple[list[range], str | None]] = [(split(separators), None)]
    for kind, _ in often.most_common(8):  # titles are among the most frequent
        options.append((split([line for line in separators if kind in kinds[line]]), kind))
    best = max(options, key=lambda option: whole(option[0]))
    ungrouped = split([])
    if rows > 1 and (len(best[0]) == len(kinds) or 2 * len(best[0]) < whole(ungrouped)):
        return ungrouped, None
    long = next((group for group in best[0] if len(group) > rows), None)
    if long and not whole(best[0]):
        raise InputError(
            f"{table.place(long[0], None)}: "
            f"a block of {len(long)} lines, where the panel has {rows} rows"
        )
    return best
