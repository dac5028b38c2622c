"""One frame a line: which column is which cell, by its name or by its field."""

from collections.abc import Callable, Sequence

import numpy as np

from lampest.files.errors import InputError
from lampest.recording.foreign.clock import clock_of
from lampest.recording.foreign.frames import Clock, Frames
from lampest.recording.foreign.headers import cell_of, line_of, role_of
from lampest.recording.foreign.table import ForeignTable

Cells = dict[int, tuple[int, int]]


def cell_columns(source: str, names: Sequence[str], shape: tuple[int, int]) -> tuple[Cells, str] | None:
    """Column → (row, column) of the cell that its name holds, and a sentence; None where names hold no cells.

    Raises InputError where a name is beyond the panel, or two are the same cell.
    """
    named = {field: cell for field, name in enumerate(names) if (cell := cell_of(name)) and not role_of(name)}
    if named:
        first = 0 if min(min(cell) for cell in named.values()) == 0 else 1
        cells = {field: (cell.row - first, cell.column - first) for field, cell in named.items()}
        for field, (row, column) in cells.items():
            if row >= shape[0] or column >= shape[1]:
                turned = "; with --transpose it would fit" if row < shape[1] and column < shape[0] else ""
                sizes = f"{shape[0]} × {shape[1]} cells, counted from {first}"
                raise InputError(f"{source}: the header's {names[field]!r} is beyond the panel of {sizes}{turned}")
        _refuse_twice(source, names, cells)
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
    if (
        len(words) != 1
        or len(numbers) != count
        or numbers[0] > 1
        or numbers != list(range(numbers[0], numbers[0] + count))
    ):
        return None
    first = numbers[0]
    cells = {field: divmod(number - first, shape[1]) for field, (_, number) in lines.items()}
    return cells, f"cells by their numbers from {first}, row by row"


def _refuse_twice(source: str, names: Sequence[str], cells: Cells) -> None:
    seen: dict[tuple[int, int], int] = {}
    for field, cell in cells.items():
        if cell in seen:
            raise InputError(f"{source}: the header's {names[seen[cell]]!r} and {names[field]!r} are the same cell")
        seen[cell] = field


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


def timing_of(table: ForeignTable, columns: Sequence[int], lines: Sequence[int]) -> Callable[[], Clock] | None:
    """Times of frames from columns (a date and a time of day may be two), taken in these lines, else from stamps."""
    if columns:
        return lambda: _clock_of_columns(table, columns, lines)
    if all(table.stamps[line] for line in lines):
        return lambda: _clock_of_stamps(table, lines)
    return None


def _clock_of_columns(table: ForeignTable, columns: Sequence[int], lines: Sequence[int]) -> Clock:
    names = table.names or ("",) * table.width
    dates = [column for column in columns if role_of(names[column]) == "date"]
    clocks = [column for column in columns if column not in dates]
    chosen = [*dates[:1], *clocks[:1]]
    texts = [" ".join(table.fields[line, column] for column in chosen) for line in lines]
    name, at = names[chosen[-1]], chosen[-1]
    clock = clock_of(texts, name, lambda number: table.place(lines[number], at), table.numerals)
    return Clock(
        clock.seconds, clock.start, f"time: {f'column {name!r}' if name else 'first field'} in {clock.sentence}"
    )


def _clock_of_stamps(table: ForeignTable, lines: Sequence[int]) -> Clock:
    texts = [table.stamps[line] for line in lines]
    clock = clock_of(texts, "", lambda number: table.place(lines[number], None), table.numerals)
    return Clock(clock.seconds, clock.start, f"time: the terminal's, {clock.sentence}")
