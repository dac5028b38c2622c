"""The lines of a file that hold readings, what their columns are called, what is left out and why."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.foreign.clock import UNIT_OF_WORD, clock_of, is_stamp
from lampest.recording.foreign.frames import Clock
from lampest.recording.foreign.words import UNITS_OF_WORD, Numerals, line_of, role_of

OF_FIELDS = ("fields", "numbers", "missing", "words")  # of a table, (lines, width)
MOST_SAMPLED = 20_000  # fields that decide how numbers are written: the first ones of any table tell


@dataclass(frozen=True, eq=False)
class Rows:
    """Lines of a file, cut into fields.

    fields : (lines, fields) texts, '' where a line ends earlier. counts : (lines) how many fields each has.
    comment : (lines) whether the line is marked as one. blank : (lines) whether an empty line stands before.
    stamps : (lines) when each came, as a terminal wrote it before the line, or ''.
    place : line, field or None → where in the file. called : line → 'line 3'.
    """

    source: str
    fields: NDArray[Any]
    counts: NDArray[np.intp]
    comment: NDArray[np.bool_]
    blank: NDArray[np.bool_]
    stamps: tuple[str, ...]
    place: Callable[[int, int | None], str]
    called: Callable[[int], str]
    notes: tuple[str, ...]


class Passed(NamedTuple):
    """A line that holds no readings: its text, and 'line 3'; both empty for a blank one."""

    text: str
    called: str


@dataclass(frozen=True, eq=False)
class ForeignTable:
    """The lines of a file that hold readings.

    fields, numbers, missing, words : (lines, width) texts, their numbers (NaN for none), whether a reading is said to
    be missing, and whether a text is none of both. counts : (lines) fields that each has. names : (width) of the
    columns, or None. before : (lines) what stands between the line and the one before. stamps, place, called, notes :
    see `Rows`.
    """

    source: str
    fields: NDArray[Any]
    numbers: Array
    missing: NDArray[np.bool_]
    words: NDArray[np.bool_]
    counts: NDArray[np.intp]
    names: tuple[str, ...] | None
    before: tuple[tuple[Passed, ...], ...]
    stamps: tuple[str, ...]
    numerals: Numerals
    place: Callable[[int, int | None], str]
    called: Callable[[int], str]
    notes: tuple[str, ...]

    @property
    def width(self) -> int:
        """How many fields a line has."""
        return int(self.fields.shape[1])

    def only(self, lines: NDArray[np.bool_], names: tuple[str, ...] | None = None) -> "ForeignTable":
        """The table with some of its lines; the others are what stands before the next one."""
        kept = [int(line) for line in np.flatnonzero(lines)]
        passed = []
        for last, line in zip([-1, *kept], kept, strict=False):
            others: list[Passed] = []
            for other in range(last + 1, line):
                others += [*self.before[other], Passed(" ".join(self.fields[other]).strip(), self.called(other))]
            passed.append((*others, *self.before[line]))
        return replace(
            self,
            **{name: getattr(self, name)[kept] for name in (*OF_FIELDS, "counts")},
            names=names or self.names,
            before=tuple(passed),
            stamps=tuple(self.stamps[line] for line in kept),
            place=lambda line, field: self.place(kept[line], field),
            called=lambda line: self.called(kept[line]),
        )

    def without_empty(self) -> "ForeignTable":
        """The table without columns that have a name and nothing in any line, such as LabVIEW's comments."""
        filled = np.any(self.fields != "", axis=0)
        kept = [int(field) for field in np.flatnonzero(filled)]
        if self.names is None or len(kept) == self.width:
            return self
        empty = ", ".join(self.names[field] or "a column without a name" for field in np.flatnonzero(~filled))
        return replace(
            self,
            **{name: getattr(self, name)[:, kept] for name in OF_FIELDS},
            counts=np.minimum(self.counts, len(kept)),
            names=tuple(self.names[field] for field in kept),
            place=lambda line, field: self.place(line, None if field is None else kept[field]),
            notes=(*self.notes, f"empty columns left out: {empty}"),
        )

    def checked(self, columns: Sequence[int]) -> None:
        """Raise InputError with its place where a field of these columns is neither a number nor a missing reading."""
        chosen = self.words[:, columns]
        if np.any(chosen):
            line, number = (int(part) for part in np.argwhere(chosen)[0])
            shown, field = self.fields[line, columns[number]][:40], columns[number]
            raise InputError(f"{self.place(line, field)}: {shown!r} is no number (field {field + 1} of the line)")


def table_of_rows(rows: Rows, layout: str | None = None) -> ForeignTable:
    """The lines with readings, the header before them, and sentences on what was left out.

    layout : the columns' names, apart by commas, in place of the file's own.

    Raises InputError where there are none, a line has more fields than the others, or the layout another number.
    """
    if rows.fields.size == 0 or np.all(rows.comment):
        raise InputError(f"{rows.source}: holds no values")
    numerals = Numerals.of([text for text in rows.fields[~rows.comment].ravel()[:MOST_SAMPLED] if text])
    numbers, missing, words = numerals.numbers(rows.fields)
    data = _data_lines(rows, missing, words)
    if not np.any(data):
        raise InputError(f"{rows.source}: holds a header but no values")
    usual = _usual(rows.counts[data])
    width = _width(rows, data, usual)
    header = _header_lines(rows, data, ~missing & ~words, width)
    if header:
        width = max(width, min(usual, 1 + int(np.flatnonzero(rows.fields[header[0]] != "")[-1])))
    else:
        data[: int(np.argmax(data & (rows.counts == usual)))] = False  # a terminal opened in the middle of a line
    for line in header:  # repeated where a board began anew
        data &= np.any(rows.fields != rows.fields[line], axis=1)
    _refuse_long(rows, data, width)
    names = _names(rows, header, width)
    notes = [*rows.notes, *(["decimal commas"] if numerals.comma else [])]
    notes = [", ".join(notes)] if notes else []
    if header:
        notes.append(f"{' and '.join(rows.called(line) for line in header)} taken as header")
    notes += _left_out(rows, data, header)
    every = ForeignTable(
        rows.source,
        rows.fields[:, :width],
        numbers[:, :width],
        missing[:, :width],
        words[:, :width],
        np.minimum(rows.counts, width),
        None,
        tuple((Passed("", ""),) if blank else () for blank in rows.blank),
        rows.stamps,
        numerals,
        rows.place,
        rows.called,
        tuple(notes),
    )
    return every.only(data, names if layout is None else _given_names(every, layout))


def _given_names(table: ForeignTable, layout: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in layout.split(","))
    if len(names) != table.width:
        raise InputError(f"{table.source}: {table.width} columns, but --layout names {len(names)}")
    return names


def _data_lines(rows: Rows, missing: NDArray[np.bool_], words: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Lines that hold a number or a word for a missing one, and fewer other words than these."""
    filled = rows.fields != ""
    reading = filled & ~words
    unread = rows.fields[words]
    known = {text: is_stamp(text) or line_of(text) is not None for text in set(unread)}
    others = words.copy()
    others[words] = [not known[text] for text in unread]
    strange = others.sum(axis=1)
    most = filled.sum(axis=1)
    few: NDArray[np.bool_] = ((strange <= 1) & (2 * strange < most)) | (4 * strange < most)
    few &= (rows.counts > 1) | ~missing[:, 0] | (rows.counts.max() == 1)  # a line of dashes alone
    return np.asarray(few & ~rows.comment & reading.any(axis=1))


def _header_lines(rows: Rows, data: NDArray[np.bool_], plain: NDArray[np.bool_], width: int) -> list[int]:
    """The line before the first data where it names as many fields, and one of units below it; column numbers."""
    first = int(np.argmax(data))
    if _counts_up(rows.fields[first, : rows.counts[first]]):
        return [first]
    above = []
    for line in range(max(0, first - 2), first):
        names = np.flatnonzero(rows.fields[line] != "")
        if width > 1 and len(names) >= width - 1 and names[-1] >= width - 1 and not np.any(plain[line]):
            above.append(line)
    if len(above) == 2 and _are_units(rows.fields[above[1]]):
        return above
    return above[-1:] if above and above[-1] == first - 1 else []


def _counts_up(fields: NDArray[Any]) -> bool:
    """Whether a word or nothing is followed by 0, 1, 2 ... or 1, 2, 3 ...: column numbers."""
    numbers = [text for text in fields[1:] if text]
    if len(numbers) < 2 or fields[0][:1].isdigit() or fields[0][:1] in ("-", "+", "."):
        return False
    return any(numbers == [str(first + number) for number in range(len(numbers))] for first in (0, 1))


def _are_units(fields: NDArray[Any]) -> bool:
    texts = [text.strip("[](){} ").lower() for text in fields if text]
    return bool(texts) and all(text in UNITS_OF_WORD or text in UNIT_OF_WORD or text in ("v", "-") for text in texts)


def _usual(counts: NDArray[np.intp]) -> int:
    """The most frequent number of fields, the larger of two."""
    often: list[tuple[int, int]] = [(times, count) for count, times in Counter(counts.tolist()).items()]
    return max(often)[1]


def _width(rows: Rows, data: NDArray[np.bool_], usual: int) -> int:
    """The usual number of fields without those at the end that are empty in all lines."""
    lines, width = data & (rows.counts == usual), usual
    while width > 1 and np.all(rows.fields[lines, width - 1] == ""):
        width -= 1
    return width


def _refuse_long(rows: Rows, data: NDArray[np.bool_], width: int) -> None:
    long = data & np.any(rows.fields[:, width:] != "", axis=1)
    if np.any(long):
        line, usual = int(np.argmax(long)), int(np.argmax(data & ~long))
        said = f"{rows.counts[line]} fields, where {rows.called(usual)} has {width}"
        raise InputError(f"{rows.place(line, None)}: {said}")


def _names(rows: Rows, header: list[int], width: int) -> tuple[str, ...] | None:
    """The columns' names, with the units of a second line in brackets."""
    if not header:
        return None
    first = [text.lstrip("#% ") for text in rows.fields[header[0], :width]]
    if len(header) == 1:
        return tuple(first)
    units = (text.strip("[](){} ") for text in rows.fields[header[1], :width])
    return tuple(f"{name} [{unit}]" if unit and unit != "-" else name for name, unit in zip(first, units, strict=True))


def _left_out(rows: Rows, data: NDArray[np.bool_], header: list[int]) -> list[str]:
    """What was passed over, but for comments and what is empty."""
    passed = ~data & ~rows.comment & np.any(rows.fields != "", axis=1)
    for line in header:
        passed &= np.any(rows.fields != rows.fields[line], axis=1)
    lines = np.flatnonzero(passed)
    if len(lines) == 0:
        return []
    shown = " ".join(rows.fields[lines[0]]).strip()[:40]
    more = f" and {len(lines) - 1} other{'s' if len(lines) > 2 else ''}" if len(lines) > 1 else ""
    return [f"left out: {rows.called(int(lines[0]))} ({shown!r}){more}, no readings or cut off"]


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
