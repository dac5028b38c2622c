"""Form of tables: which lines of a file hold readings, and which its header."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.apps.foreign.clocks import is_stamp
from lampest.apps.foreign.lines import DAMAGED, WRITTEN, FieldLines
from lampest.apps.foreign.notation import SAMPLED
from lampest.apps.foreign.table import MIN_SAME, Form, ReadingsTable
from lampest.apps.foreign.words import (
    MAX_CUT,
    cell_of,
    has_decimal_comma,
    line_of,
    number_of,
    parted,
)
from lampest.files.errors import InputError, counted, first_and_more
from lampest.panel.panel import Array, Mask, Numbers

MAX_SHOWN = 40  # characters of a line in a message
MAX_BROKEN = 0.01  # of the lines may be parts of others; more are titles
# Words before rows of a sheet that are computed from others.
STATISTICS = re.compile(
    r"(mean|average|avg|sum|total|max(imum)?|min(imum)?|std(ev)?|sd|median|mittel(wert)?|summe):?",
    re.IGNORECASE,
)


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
    words: Mask
    damaged: Mask

    @classmethod
    def of(cls, fields: NDArray[Any], *, comma: bool) -> "Parsed":
        """Return the numbers of fields, with a decimal comma or a point."""
        numbers = [
            np.nan if DAMAGED in text else number_of(text, comma=comma) for text in fields.flat
        ]
        values = np.array(numbers, dtype=float).reshape(fields.shape)
        marks = [
            [number is None for number in numbers],
            [DAMAGED in text for text in fields.flat],
        ]
        words, damaged = np.array(marks, dtype=bool).reshape(2, *fields.shape)
        return cls(fields, values, words, damaged)

    def with_separator(self, lines: Mask) -> "Parsed":
        """Return the fields with the damaged one of some lines parted at its damaged byte."""
        changed = Parsed._make(part.copy() for part in self)
        for line in np.flatnonzero(lines).tolist():
            field = int(np.argmax(self.damaged[line]))
            for part in changed:
                part[line, field + 1 :] = part[line, field:-1].copy()
        return changed


def readings_table(source: FieldLines, layout: str | None = None) -> ReadingsTable:
    """Return the lines with readings, their header, and notes on omitted lines.

    `layout` contains names of the columns, separated by commas, in place of the file's. Raises
    InputError if there are no readings, if lines have more fields than most, or if the layout
    has another number of columns.
    """
    if source.fields.size == 0 or np.all(source.comment):
        raise InputError(f"{source.source}: holds no values")
    plain = ~source.comment
    comma = has_decimal_comma([text for text in source.fields[plain].ravel()[:SAMPLED] if text])
    parsed = Parsed.of(source.fields, comma=comma)
    alone = bool(
        source.counts.max() <= 2 or np.median(source.counts[plain]) == 1
    )  # dashes or a number alone are titles, unless most lines are such
    often = Counter(source.counts[plain].tolist())
    data = _data_lines(source, parsed, often.most_common(1)[0][0], alone=alone)
    # the most frequent number of fields, of equally frequent ones the largest
    often = Counter(source.counts[data].tolist())
    usual = max(often, key=lambda count: (often[count], count), default=0)
    data = _data_lines(source, parsed, usual, alone=alone)
    fields = parsed.texts
    complete = source.counts == usual
    # Fields that are empty at the end of all complete lines are none.
    width = usual
    while width > 1 and np.all(fields[data & complete, width - 1] == ""):
        width -= 1
    header = _header_line(fields, data, width, source.lines[0].number)
    form = Form(comma, usual, width, alone, names=("",) * width)
    first = 0
    note = ""
    if header is None:
        first = int(np.argmax(data & complete))  # a terminal opened in the middle of a line
    else:
        data &= ~np.all(fields == fields[header], axis=1)
        # The header may widen the table.
        named = np.flatnonzero(fields[header] != "")
        width = max(width, min(usual, 1 + int(named.max(initial=-1))))
        names, has_units_line = _names(fields[:, :width], header)
        form = replace(form, width=width, header=tuple(fields[header]), names=tuple(names))
        if source.lines[header].number == 0:  # of records, whose names are no line
            note = f"{source.word}s name their fields"
        else:
            above = ", with the names of the line above" if has_units_line else ""
            note = f"{source.called(header)} taken as header{above}"
    if not np.any(data):
        line = source.lines[int(np.argmax(plain))]
        shown = " ".join(line.texts)[:MAX_SHOWN]
        if header is None and re.search(r"\d", shown):
            place = source.at(line.number, None)
            raise InputError(f"{place}: {shown!r}, as all lines, is no readings")
        raise InputError(f"{source.source}: holds a header but no values")
    table = lines_of_form(form, source, parsed, first)
    notation = ", ".join((*source.notes, *(["decimal commas"] if comma else [])))
    table = replace(table, notes=(*filter(None, (notation, note)), *table.notes))
    return table if layout is None else _laid_out(table, layout)


def later_lines(table: ReadingsTable, source: FieldLines) -> ReadingsTable:
    """Return later lines of the same source with the columns of a table."""
    width = max(source.fields.shape[1], table.form.usual, len(table.form.header))
    fields = np.full((len(source.lines), width), "", dtype=object)
    fields[:, : source.fields.shape[1]] = source.fields
    source = replace(source, fields=fields)
    later = lines_of_form(table.form, source, Parsed.of(fields, comma=table.comma))
    later = later.only(columns=np.searchsorted(later.columns, table.columns))
    return replace(later, names=table.names, clock=table.clock)


def lines_of_form(
    form: Form, source: FieldLines, parsed: Parsed, since: int | None = None
) -> ReadingsTable:
    """Return the readings of lines from one on, and notes on omitted lines.

    `since` is the first line with readings; None: of later lines, which are not checked.

    The values of a line that is shorter or longer than the others are missing: which of its
    fields was lost is unknown.

    Raises InputError if more than a few lines are longer than the others.
    """
    data = _data_lines(source, parsed, form.usual, alone=form.alone)
    data[: since or 0] = False
    complete = source.counts == form.usual
    # A damaged byte in a line with one field less was a separator: the fields on both sides of
    # it are missing.
    separated = data & parsed.damaged.any(axis=1) & (source.counts == form.usual - 1)
    parsed = parsed.with_separator(separated)
    fields = parsed.texts
    damaged = parsed.damaged.any(axis=1)
    data &= ~damaged | complete | separated
    header = np.array([*form.header, *[""] * (fields.shape[1] - len(form.header))])
    titles = np.all(fields == header, axis=1)  # a restarted board repeats the header
    data &= ~titles
    long = data & np.any(fields[:, form.width :] != "", axis=1)
    # Only the empty fields at the end may be left out.
    ended = (source.counts >= form.width) & (fields[:, form.width - 1] != "")
    short = data & (source.counts < form.usual) & ~ended & ~separated & (not source.padded)
    if since is not None and long.sum() > MAX_CUT * data.sum():
        raise _mismatch(source, int(np.argmax(long)), int(np.argmax(data & ~long)), form.width)
    doubtful = short | long
    excluded = ~data & ~titles & ~source.comment & np.any(fields != "", axis=1)
    excluded &= np.array([line.number > 0 for line in source.lines], dtype=bool)
    broken = _broken_fields(fields, source.counts, data & ~doubtful, excluded | short)
    missing = broken | doubtful[:, None]
    values = np.where(missing, np.nan, parsed.values)
    parted = np.any(broken, axis=1)
    unequal = f"lines that have not {counted(form.width, 'field')}: the readings {{}} missing"
    notes = (
        _line_note(source, parted, "numbers at which a line was broken: they {} missing"),
        _line_note(source, data & damaged, "bytes that are no text: their fields {} missing"),
        _line_note(source, doubtful, unequal),
        _excluded_note(source, fields, excluded),
    )
    table = ReadingsTable(
        source=source,
        lines=np.arange(len(data)),
        columns=np.arange(fields.shape[1]),
        fields=np.where(missing, "", fields),
        values=values,
        words=parsed.words & ~missing,
        comma=form.comma,
        names=("",) * fields.shape[1],
        notes=tuple(filter(None, notes)),
        form=form,
        numbers=values,
    )
    return replace(table.only(data, slice(form.width)), names=form.names)


def _mismatch(source: FieldLines, long: int, usual: int, width: int) -> InputError:
    """Return the error of a line that is longer than the usual ones, of which one is named."""
    mismatch = f"{source.counts[long]} fields, where {source.called(usual)} has {width}"
    return InputError(f"{source.at(source.lines[long].number, None)}: {mismatch}")


def _laid_out(table: ReadingsTable, layout: str) -> ReadingsTable:
    """Return the table with the columns that a layout lists, without those named '-'."""
    names = [name.strip() for name in layout.split(",")]
    if len(names) != table.width:
        single = "" if len(names) > 1 else f", {layout!r}, which is no import format either"
        raise InputError(
            f"{table.source.source}: {table.width} columns, but `layout` names {len(names)}{single}"
        )
    table = replace(table, names=tuple(names))
    skipped = [field for field, name in enumerate(names, 1) if name == "-"]
    if not skipped:
        return table
    note = f"fields {first_and_more(skipped)} left out, as `layout` says"
    return table.only(columns=[name != "-" for name in names]).with_notes(note)


def _broken_fields(fields: NDArray[Any], counts: Numbers, whole: Mask, others: Mask) -> Mask:
    """Return the fields of whole lines that a break within a number cut, (lines, fields).

    A few lines of numbers alone stand before or behind such lines, and their number and that of
    the whole line are together no longer than numbers of the field.
    """
    broken = np.zeros(fields.shape, dtype=bool)
    texts = {
        at: [*filter(None, (text.strip("[](){}") for text in fields[at, : counts[at]]))]
        for at in np.flatnonzero(others).tolist()
    }
    parts = [at for at, line in texts.items() if line and all(map(WRITTEN.fullmatch, line))]
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


def _line_note(source: FieldLines, lines: Mask, sentence: str) -> str:
    """Return a sentence on lines, (lines,), with their numbers; '' without any."""
    if not np.any(lines):
        return ""
    numbers = [source.lines[line].number for line in np.flatnonzero(lines).tolist()]
    return sentence.format(f"in {source.word} {first_and_more(numbers)} are")


def _excluded_note(source: FieldLines, fields: NDArray[Any], excluded: Mask) -> str:
    """Return the sentence on lines that are left out, (lines,); '' without any."""
    lines = np.flatnonzero(excluded).tolist()
    if not lines:
        return ""
    shown = " ".join(fields[lines[0]]).strip()[:MAX_SHOWN]
    named = first_and_more([source.lines[line].number for line in lines])
    called = (
        f"{source.word}s {named} (the first: {shown!r})"
        if len(lines) > 1
        else f"{source.word} {named} ({shown!r})"
    )
    return f"left out: {called}, no readings or cut off"


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


def _data_lines(source: FieldLines, parsed: Parsed, usual: int, *, alone: bool) -> Mask:
    """Return whether a line has data, boolean (lines,).

    A line of data has a number or, in place of all `usual` ones, words for missing ones, and few
    other words, but for those that stand among the numbers of several lines: readings that are
    none. It is no mean of other lines, and no single number unless these stand `alone`.
    """
    fields = source.fields
    words = parsed.words
    filled = fields != ""
    strange = {
        text
        for text in set(fields[words].tolist())
        if not (is_stamp(text) or line_of(text) or cell_of(text))
    }
    summaries = set(filter(STATISTICS.fullmatch, strange))
    total = filled.sum(axis=1)

    def few_foreign() -> Mask:
        """Return whether lines have few strange words, beside more numbers."""
        foreign = np.zeros(len(fields), dtype=int)
        np.add.at(foreign, np.nonzero(words)[0], [text in strange for text in fields[words]])
        single = (foreign <= 1) & (2 * foreign < total)
        return np.asarray(single | (4 * foreign < total))

    few = few_foreign()
    if strange:
        lines, texts = np.nonzero(words & few[:, None])[0], fields[words & few[:, None]]
        often = Counter(text for _, text in set(zip(lines.tolist(), texts.tolist(), strict=True)))
        strange -= {text for text, count in often.items() if count >= MIN_SAME}
        few = few_foreign()
    few &= (source.counts > 1) | alone
    few &= ~np.isnan(parsed.values).all(axis=1) | (source.counts == usual)
    if summaries:
        few &= [not summaries.intersection(line[:2]) for line in fields.tolist()]
    return np.asarray(few & ~source.comment & (filled & ~words).any(axis=1))


def _header_line(fields: NDArray[Any], data: Mask, width: int, first_number: int) -> int | None:
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
    if not first or width < 2:
        return None
    above = fields[first - 1]
    names = np.flatnonzero(above != "")
    complete = len(names) >= width - 1 and names[-1] >= width - 1
    words = all(number_of(text, comma=False) is None for text in above if text)
    return first - 1 if complete and (words or _names_fields(above)) else None


def _names_fields(texts: Sequence[str]) -> bool:
    """Return whether texts are words, or an empty field, before or after numbers.

    The numbers are 0, 1, 2 ... or 1, 2, 3 ...
    """
    numbers = [text for text in texts if text.isdecimal()]
    words = [text for text in texts if text and not text.isdecimal()]
    counted = [list(map(str, range(start, start + len(numbers)))) for start in (0, 1)]
    plain = not any(text[0].isdigit() or text[0] in "-+." for text in words)
    return len(numbers) > 1 and numbers in counted and plain and (len(words) > 0 or texts[0] == "")
