"""A line for each row of the panel: blocks of lines, apart by blank lines, titles, labels, or by their number alone."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.recording.foreign.clock import clock_of
from lampest.recording.foreign.frames import Clock, Frames
from lampest.recording.foreign.table import ForeignTable, timing_of
from lampest.recording.foreign.words import line_of, role_of, side_of

# 'Frame 3, t = 1250 ms', 'time: 2025-01-31 12:00:01', 'millis=123'
TITLE_TIME = re.compile(
    r"(?:\b(?P<word>t|time|timestamp|millis|ms|zeit)\s*[:=]\s*)(?P<value>\d[\d.,]*)\s*(?P<unit>ms|us|s)?(?![\d:/-])"
    r"|(?P<stamp>\d{4}-\d{2}-\d{2}[T ]\d{1,2}:\d{2}(?::\d{2}(?:\.\d+)?)?(?:Z|[+-]\d{2}:?\d{2})?)",
    re.IGNORECASE,
)


def frames_in_blocks(table: ForeignTable, shape: tuple[int, int]) -> Frames:
    """Frames from lines that hold a row each, with the row's name or the time before it where there is one field more.

    Raises InputError where a block has more lines than the panel has rows.
    """
    titles = ""
    if table.width > 2 and np.any(table.counts == 1) and np.any(table.counts > 1):
        table, titles = table.only(table.counts > 1), "; a number alone in a line is taken as a title"
    extra = table.width - shape[1]
    labels, times = _before_the_row(table, extra, shape[0])
    columns, order = _column_order(table, extra, shape[1])
    table.checked(list(range(extra, table.width)))
    blocks, left_out = _blocks(table, labels, shape[0])
    where = np.full((len(blocks), shape[0]), -1)
    for number, lines in enumerate(blocks):
        rows = range(shape[0]) if labels is None else [int(labels[line]) for line in lines]
        for row, line in zip(rows, lines, strict=False):
            where[number, row] = line
    values = table.numbers[:, extra:][np.maximum(where, 0)][:, :, columns]
    values[where < 0] = np.nan
    begins = [min(lines) for lines in blocks if lines]
    timing = None
    if len(begins) == len(blocks):
        timing = timing_of(table, times, begins) or _title_timing(table, begins)
    named = "rows from top to bottom" if labels is None else "rows by their names"
    notes = (*table.notes, f"one row a line, {shape[0]} lines a frame; {named}, {order}{left_out}{titles}")

    def place(frame: int, row: int, column: int) -> str:
        line = int(where[frame, row])
        return f"{table.source}: row {row} of frame {frame}" if line < 0 else table.place(line, extra + columns[column])

    return Frames(values, timing, notes, place, (table.names or ("",))[:1] if extra else ())


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
    if numbers.min() < 0 or numbers.max() - first >= rows:
        bad = int(np.argmax((numbers < 0) | (numbers - first >= rows)))
        raise InputError(f"{table.place(bad, labelled[-1])}: {texts[bad][:40]!r} is none of the panel's {rows} rows")
    if any(line is not None and side_of(line[0]) == "column" for line in lines):
        raise InputError(f"{table.place(0, labelled[-1])}: {texts[0]!r} names a column; --transpose swaps the two")
    return numbers - first, times


def _column_order(table: ForeignTable, extra: int, columns: int) -> tuple[list[int], str]:
    """Which field of a line is which column of the panel, by names that number them, else in order."""
    plain = list(range(columns)), "columns from left to right"
    lines = [line_of(name) for name in (table.names or ())[extra:]]
    if len(lines) != columns or not all(lines):
        return plain
    numbers = [line[1] for line in lines if line is not None]
    if sorted(numbers) not in (list(range(columns)), list(range(1, columns + 1))):
        return plain
    if any(line is not None and side_of(line[0]) == "row" for line in lines):
        raise InputError(f"{table.source}: the header's {(table.names or ())[extra]!r} names a row; --transpose swaps")
    first = min(numbers)
    return [numbers.index(number + first) for number in range(columns)], f"columns by their names from {first}"


def _blocks(table: ForeignTable, labels: NDArray[np.int64] | None, rows: int) -> tuple[list[list[int]], str]:
    """The lines of each frame, and a sentence on blocks that are not whole."""
    groups: list[list[int]] = []
    seen: set[int] = set()
    for line in range(len(table.numbers)):
        again = labels is not None and int(labels[line]) in seen
        if not groups or table.apart[line] or again:
            groups.append([])
            seen = set()
        groups[-1].append(line)
        if labels is not None:
            seen.add(int(labels[line]))
    if labels is not None:
        if max(map(len, groups)) == 1 and rows > 1 and table.apart.any():  # every line stands apart
            return _blocks(replace(table, apart=np.zeros_like(table.apart)), labels, rows)
        return groups, ""
    if len(groups) > 1 and max(map(len, groups)) == 1 and rows > 1:
        groups = [list(range(len(table.numbers)))]  # every line stands apart: their number alone tells
    blocks: list[list[int]] = []
    cut = ""
    for number, lines in enumerate(groups):
        whole, rest = divmod(len(lines), rows)
        last = number == len(groups) - 1
        if rest and whole and not last and len(groups) > 1:
            raise InputError(
                f"{table.place(lines[0], None)}: a block of {len(lines)} lines, where the panel has {rows} rows"
            )
        if rest and not whole and number == 0 and not last:
            cut = f"; the first block ({table.called(lines[0])}) is cut and left out"
            continue
        blocks += [lines[start : start + rows] for start in range(0, whole * rows, rows)]
        if rest and last:
            blocks.append(lines[whole * rows :])
        elif rest:
            blocks.append([])
            cut += f"; the block at {table.called(lines[0])} has {rest} of {rows} lines and is missing"
    return blocks, cut


def _title_timing(table: ForeignTable, begins: Sequence[int]) -> Callable[[], Clock] | None:
    """Times that stand in the lines before the blocks, where they stand before each of them."""
    searches = [TITLE_TIME.search(table.titles[line]) for line in begins]
    matches = [match for match in searches if match is not None]
    if len(matches) != len(begins):
        return None
    texts = [match["stamp"] or match["value"].rstrip(".,") for match in matches]
    name = f"{matches[0]['word'] or ''} [{matches[0]['unit']}]" if matches[0]["unit"] else (matches[0]["word"] or "")

    def clock() -> Clock:
        read = clock_of(texts, name, lambda number: table.place(begins[number], None), table.numerals)
        return Clock(read.seconds, read.start, f"time: before each block in {read.sentence}")

    return clock
