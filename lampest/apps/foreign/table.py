"""Tables of foreign files: lines and columns with readings, and their times."""

import dataclasses
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.apps.foreign.arrays import Frames, Timing
from lampest.apps.foreign.clocks import clock_of, is_stamp
from lampest.apps.foreign.lines import FieldLines
from lampest.apps.foreign.words import (
    MAX_CUT,
    line_of,
    names_pressure,
    names_unit,
    number_of,
    pressures_in,
    role_of,
    states_unit,
)
from lampest.files.errors import InputError, first_and_more
from lampest.panel.panel import Array, Mask, Numbers

# 'Frame 3, t = 1250 ms', 'Frame 3 @ 1250 ms', 'Measurement Time(sec),0.120', 'time: 2025-01-31
# 12:00:01', 'millis=123'
TITLE_TIME = re.compile(
    r"(?:\b(?P<word>t|time|timestamp|elapsed|millis|micros|ms|us|zeit)\s*"
    r"(?:[\[(]\s*(?P<inner>[^\W\d_]+)\s*[\])]\s*[:=]?|[:=])\s*|@\s*(?=[\d.,]+\s*[mµu]?s\b))(?P<value>\d[\d.,]*)\s*(?P<unit>[mµu]?s(?:ec)?\b)?(?![\d:/-])"
    r"|(?P<stamp>\d{4}-\d{2}-\d{2}[T ]\d{1,2}:\d{2}(?::\d{2}(?:\.\d+)?)?(?:Z|[+-]\d{2}:?\d{2})?"
    r"|\b\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)",
    re.IGNORECASE,
)
NUMBER = re.compile(r"\d+(?:[.,:]\d+)*")
MIN_SAME = 3  # readings with the same word in their place, which no damage of a line writes


@dataclass(frozen=True)
class Form:
    """How lines of readings are recognised among others.

    Attributes
    ----------
    comma : bool
        Whether numbers have a decimal comma.
    usual : int
        Fields of a line, empty ones at its end included.
    width : int
        Fields without those that are empty at the end of all lines.
    alone : bool
        Whether a single number may be a line of readings.
    header : tuple of str
        Fields of the header, which may be repeated; empty without one.
    names : tuple of str
        Names of the columns; '' without a header.
    """

    comma: bool
    usual: int
    width: int
    alone: bool
    header: tuple[str, ...] = ()
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Stamps:
    """Times as texts.

    Attributes
    ----------
    texts : list of str
        '' where there is none.
    name : str
        Name of the times, which may contain the unit of numbers.
    origin : str
        Their place in words.
    comma : bool
        Whether they have a decimal comma.
    field : int or None
        Field that holds them.
    """

    texts: list[str]
    name: str
    origin: str
    comma: bool
    field: int | None = None


@dataclass(frozen=True, eq=False)
class ReadingsTable:
    """Lines and columns of a file with readings.

    Attributes
    ----------
    source : FieldLines
        All lines of the file.
    lines : array of int
        Numbers of the lines in `source`.
    columns : array of int
        Numbers of their fields.
    fields : array of str, shape (lines, columns)
        Texts.
    values : array, shape (lines, columns)
        Numbers of the texts; NaN for other texts.
    words : boolean array, shape (lines, columns)
        Whether a text is neither a number nor a missing reading.
    comma : bool
        Whether numbers have a decimal comma.
    names : tuple of str
        Names of the columns; '' without a header.
    notes : tuple of str
        Sentences on the interpretation of the file.
    form : Form
        How its lines were recognised.
    numbers : array, shape (lines, all columns)
        Values of all columns of the file.
    clock : mapping
        Parts of a clock in columns of their own, such as 'hour' → number of the column.
    """

    source: FieldLines
    lines: Numbers
    columns: Numbers
    fields: NDArray[Any]
    values: Array
    words: Mask
    comma: bool
    names: tuple[str, ...]
    notes: tuple[str, ...]
    form: Form
    numbers: Array
    clock: Mapping[str, int] = dataclasses.field(default_factory=dict)

    @property
    def width(self) -> int:
        """Number of fields of a line."""
        return len(self.columns)

    @cached_property
    def before(self) -> list[dict[str, str]]:
        """Texts between each line and the previous one, with their places such as 'line 3'.

        The value is '' for a blank line.
        """
        between = []
        for last, line in pairwise([-1, *self.lines.tolist()]):
            blank = {"": ""} if self.source.blank[last + 1 : line + 1].any() else {}
            texts = {
                " ".join(self.source.fields[at]).strip(): self.source.called(at)
                for at in range(last + 1, line)
            }
            between.append(blank | texts)
        return between

    @cached_property
    def kinds(self) -> list[set[str]]:
        """Kinds of the texts between each line and the previous one.

        Titles that differ in numbers only are equal.
        """
        return [set(map(kind_of, passed)) for passed in self.before]

    def place(self, line: int, field: int | None) -> str:
        """Return the place of a field in the file."""
        number = self.source.lines[self.lines[line]].number
        return self.source.at(number, None if field is None else int(self.columns[field]))

    def only(self, lines: Any = slice(None), columns: Any = slice(None)) -> "ReadingsTable":
        """Return the table with chosen lines and columns.

        Other lines count as titles of the next line.
        """
        return replace(
            self,
            lines=self.lines[lines],
            columns=self.columns[columns],
            fields=self.fields[lines][:, columns],
            values=self.values[lines][:, columns],
            words=self.words[lines][:, columns],
            names=tuple(np.array(self.names, dtype=object)[columns]),
            numbers=self.numbers[lines],
        )

    def line_numbers(self, field: int) -> Array:
        """Return the numbers in a field of all lines, from 3, R3 or 'row 3'; else NaN."""
        values = self.values[:, field].copy()
        unread = self.words[:, field]
        texts = self.fields[unread, field]
        lines = {text: line_of(text) or ("", np.nan) for text in set(texts)}
        values[unread] = [lines[text][1] for text in texts]
        return values

    def frames(
        self,
        number: Numbers,
        fields: Sequence[int],
        timing: Timing,
        notes: Sequence[str],
    ) -> Frames:
        """Return the frames of the readings in given fields.

        Raises InputError if a reading is a word.

        Parameters
        ----------
        number : array of int, shape (frames, rows, columns)
            Line · width + field of each reading; -1 where it is missing.
        fields : sequence of int
            Fields of the readings.
        timing : callable or None
            See `Frames`.
        notes : sequence of str
            Notes on the layout.
        """
        self.refuse_words(fields)
        names = tuple(self.names[at] for at in fields)
        titles = [text for text in self.before[0] if text.split() != " ".join(self.names).split()]
        # Where the readings' own names are silent, titles and the quantities beside the cells
        # speak.
        beside = (
            name for at, name in enumerate(self.names) if at not in fields and names_pressure(name)
        )
        words = names if any(map(names_unit, names)) else (*filter(states_unit, titles), *beside)
        if not words:
            outside = sorted({*range(len(self.source.lines))} - {*self.lines.tolist()})
            stated = (pressures_in(" ".join(self.source.lines[line].texts)) for line in outside)
            words = tuple(f"values [{unit}]" for unit in islice(filter(None, stated), 1))

        def named(at: int) -> str:
            return self.source.source if at < 0 else self.place(*divmod(at, self.width))

        parts = self.source.parts if len(fields) == number[0].size else 1
        notes = (*self.notes, *notes)
        return Frames(self.values.ravel(), number, named, timing, notes, words, parts)

    def refuse_words(self, fields: Iterable[int], most: float = 0.0) -> None:
        """Raise InputError with the place if more than a fraction of a field's texts are words.

        Fewer are damaged readings, unless the same word stands in place of several ones.
        """
        readings = sorted(fields)
        often = Counter(self.fields[:, readings][self.words[:, readings]].tolist())
        same = {text for text, count in often.items() if count >= MIN_SAME}
        for at in readings:
            words = self.words[:, at]
            if np.mean(words) > most or not same.isdisjoint(self.fields[words, at]):
                self.refuse(words, at, f"{{0!r}} is no number (field {at + 1} of the line)")

    def refuse(self, bad: Mask, field: int, why: str) -> None:
        """Raise InputError with the place of the first bad line.

        `why` is a template for the field's text.
        """
        for line in np.flatnonzero(bad).tolist():
            raise InputError(
                f"{self.place(line, field)}: "
                f"{why.format(self.fields[line, field][:40] or 'nothing')}"
            )

    def called(self, line: int) -> str:
        """Return the name of a line in the file: 'line 3'."""
        return self.source.called(int(self.lines[line]))

    def with_notes(self, *notes: str) -> "ReadingsTable":
        """Return the table with further notes."""
        return replace(self, notes=(*self.notes, *notes))

    def without(self, lines: Mask, why: str) -> "ReadingsTable":
        """Return the table without a few lines, which a note names; unchanged if there are more."""
        if not 0 < lines.sum() <= MAX_CUT * len(lines):
            return self
        places = first_and_more([self.called(line) for line in np.flatnonzero(lines).tolist()])
        return self.only(~lines).with_notes(f"left out: {places}, which {why}")

    def stamps(self, columns: Sequence[int]) -> Stamps:
        """Return the time of each line.

        The columns may be two, date and time of day. Without any, parts of a clock in columns of
        their own count, otherwise a terminal's stamps.
        """
        if self.clock:
            return Stamps(clock_texts(self.clock, self.numbers), "", "", self.comma)
        if not columns:
            texts = [self.source.lines[line].stamp for line in self.lines]
            return Stamps(texts, "s", "the terminal's, ", self.comma)
        dates = [column for column in columns if role_of(self.names[column]) == "date"]
        times = [column for column in columns if column not in dates]
        chosen = [*dates[:1], *times[:1]]
        texts = [" ".join(line) for line in self.fields[:, chosen]]
        name = self.names[chosen[-1]]
        origin = f"column {name!r} in " if name else "first field in "
        return Stamps(texts, name, origin, self.comma, chosen[-1])

    def times(
        self, columns: Sequence[int], lines: Sequence[int], title: str | None
    ) -> Stamps | None:
        """Return the times of frames that begin at lines; None if the lines have none.

        Parameters
        ----------
        columns : sequence of int
            See `stamps`.
        lines : sequence of int
            First line of each frame.
        title : str or None
            Kind of the titles before the lines, which are read if the lines themselves have no
            times; None for titles of any kind.
        """
        stamps = self.stamps(columns)
        texts = [stamps.texts[line] for line in lines]
        if any(texts) and (columns or self.clock or all(texts)):
            return replace(stamps, texts=texts)
        matches = list[re.Match[str]]()
        for line in lines:
            before = self.before[line]
            text = " ".join(text for text in before if title in (None, kind_of(text)))
            match = TITLE_TIME.search(text or " ".join(before))
            if match is None:
                return None
            matches.append(match)
        if not matches:
            return None
        texts = [match["stamp"] or match["value"].rstrip(".,") for match in matches]
        name = matches[0]["inner"] or matches[0]["unit"] or matches[0]["word"] or ""
        # Titles may have a decimal comma where readings are whole numbers; '0,120' is no 120.
        comma = any(text.startswith("0,") or number_of(text, comma=False) is None for text in texts)
        comma = self.comma or (comma and not any(map(is_stamp, texts)))
        return Stamps(texts, name, "before each block in ", comma)

    def timing(self, stamps: Stamps | None, lines: Sequence[int]) -> Timing:
        """Return the function (unit) → the clock that the stamps of lines show."""
        if stamps is None:
            return None
        return lambda unit: clock_of(
            stamps.texts,
            stamps.name,
            lambda at: self.place(lines[at], stamps.field),
            comma=stamps.comma,
            unit=unit,
        ).read_from(stamps.origin)


def kind_of(text: str) -> str:
    """Return a line with '#' in place of its numbers.

    The titles of all frames have the same result.
    """
    return NUMBER.sub("#", text)


def clock_texts(clock: Mapping[str, int], numbers: Array) -> list[str]:
    """Return the times of lines, (lines, columns), by the columns of a clock's parts."""

    def part(name: str) -> Array:
        return numbers[:, clock[name]] if name in clock else np.zeros(len(numbers))

    if "epoch" in clock:
        pairs = zip(part("epoch"), part("nanosecond"), strict=True)
        return [
            f"{int(whole)}.{int(nano):09d}" if np.isfinite(whole + nano) else ""
            for whole, nano in pairs
        ]
    seconds = part("second") + part("millisecond") / 1000
    parts = np.stack([*map(part, ("year", "month", "day", "hour", "minute")), seconds], axis=1)
    form = "{0:04.0f}-{1:02.0f}-{2:02.0f} " if "year" in clock else ""
    form += "{3:02.0f}:{4:02.0f}:{5:09.6f}" if "hour" in clock else ""
    return [form.format(*line).strip() if np.all(np.isfinite(line)) else "" for line in parts]
