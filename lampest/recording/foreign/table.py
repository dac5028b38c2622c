"""The lines of a file that hold readings, what their columns are called, what is left out and why."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.foreign.frames import UNIT_OF_WORD, Clock, Frames, clock_of, is_stamp
from lampest.recording.foreign.words import UNITS_OF_WORD, Numerals, line_of, role_of

# 'Frame 3, t = 1250 ms', 'time: 2025-01-31 12:00:01', 'millis=123'
TITLE_TIME = re.compile(
    r"(?:\b(?P<word>t|time|timestamp|millis|ms|zeit)\s*[:=]\s*)(?P<value>\d[\d.,]*)\s*(?P<unit>ms|us|s)?(?![\d:/-])"
    r"|(?P<stamp>\d{4}-\d{2}-\d{2}[T ]\d{1,2}:\d{2}(?::\d{2}(?:\.\d+)?)?(?:Z|[+-]\d{2}:?\d{2})?)",
    re.IGNORECASE,
)
NUMBER = re.compile(r"\d+(?:[.,:]\d+)*")
SAMPLED = 50_000  # signs or fields of a file's beginning that decide how it is written


@dataclass(frozen=True, eq=False)
class Rows:
    """Lines of a file, cut into fields.

    fields : (lines, fields) texts, '' where a line ends earlier. counts : (lines) how many each has.
    numbers : (lines) as the file counts them. word : what it calls one, 'line' or 'row'. comment : (lines) whether it
    is one. blank : (lines) whether an empty one stands before. stamps : (lines) a terminal's time before it, or ''.
    at : a line's number, a field or None → where in the file.
    """

    source: str
    fields: NDArray[Any]
    counts: NDArray[np.intp]
    numbers: Sequence[int]
    word: str
    comment: NDArray[np.bool_]
    blank: NDArray[np.bool_]
    stamps: Sequence[str]
    at: Callable[[int, int | None], str]
    notes: tuple[str, ...]

    def called(self, line: int) -> str:
        """'line 3'."""
        return f"{self.word} {self.numbers[line]}"


def kind_of(text: str) -> str:
    """A line without its numbers: titles of all frames are alike."""
    return NUMBER.sub("#", text)


class Passed(NamedTuple):
    """A line that holds no readings: its text, and 'line 3'; both empty for a blank one."""

    text: str
    called: str


@dataclass(frozen=True, eq=False)
class ForeignTable:
    """Lines and columns of a file's rows that hold readings.

    read : numbers (NaN for none) of all fields of the rows, whether a reading is said to be missing, and whether a text
    is neither. names : of the columns, or None.
    """

    rows: Rows
    lines: NDArray[np.intp]
    columns: NDArray[np.intp]
    read: tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]
    numerals: Numerals
    names: tuple[str, ...] | None
    notes: tuple[str, ...]

    @cached_property
    def fields(self) -> NDArray[Any]:
        """(lines, width) texts."""
        return np.asarray(self.rows.fields[np.ix_(self.lines, self.columns)])

    @cached_property
    def numbers(self) -> Array:
        """(lines, width) of texts, NaN for none."""
        return np.asarray(self.read[0][np.ix_(self.lines, self.columns)])

    @cached_property
    def words(self) -> NDArray[np.bool_]:
        """(lines, width) whether a text is neither a number nor a missing reading."""
        return np.asarray(self.read[2][np.ix_(self.lines, self.columns)])

    @property
    def counts(self) -> NDArray[np.intp]:
        """(lines) fields that each has."""
        return np.minimum(self.rows.counts[self.lines], self.width)

    @property
    def width(self) -> int:
        """How many fields a line has."""
        return len(self.columns)

    @cached_property
    def before(self) -> tuple[tuple[Passed, ...], ...]:
        """(lines) what stands between the line and the one before."""
        found = []
        for last, line in pairwise([-1, *self.lines.tolist()]):
            passed: list[Passed] = []
            for other in range(last + 1, line + 1):
                passed += [Passed("", "")] if self.rows.blank[other] else []
                if other < line:
                    passed.append(Passed(" ".join(self.rows.fields[other]).strip(), self.rows.called(other)))
            found.append(tuple(passed))
        return tuple(found)

    @cached_property
    def kinds_before(self) -> list[set[str]]:
        """(lines) the kinds of what stands between each and the one before."""
        return [{kind_of(passed.text) for passed in before} for before in self.before]

    def place(self, line: int, field: int | None) -> str:
        """Where in the file."""
        return self.rows.at(self.rows.numbers[self.lines[line]], None if field is None else int(self.columns[field]))

    def called(self, line: int) -> str:
        """'line 3'."""
        return self.rows.called(int(self.lines[line]))

    def only(self, lines: NDArray[np.bool_]) -> "ForeignTable":
        """The table with some of its lines; the others are what stands before the next one."""
        return replace(self, lines=self.lines[lines])

    def without_empty(self) -> "ForeignTable":
        """The table without columns that have a name and nothing in any line, such as LabVIEW's comments."""
        filled = np.any(self.fields != "", axis=0)
        if self.names is None or filled.all():
            return self
        empty = ", ".join(self.names[field] or "a column without a name" for field in np.flatnonzero(~filled))
        return replace(
            self,
            columns=self.columns[filled],
            names=tuple(self.names[field] for field in np.flatnonzero(filled)),
            notes=(*self.notes, f"empty columns left out: {empty}"),
        )

    def frames(
        self, number: NDArray[np.intp], timing: Callable[[], Clock] | None, note: str, words: Sequence[int]
    ) -> Frames:
        """Frames of which each reading is number line · width + field; words : fields whose names may say the unit."""
        names = tuple((self.names or ("",) * self.width)[field] for field in words)

        def named(at: int) -> str:
            return self.rows.source if at < 0 else self.place(*divmod(at, self.width))

        return Frames(self.numbers.ravel(), number, named, timing, (*self.notes, note), names)

    def checked(self, columns: Sequence[int]) -> None:
        """Raise InputError with its place where a field of these columns is neither a number nor a missing reading."""
        chosen = self.words[:, columns]
        if np.any(chosen):
            line, number = (int(part) for part in np.argwhere(chosen)[0])
            shown, field = self.fields[line, columns[number]][:40], columns[number]
            raise InputError(f"{self.place(line, field)}: {shown!r} is no number (field {field + 1} of the line)")

    def timing(self, columns: Sequence[int], lines: Sequence[int]) -> Callable[[], Clock] | None:
        """Times of frames from columns (a date and a time of day may be two), in these lines, else from stamps."""
        if columns:
            return lambda: self._clock(columns, lines)
        if all(self._stamps(lines)):
            return lambda: clock_of(
                self._stamps(lines), "", lambda number: self.place(lines[number], None), self.numerals
            ).said("the terminal's, ")
        return None

    def title_timing(self, begins: Sequence[int], title: str | None) -> Callable[[], Clock] | None:
        """Times in the lines before blocks, where they stand before each of them; title : the kind of these lines."""
        before = [[passed.text for passed in self.before[line]] for line in begins]
        own = [" ".join(text for text in texts if title in (None, kind_of(text))) for texts in before]
        searches = [TITLE_TIME.search(text or " ".join(texts)) for text, texts in zip(own, before, strict=True)]
        matches = [match for match in searches if match is not None]
        if len(matches) != len(begins):
            return None
        texts = [match["stamp"] or match["value"].rstrip(".,") for match in matches]
        word, unit = matches[0]["word"] or "", matches[0]["unit"]
        name = f"{word} [{unit}]" if unit else word
        return lambda: clock_of(texts, name, lambda number: self.place(begins[number], None), self.numerals).said(
            "before each block in "
        )

    def _stamps(self, lines: Sequence[int]) -> list[str]:
        return [self.rows.stamps[self.lines[line]] for line in lines]

    def _clock(self, columns: Sequence[int], lines: Sequence[int]) -> Clock:
        names = self.names or ("",) * self.width
        dates = [column for column in columns if role_of(names[column]) == "date"]
        chosen = [*dates[:1], *[column for column in columns if column not in dates][:1]]
        texts = [" ".join(self.fields[line, column] for column in chosen) for line in lines]
        name = names[chosen[-1]]
        clock = clock_of(texts, name, lambda number: self.place(lines[number], chosen[-1]), self.numerals)
        return clock.said(f"column {name!r} in " if name else "first field in ")


def table_of_rows(rows: Rows, layout: str | None = None) -> ForeignTable:
    """The lines with readings, the header before them, and sentences on what was left out.

    layout : the columns' names, separated by commas, in place of the file's own. Raises InputError where there are
    none, a line has more fields than the others, or the layout another number.
    """
    if rows.fields.size == 0 or np.all(rows.comment):
        raise InputError(f"{rows.source}: holds no values")
    numerals = Numerals.of([text for text in rows.fields[~rows.comment].ravel()[:SAMPLED] if text])
    read = _, missing, words = numerals.numbers(rows.fields)
    data = _data_lines(rows, missing, words)
    if not np.any(data):
        raise InputError(f"{rows.source}: holds a header but no values")
    often = Counter(rows.counts[data].tolist())
    usual = max(often, key=lambda count: (often[count], count))
    width = usual
    while width > 1 and np.all(rows.fields[data & (rows.counts == usual), width - 1] == ""):
        width -= 1
    header = _header_lines(rows, data, ~missing & ~words, width)
    if header:
        width = max(width, min(usual, 1 + int(np.flatnonzero(rows.fields[header[0]] != "")[-1])))
    else:
        data[: int(np.argmax(data & (rows.counts == usual)))] = False  # a terminal opened in the middle of a line
    other = np.ones(len(data), dtype=bool)  # than the header, which is repeated where a board began anew
    for line in header:
        other &= np.any(rows.fields != rows.fields[line], axis=1)
    data &= other
    if not np.any(data):
        raise InputError(f"{rows.source}: holds a header but no values")
    if np.any(long := data & np.any(rows.fields[:, width:] != "", axis=1)):
        line, plain = int(np.argmax(long)), int(np.argmax(data & ~long))
        said = f"{rows.counts[line]} fields, where {rows.called(plain)} has {width}"
        raise InputError(f"{rows.at(rows.numbers[line], None)}: {said}")
    notes = [", ".join((*rows.notes, *(["decimal commas"] if numerals.comma else [])))]
    if header:
        notes.append(f"{' and '.join(map(rows.called, header))} taken as header")
    notes += _left_out(rows, np.flatnonzero(~data & other & ~rows.comment & np.any(rows.fields != "", axis=1)))
    names = _names(rows, header, width)
    if layout is not None:
        names = tuple(name.strip() for name in layout.split(","))
        if len(names) != width:
            raise InputError(f"{rows.source}: {width} columns, but --layout names {len(names)}")
    return ForeignTable(rows, np.flatnonzero(data), np.arange(width), read, numerals, names, tuple(filter(None, notes)))


def _data_lines(rows: Rows, missing: NDArray[np.bool_], words: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Lines that hold a number or a word for a missing one, and fewer other words than these."""
    filled = rows.fields != ""
    unread = rows.fields[words]
    known = {text: is_stamp(text) or line_of(text) is not None for text in set(unread)}
    others = words.copy()
    others[words] = [not known[text] for text in unread]
    strange, most = others.sum(axis=1), filled.sum(axis=1)
    few: NDArray[np.bool_] = ((strange <= 1) & (2 * strange < most)) | (4 * strange < most)
    few &= (rows.counts > 1) | ~missing[:, 0] | (rows.counts.max() == 1)  # a line of dashes alone
    return np.asarray(few & ~rows.comment & (filled & ~words).any(axis=1))


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


def _names(rows: Rows, header: list[int], width: int) -> tuple[str, ...] | None:
    """The columns' names, with the units of a second line in brackets."""
    if not header:
        return None
    first = tuple(text.lstrip("#% ") for text in rows.fields[header[0], :width])
    if len(header) == 1:
        return first
    units = (text.strip("[](){} ") for text in rows.fields[header[1], :width])
    return tuple(f"{name} [{unit}]" if unit and unit != "-" else name for name, unit in zip(first, units, strict=True))


def _left_out(rows: Rows, lines: NDArray[np.intp]) -> list[str]:
    if len(lines) == 0:
        return []
    shown = " ".join(rows.fields[lines[0]]).strip()[:40]
    more = f" and {len(lines) - 1} other{'s' if len(lines) > 2 else ''}" if len(lines) > 1 else ""
    return [f"left out: {rows.called(int(lines[0]))} ({shown!r}){more}, no readings or cut off"]
