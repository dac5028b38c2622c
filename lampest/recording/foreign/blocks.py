"""A line for each row of the panel: blocks of lines, apart by blank lines, titles, labels, or by their number alone."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

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
NUMBER = re.compile(r"\d+(?:[.,:]\d+)*")
MOST_SEPARATORS = 8  # kinds of lines that are tried as titles; those between frames are the most frequent


class FrameLines(NamedTuple):
    """Lines of one frame, and the line at which it begins; no lines where nobody knows which row was lost."""

    begin: int
    lines: tuple[int, ...]


def frames_in_blocks(table: ForeignTable, shape: tuple[int, int]) -> Frames:
    """Frames from lines that hold a row each, with the row's name or the time before it where there is one field more.

    Raises InputError where a block has more lines than the panel has rows.
    """
    titles = ""
    if table.width > 2 and np.any(table.counts == 1) and np.any(table.counts > 1):
        table, titles = table.only(table.counts > 1), "; a number alone in a line is taken as a title"
    cut = (table.counts != table.width) & np.any(table.words[:, -shape[1] :], axis=1)
    table = table.only(~cut) if np.any(cut) and not np.all(cut) else table
    extra = table.width - shape[1]
    labels, times = _before_the_row(table, extra, shape[0])
    columns, order = _column_order(table, extra, shape[1])
    table.checked(list(range(extra, table.width)))
    if labels is None:
        blocks, left_out, title = _blocks(table, shape[0])
    else:
        blocks, left_out, title = _labelled_blocks(table, labels), "", None
    where = np.full((len(blocks), shape[0]), -1)
    for number, block in enumerate(blocks):
        rows = range(shape[0]) if labels is None else [int(labels[line]) for line in block.lines]
        for row, line in zip(rows, block.lines, strict=False):
            where[number, row] = line
    values = table.numbers[:, extra:][np.maximum(where, 0)][:, :, columns]
    values[where < 0] = np.nan
    begins = [block.begin for block in blocks]
    timing = timing_of(table, times, begins) or _title_timing(table, begins, title)
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


def _labelled_blocks(table: ForeignTable, labels: NDArray[np.int64]) -> list[FrameLines]:
    """A frame begins where a row comes again, and after lines of a kind that comes about once a frame."""
    frames = int(np.bincount(labels).max())
    often = Counter(kind for before in table.before for kind in {_kind(passed.text) for passed in before})
    titles = {kind for kind, times in often.items() if frames / 2 <= times <= 1.5 * frames}
    groups: list[list[int]] = []
    for line, before in enumerate(table.before):
        again = bool(groups) and labels[line] in labels[groups[-1]]
        if not groups or again or any(_kind(passed.text) in titles for passed in before):
            groups.append([])
        groups[-1].append(line)
    return [FrameLines(lines[0], tuple(lines)) for lines in groups]


def _blocks(table: ForeignTable, rows: int) -> tuple[list[FrameLines], str, str | None]:
    """The frames, a sentence on those that are not whole and on lines that were skipped, and the kind of their titles.

    Lines between frames are of the kind that leaves most frames whole; what else stands between rows is skipped.
    """
    groups, title = _grouped(table, rows)
    blocks: list[FrameLines] = []
    said: list[str] = []
    for number, lines in enumerate(groups):
        whole, rest = divmod(len(lines), rows)
        first, last = number == 0 and len(groups) > 1, number == len(groups) - 1
        if first and rest and not whole:
            said.append(f"the first block ({table.called(lines[0])}) is cut and left out")
        elif rest and not last:
            said.append(f"the block at {table.called(lines[0])} has {len(lines)} of {rows} lines and is missing")
            blocks.append(FrameLines(lines[0], ()))
        else:
            blocks += [FrameLines(lines[at], tuple(lines[at : at + rows])) for at in range(0, len(lines), rows)]
    skipped = [
        passed.called
        for before in table.before[1:]
        for passed in before
        if passed.text and title is not None and _kind(passed.text) != title
    ]
    said += [f"skipped between rows: {', '.join(skipped)}"] if skipped else []
    return blocks, "".join(f"; {sentence}" for sentence in said), title


def _grouped(table: ForeignTable, rows: int) -> tuple[list[list[int]], str | None]:
    """Lines frame by frame, and the kind of what stands between frames; None: anything, or nothing.

    Raises InputError where all blocks have as many lines as another panel has rows.
    """
    count = len(table.before)
    apart = [line for line in range(1, count) if table.before[line]]
    often = Counter(kind for line in apart for kind in {_kind(passed.text) for passed in table.before[line]})
    options: list[tuple[list[list[int]], str | None]] = [(_split(count, apart), None)]
    for kind, _ in often.most_common(MOST_SEPARATORS):
        having = [line for line in apart if any(_kind(passed.text) == kind for passed in table.before[line])]
        options.append((_split(count, having), kind))
    best, alone = max(options, key=lambda option: _whole(option[0], rows)), _split(count, [])
    if rows > 1 and (len(best[0]) == count or 2 * len(best[0]) < _whole(alone, rows)):
        return alone, None
    long = next((group for group in best[0] if len(group) > rows), None)
    if long and not _whole(best[0], rows):
        raise InputError(f"{table.place(long[0], None)}: a block of {len(long)} lines, where the panel has {rows} rows")
    return best


def _kind(text: str) -> str:
    """A line without its numbers: titles of all frames are alike."""
    return NUMBER.sub("#", text)


def _split(count: int, begins: Sequence[int]) -> list[list[int]]:
    return [list(range(first, end)) for first, end in pairwise([0, *begins, count])]


def _whole(groups: Sequence[Sequence[int]], rows: int) -> int:
    """How many frames are whole; lines of one group may be cut at their end."""
    return sum(len(group) // rows for group in groups if len(group) % rows == 0 or len(groups) == 1)


def _title_timing(table: ForeignTable, begins: Sequence[int], title: str | None) -> Callable[[], Clock] | None:
    """Times that stand in the lines before the blocks, where they stand before each of them; title : their kind."""
    before = [[passed.text for passed in table.before[line]] for line in begins]
    own = [" ".join(text for text in texts if title in (None, _kind(text))) for texts in before]
    searches = [TITLE_TIME.search(text or " ".join(texts)) for text, texts in zip(own, before, strict=True)]
    matches = [match for match in searches if match is not None]
    if len(matches) != len(begins):
        return None
    texts = [match["stamp"] or match["value"].rstrip(".,") for match in matches]
    name = f"{matches[0]['word'] or ''} [{matches[0]['unit']}]" if matches[0]["unit"] else (matches[0]["word"] or "")

    def clock() -> Clock:
        read = clock_of(texts, name, lambda number: table.place(begins[number], None), table.numerals)
        return Clock(read.seconds, read.start, f"time: before each block in {read.sentence}")

    return clock
