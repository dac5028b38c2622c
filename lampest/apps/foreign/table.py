"""Tables of foreign files: the lines and columns with readings, their header and their times."""

import dataclasses
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.apps.foreign.arrays import Frames, Index, Timing
from lampest.apps.foreign.lines import DAMAGED, WRITTEN, FieldLines
from lampest.apps.foreign.notation import SAMPLED
from lampest.apps.foreign.words import (
    MAX_CUT,
    cell_of,
    clock_of,
    has_decimal_comma,
    is_stamp,
    line_of,
    names_pressure,
    names_unit,
    number_of,
    parted,
    pressures_in,
    role_of,
    states_unit,
)
from lampest.files.errors import InputError, counted, first_and_more
from lampest.panel.panel import Array

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
MAX_BROKEN = 0.01  # of the lines may be parts of others; more are titles
# Words before rows of a sheet that are computed from others.
STATISTICS = re.compile(
    r"(mean|average|avg|sum|total|max(imum)?|min(imum)?|std(ev)?|sd|median|mittel(wert)?|summe):?",
    re.IGNORECASE,
)


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
        How lines of readings are recognised.
    numbers : array, shape (lines, all columns)
        Values of all columns of the file.
    clock : mapping
        Parts of a clock in columns of their own, such as 'hour' → number of the column.
    """

    source: FieldLines
    lines: Index
    columns: Index
    fields: NDArray[Any]
    values: Array
    words: NDArray[np.bool_]
    comma: bool
    names: tuple[str, ...]
    notes: tuple[str, ...]
    form: "Form"
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
        parts = {
            name: getattr(self, name)[lines][:, columns] for name in ("fields", "values", "words")
        }
        names = tuple(np.array(self.names, dtype=object)[columns])
        return replace(
            self,
            lines=self.lines[lines],
            columns=self.columns[columns],
            names=names,
            numbers=self.numbers[lines],
            **parts,
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
        number: Index,
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
        for at in fields:
            self.refuse(self.words[:, at], at, f"{{0!r}} is no number (field {at + 1} of the line)")
        names = tuple(self.names[at] for at in fields)
        titles = [text for text in self.before[0] if text.split() != " ".join(self.names).split()]
        # Where the readings' own names are silent, titles and the quantities beside the cells
        # speak.
        beside = (
            name for at, name in enumerate(self.names) if at not in fields and names_pressure(name)
        )
        words = names if any(map(names_unit, names)) else (*filter(states_unit, titles), *beside)
        words = words or tuple(f"values [{unit}]" for unit in self.stated_pressures)

        def named(at: int) -> str:
            return self.source.source if at < 0 else self.place(*divmod(at, self.width))

        return Frames(self.values.ravel(), number, named, timing, (*self.notes, *notes), words)

    @property
    def stated_pressures(self) -> list[str]:
        """First unit of pressure that lines without readings state; empty without any."""
        outside = np.setdiff1d(np.arange(len(self.source.lines)), self.lines)
        texts = dict.fromkeys(" ".join(self.source.lines[line].texts) for line in outside.tolist())
        return list(filter(None, map(pressures_in, texts)))[:1]

    def refuse(self, bad: NDArray[np.bool_], field: int, why: str) -> None:
        """Raise InputError with the place of the first bad line.

        `why` is a template for the field's text.
        """
        for line in np.flatnonzero(bad).tolist():
            raise InputError(
                f"{self.place(line, field)}: "
                f"{why.format(self.fields[line, field][:40] or 'nothing')}"
            )

    def stamps(self, columns: Sequence[int]) -> tuple[list[str], str, int | None, str]:
        """Return the time of each line as text, the name of its column, its field, its origin.

        The columns may be two, date and time of day. Without any, parts of a clock in columns of
        their own count, otherwise a terminal's stamps.
        """
        if self.clock:
            return clock_texts(self.clock, self.numbers), "", None, ""
        if not columns:
            texts = [self.source.lines[line].stamp for line in self.lines]
            return texts, "s", None, "the terminal's, "
        dates = [column for column in columns if role_of(self.names[column]) == "date"]
        chosen = [*dates[:1], *[column for column in columns if column not in dates][:1]]
        texts = [" ".join(line) for line in self.fields[:, chosen]]
        name = self.names[chosen[-1]]
        return texts, name, chosen[-1], f"column {name!r} in " if name else "first field in "

    def timing(self, columns: Sequence[int], lines: Sequence[int]) -> Timing:
        """Return the times of frames that begin at lines; None if the lines have none."""
        texts, name, at, origin = self.stamps(columns)
        of_frames = [texts[line] for line in lines]
        if not any(of_frames) or (not columns and not self.clock and not all(of_frames)):
            return None
        return self._timing(of_frames, name, lines, at, origin)

    def title_timing(self, begins: Sequence[int], title: str | None) -> Timing:
        """Return the times of frames from titles of a kind before each block.

        The result is None if a block has none.
        """
        stamps = self.title_stamps(begins, title)
        if stamps is None:
            return None
        texts, name, comma = stamps
        return self._timing(texts, name, begins, None, "before each block in ", comma=comma)

    def title_stamps(
        self, begins: Sequence[int], title: str | None
    ) -> tuple[list[str], str, bool] | None:
        """Return the times in titles of a kind before lines, and their name.

        With them comes whether a comma is their decimal sign. None if a line has none.
        """
        before = [self.before[line] for line in begins]
        time_texts = [
            " ".join(text for text in passed if title in (None, kind_of(text))) for passed in before
        ]
        matches = [
            TITLE_TIME.search(text or " ".join(passed))
            for text, passed in zip(time_texts, before, strict=True)
        ]
        texts = [match["stamp"] or match["value"].rstrip(".,") for match in matches if match]
        if len(texts) < len(begins) or not matches or not matches[0]:
            return None
        name = matches[0]["inner"] or matches[0]["unit"] or matches[0]["word"] or ""
        # Titles may have a decimal comma where readings are whole numbers; '0,120' is no 120.
        comma = any(text.startswith("0,") or number_of(text, comma=False) is None for text in texts)
        return texts, name, comma and not any(map(is_stamp, texts))

    def of_later(self, source: FieldLines) -> "ReadingsTable":
        """Return later lines of the same source with the columns of this table."""
        width = max(source.fields.shape[1], self.form.usual)
        fields = np.full((len(source.lines), width), "", dtype=object)
        fields[:, : source.fields.shape[1]] = source.fields
        source = dataclasses.replace(source, fields=fields)
        table = self.form.table(source, Parsed.of(fields, comma=self.comma))
        table = table.only(columns=np.searchsorted(table.columns, self.columns))
        return replace(table, names=self.names, clock=self.clock)

    def _timing(
        self,
        texts: Sequence[str],
        name: str,
        lines: Sequence[int],
        field: int | None,
        origin: str,
        *,
        comma: bool = False,
    ) -> Timing:
        """Return the function (unit) → the clock that the texts in lines of a field show."""
        return lambda unit: clock_of(
            texts,
            name,
            lambda at: self.place(lines[at], field),
            comma=self.comma or comma,
            unit=unit,
        ).read_from(origin)


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
        parts = np.stack([part("epoch"), part("nanosecond") + 1e3 * part("microsecond")], axis=1)
        return [
            f"{int(line[0])}.{int(line[1]):09d}" if np.all(np.isfinite(line)) else ""
            for line in parts
        ]
    seconds = part("second") + part("millisecond") / 1000
    parts = np.stack(
        [part("year"), part("month"), part("day"), part("hour"), part("minute"), seconds], axis=1
    )
    form = "{0:04.0f}-{1:02.0f}-{2:02.0f} " if "year" in clock else ""
    form += "{3:02.0f}:{4:02.0f}:{5:09.6f}" if "hour" in clock else ""
    return [form.format(*line).strip() if np.all(np.isfinite(line)) else "" for line in parts]


class Parsed(NamedTuple):
    """Fields of all lines, (lines, fields) each.

    Attributes
    ----------
    texts : array of str
    values : array
        Numbers of the texts; NaN for other texts.
    words : boolean array
        Whether a text is neither a number nor a missing reading.
    damaged : boolean array
        Whether a text has bytes that no text holds.
    """

    texts: NDArray[Any]
    values: Array
    words: NDArray[np.bool_]
    damaged: NDArray[np.bool_]

    @classmethod
    def of(cls, fields: NDArray[Any], *, comma: bool) -> "Parsed":
        """Return the numbers of fields, with a decimal comma or a point."""
        damaged = np.array([DAMAGED in text for text in fields.flat], dtype=bool).reshape(
            fields.shape
        )
        numbers = [
            np.nan if DAMAGED in text else number_of(text, comma=comma) for text in fields.flat
        ]
        values = np.array(numbers, dtype=float).reshape(fields.shape)
        words = np.array([number is None for number in numbers], dtype=bool).reshape(fields.shape)
        return cls(fields, values, words, damaged)

    def with_separator(self, lines: NDArray[np.bool_]) -> "Parsed":
        """Return the fields with the damaged one of some lines parted at its damaged byte."""
        if not np.any(lines):
            return self
        changed = Parsed(
            self.texts.copy(), self.values.copy(), self.words.copy(), self.damaged.copy()
        )
        for line in np.flatnonzero(lines).tolist():
            field = int(np.argmax(self.damaged[line]))
            for part in changed:
                part[line, field + 1 :] = part[line, field:-1].copy()
        return changed

    def without(self, missing: NDArray[np.bool_]) -> "Parsed":
        """Return the fields without those of some lines, (lines, 1), or some of them."""
        if not np.any(missing):
            return self
        return Parsed(
            np.where(missing, "", self.texts),
            np.where(missing, np.nan, self.values),
            self.words & ~missing,
            self.damaged,
        )


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

    def table(self, source: FieldLines, parsed: Parsed, since: int | None = None) -> ReadingsTable:
        """Return the readings of lines from one on, and notes on omitted lines.

        `since` is the first line with readings; None: of later lines, which are not checked.

        The values of a line that is shorter or longer than the others are missing: which of its
        fields was lost is unknown.

        Raises InputError if more than a few lines are longer than the others.
        """
        data = _data_lines(source, parsed, self.usual, alone=self.alone)
        data[: since or 0] = False
        complete = source.counts == self.usual
        # A damaged byte in a line with one field less was a separator: the fields on both sides of
        # it are missing.
        separated = data & parsed.damaged.any(axis=1) & (source.counts == self.usual - 1)
        parsed = parsed.with_separator(separated)
        fields = parsed.texts
        damaged = parsed.damaged.any(axis=1)
        data &= ~damaged | complete | separated
        header = np.array([*self.header, *[""] * (fields.shape[1] - len(self.header))])
        titles = (
            np.all(fields == header, axis=1) if self.header else np.zeros(len(data), dtype=bool)
        )
        data &= ~titles  # a restarted board repeats the header
        filled = np.arange(fields.shape[1]) < source.counts[:, None]
        long = data & np.any(filled[:, self.width :] & (fields[:, self.width :] != ""), axis=1)
        # Only the empty fields at the end may be left out.
        ended = (source.counts >= self.width) & (fields[:, self.width - 1] != "")
        short = data & (source.counts < self.usual) & ~ended & ~separated & (not source.padded)
        if since is not None and long.sum() > MAX_CUT * data.sum():
            line = int(np.argmax(long))
            usual_line = int(np.argmax(data & ~long))
            mismatch = (
                f"{source.counts[line]} fields, where {source.called(usual_line)} has {self.width}"
            )
            raise InputError(f"{source.at(source.lines[line].number, None)}: {mismatch}")
        doubtful = short | long
        parsed = parsed.without(doubtful[:, None])
        excluded = ~data & ~titles & ~source.comment & np.any(fields != "", axis=1)
        excluded &= np.array([line.number > 0 for line in source.lines], dtype=bool)
        broken = _broken_fields(fields, source.counts, data & ~doubtful, excluded | short)
        parsed = parsed.without(broken)
        notes = (
            _line_note(
                source,
                np.any(broken, axis=1),
                "numbers at which a line was broken: they {} missing",
            ),
            _line_note(source, data & damaged, "bytes that are no text: their fields {} missing"),
            _line_note(
                source,
                doubtful,
                f"lines that have not {counted(self.width, 'field')}: the readings {{}} missing",
            ),
            _excluded_note(source, fields, excluded),
        )
        table = ReadingsTable(
            source=source,
            lines=np.arange(len(data)),
            columns=np.arange(fields.shape[1]),
            fields=parsed.texts,
            values=parsed.values,
            words=parsed.words,
            comma=self.comma,
            names=("",) * fields.shape[1],
            notes=tuple(filter(None, notes)),
            form=self,
            numbers=parsed.values,
        )
        return replace(table.only(data, slice(self.width)), names=self.names)


def readings_table(source: FieldLines, layout: str | None = None) -> ReadingsTable:
    """Return the lines with readings, their header, and notes on omitted lines.

    `layout` contains names of the columns, separated by commas, in place of the file's. Raises
    InputError if there are no readings, if lines have more fields than most, or if the layout
    has another number of columns.
    """
    if source.fields.size == 0 or np.all(source.comment):
        raise InputError(f"{source.source}: holds no values")
    comma = has_decimal_comma(
        [text for text in source.fields[~source.comment].ravel()[:SAMPLED] if text]
    )
    parsed = Parsed.of(source.fields, comma=comma)
    alone = bool(
        source.counts.max() <= 2 or np.median(source.counts[~source.comment]) == 1
    )  # dashes or a number alone are titles, unless most lines are such
    often = Counter(source.counts[~source.comment].tolist())
    data = _data_lines(source, parsed, often.most_common(1)[0][0], alone=alone)
    # the most frequent number of fields, of equally frequent ones the largest
    often = Counter(source.counts[data].tolist())
    usual = max(often, key=lambda count: (often[count], count), default=0)
    data = _data_lines(source, parsed, usual, alone=alone)
    fields = parsed.texts
    complete = source.counts == usual
    width = _width(fields[data & complete], usual)
    header = _header_line(fields, data, width, source.lines[0].number)
    form = Form(comma, usual, width, alone, names=("",) * width)
    first = 0
    note = ""
    if header is None:
        first = int(np.argmax(data & complete))  # a terminal opened in the middle of a line
    else:
        # The header may widen the table.
        width = max(width, min(usual, 1 + int(np.flatnonzero(fields[header] != "")[-1])))
        names, has_units_line = _names(fields[:, :width], header)
        form = replace(form, width=width, header=tuple(fields[header]), names=tuple(names))
        note = _header_note(source, header, units=has_units_line)
    if not np.any(data & ~np.all(fields == fields[header], axis=1) if header is not None else data):
        raise InputError(f"{source.source}: holds a header but no values")
    table = form.table(source, parsed, first)
    notation = ", ".join((*source.notes, *(["decimal commas"] if comma else [])))
    table = replace(table, notes=(*filter(None, (notation, note)), *table.notes))
    return table if layout is None else _laid_out(table, layout)


def _laid_out(table: ReadingsTable, layout: str) -> ReadingsTable:
    """Return the table with the columns that a layout lists, without those named '-'."""
    names = [name.strip() for name in layout.split(",")]
    if len(names) != table.width:
        single = "" if len(names) > 1 else f", {layout!r}, which is no import format either"
        raise InputError(
            f"{table.source.source}: {table.width} columns, but `layout` names {len(names)}{single}"
        )
    table = replace(table, names=tuple(names))
    skipped = [field for field, name in enumerate(names) if name == "-"]
    if not skipped:
        return table
    note = f"fields {first_and_more([field + 1 for field in skipped])} left out, as `layout` says"
    named = [field for field in range(table.width) if field not in skipped]
    return replace(table.only(columns=named), notes=(*table.notes, note))


def _width(fields: NDArray[Any], usual: int) -> int:
    """Return the number of fields without the last ones that are empty in all complete lines."""
    width = usual
    while width > 1 and np.all(fields[:, width - 1] == ""):
        width -= 1
    return width


def _broken_fields(
    fields: NDArray[Any], counts: Index, whole: NDArray[np.bool_], others: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the fields of whole lines that a break within a number cut, (lines, fields).

    A few lines of numbers alone stand before or behind such lines, and their number and that of
    the whole line are together no longer than numbers of the field.
    """
    broken = np.zeros(fields.shape, dtype=bool)
    texts = {
        at: [text.strip("[](){}") for text in fields[at, : counts[at]]]
        for at in np.flatnonzero(others).tolist()
    }
    parts = [at for at, line in texts.items() if all(map(WRITTEN.fullmatch, line))]
    if len(parts) > max(1, MAX_BROKEN * whole.sum()):  # titles are numbers
        return broken
    for at in parts:
        first, last = texts[at][0], texts[at][-1]
        for line, joined in ((at - 1, "{0}" + first), (at + 1, last + "{0}")):
            if not 0 <= line < len(fields) or not whole[line]:
                continue
            field = counts[line] - 1 if line < at else 0
            longest = max(map(len, filter(WRITTEN.fullmatch, fields[whole, field])), default=0)
            broken[line, field] = len(joined.format(fields[line, field])) <= longest
    return broken


def _header_note(source: FieldLines, header: int | None, *, units: bool) -> str:
    """Return the sentence on the line that is the header; '' without one."""
    if header is None:
        return ""
    if source.lines[header].number == 0:  # of records, whose names are no line
        return f"{source.word}s name their fields"
    above = ", with the names of the line above" if units else ""
    return f"{source.called(header)} taken as header{above}"


def _line_note(source: FieldLines, lines: NDArray[np.bool_], sentence: str) -> str:
    """Return a sentence on lines, (lines,), with their numbers; '' without any."""
    if not np.any(lines):
        return ""
    numbers = [source.lines[line].number for line in np.flatnonzero(lines).tolist()]
    return sentence.format(f"in {source.word} {first_and_more(numbers)} are")


def _excluded_note(source: FieldLines, fields: NDArray[Any], excluded: NDArray[np.bool_]) -> str:
    """Return the sentence on lines that are left out, (lines,); '' without any."""
    lines = np.flatnonzero(excluded)
    if not len(lines):
        return ""
    shown = " ".join(fields[lines[0]]).strip()[:40]
    named = first_and_more([source.lines[line].number for line in lines.tolist()])
    called = f"line {named} ({shown!r})"
    if len(lines) > 1:
        called = f"lines {named} (the first: {shown!r})"
    return f"left out: {called.replace('line', source.word)}, no readings or cut off"


def _names(fields: NDArray[Any], header: int) -> tuple[list[str], bool]:
    """Return the names of columns, and whether the header holds units only.

    The line above then holds the names.
    """
    names = [text.lstrip("#% ") for text in fields[header]]
    above = fields[header - 1] if header else np.full(len(names), "")
    named = not np.any((above == "") & (fields[header] != ""))
    if not named or not all(parted(f"x {unit}")[1] for unit in names if unit):
        return names, False
    return [f"{name} {unit}".strip() for name, unit in zip(above, names, strict=True)], True


def _data_lines(
    source: FieldLines, parsed: Parsed, usual: int, *, alone: bool
) -> NDArray[np.bool_]:
    """Return whether a line has data, boolean (lines,).

    A line of data has a number or, in place of all `usual` ones, words for missing ones, and few
    other words. It is no mean of other lines, and no single number unless these stand `alone`.
    """
    fields = source.fields
    words = parsed.words
    filled = fields != ""
    strange = {
        text
        for text in set(fields[words].tolist())
        if not (is_stamp(text) or line_of(text) or cell_of(text))
    }
    foreign = np.zeros(len(fields), dtype=int)
    total = filled.sum(axis=1)
    np.add.at(foreign, np.nonzero(words)[0], [text in strange for text in fields[words]])
    few = ((foreign <= 1) & (2 * foreign < total)) | (4 * foreign < total)
    few &= (source.counts > 1) | alone
    few &= ~np.isnan(parsed.values).all(axis=1) | (source.counts == usual)
    summaries = set(filter(STATISTICS.fullmatch, strange))
    if summaries:
        few &= [not summaries.intersection(line[:2]) for line in fields.tolist()]
    return np.asarray(few & ~source.comment & (filled & ~words).any(axis=1))


def _header_line(
    fields: NDArray[Any], data: NDArray[np.bool_], width: int, first_number: int
) -> int | None:
    """Return the number of the header's line; None without a header.

    The header is the first data line or the line before, and names or counts the fields. Names of
    records have the number 0.
    """
    if first_number == 0:  # of records
        return 0
    first = int(np.argmax(data))
    following = fields[first + 1, 0] if first + 1 < len(fields) else ""
    if (
        width > 4
        and [*fields[first, :width]] == [*map(str, range(width))]
        and following != str(width)
    ):
        return first  # pandas names columns by numbers
    if _names_fields(fields[first]):
        return first
    names: list[int] = np.flatnonzero(fields[first - 1] != "").tolist() if first else []
    complete = width > 1 and len(names) >= width - 1 and names[-1] >= width - 1
    texts = [text for text in fields[first - 1] if text]
    named = all(number_of(text, comma=False) is None for text in texts) or _names_fields(
        fields[first - 1]
    )
    return first - 1 if complete and named else None


def _names_fields(texts: Sequence[str]) -> bool:
    """Return whether texts are words, or an empty field, before or after numbers.

    The numbers are 0, 1, 2 ... or 1, 2, 3 ...
    """
    numbers = [text for text in texts if text.isdecimal()]
    words = [text for text in texts if text and not text.isdecimal()]
    counted = [list(map(str, range(start, start + len(numbers)))) for start in (0, 1)]
    plain = not any(text[0].isdigit() or text[0] in "-+." for text in words)
    return len(numbers) > 1 and numbers in counted and plain and (len(words) > 0 or texts[0] == "")
