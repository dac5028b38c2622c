"""Additional fields in a line of readings.

Such fields are clocks of several columns, numbers of frames and rows, and constant marks.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lampest.apps.foreign.arrays import Shape
from lampest.apps.foreign.table import ReadingsTable
from lampest.apps.foreign.words import PART_OF_CLOCK, grows, is_stamp, line_of, parted, unwrapped
from lampest.panel.panel import Array

MAX_BESIDE = 8  # fields beside the readings of a line that names none
MIN_LINES = 3  # a field is a mark only if it is the same in as many lines
SKIPPED = "-"
CLOCK = ("hour", "minute", "second")
DATE = ("year", "month", "day")


def with_one_clock(table: ReadingsTable) -> ReadingsTable:
    """Return the table with one column for its clock, and one for a date's parts.

    The clock is the hour, minute and second that the table names.
    """
    words = [parted(name)[0] for name in table.names]
    parts = [PART_OF_CLOCK.get(word) or (word if word in DATE else None) for word in words]
    if all(part in parts for part in DATE):
        fields = [parts.index(part) for part in DATE]
        year, month, day = table.values[:, fields].T
        dates = [
            _written("{:04.0f}-{:02.0f}-{:02.0f}", *date)
            for date in zip(year, month, day, strict=True)
        ]
        return with_one_clock(_joined(table, fields, dates, "date"))
    if not all(part in parts for part in CLOCK):
        return table
    fields = [parts.index(part) for part in CLOCK]
    after = fields[-1] + 1
    thousandths = after if parts[after : after + 1] == ["millisecond"] else None
    texts = _clock_texts(table, fields, thousandths)
    return _joined(table, fields if thousandths is None else [*fields, after], texts, "time")


def _clock_texts(
    table: ReadingsTable, fields: Sequence[int], thousandths: int | None = None
) -> list[str]:
    """Return the times of lines by fields of hour, minute, second and, if any, thousandths."""
    hour, minute, second = table.values[:, fields].T
    second = second if thousandths is None else second + table.values[:, thousandths] / 1000
    return [
        _written("{:02.0f}:{:02.0f}:{:09.6f}", *part)
        for part in zip(hour, minute, second, strict=True)
    ]


def _written(form: str, *parts: float) -> str:
    return form.format(*parts) if np.all(np.isfinite(parts)) else ""


def _joined(
    table: ReadingsTable, fields: Sequence[int], texts: Sequence[str], name: str
) -> ReadingsTable:
    """Return the table with texts in the first of the fields, and without the others."""
    first = fields[0]
    columns = [field for field in range(table.width) if field not in fields[1:]]
    joined = table.fields.copy()
    values = table.values.copy()
    joined[:, first] = texts
    values[:, first] = np.nan
    names = list(table.names)
    names[first] = name
    parts = ", ".join(table.names[field] or f"field {field + 1}" for field in fields)
    notes = (*table.notes, f"{parts} are one {name}")
    return replace(table, fields=joined, values=values, names=tuple(names), notes=notes).only(
        columns=columns
    )


def described(table: ReadingsTable, shape: Shape) -> ReadingsTable:
    """Return a table without a header with names for the additional fields, and without marks.

    The additional fields stand before or after the readings: a clock, a time, a frame's number, or
    marks, which are equal in every line. A row's number always stands before the readings. Where
    the fields cannot be distinguished, and where there is a single leading one, the table is
    returned unchanged.
    """
    # Or it would with rows and columns exchanged.
    fits = table.width in (shape[0] * shape[1], *shape)
    if any(table.names) or len(table.lines) < MIN_LINES or fits:
        return table
    marks = np.array([np.all(column == column[0]) and column[0] != "" for column in table.fields.T])
    for needed, rows in ((shape[0] * shape[1], 1), (shape[1], shape[0])):
        extra = table.width - needed
        if not 1 <= extra <= MAX_BESIDE:
            continue
        for trailing in range(extra + 1):
            lead = range(extra - trailing)
            end = range(table.width - trailing, table.width)
            names = _names_beside(table, [*lead, *end], len(lead), rows, marks)
            if names is None:
                continue
            alone = len(names) == 1 and names != [SKIPPED] and not trailing
            return table if alone else _named(table, names, len(lead))
        if extra == 1:
            return table
    return table


def _named(table: ReadingsTable, names: Sequence[str], lead: int) -> ReadingsTable:
    """Return the table with its named fields first, and without those called '-'.

    The first `lead` of the named fields already stand before the readings.
    """
    trailing = len(names) - lead
    order = [
        *range(lead),
        *range(table.width - trailing, table.width),
        *range(lead, table.width - trailing),
    ]
    named = [f"field {order[at] + 1} {name}" for at, name in enumerate(names) if name != SKIPPED]
    marks = [f"field {order[at] + 1}" for at, name in enumerate(names) if name == SKIPPED]
    notes = list[str]()
    if named:
        notes.append(f"no header: {', '.join(named)}; `layout` says otherwise")
    if marks:
        notes.append(f"{', '.join(marks)} left out: beside the readings, and no time")
    every = (*names, *[""] * (table.width - len(names)))
    table = replace(table.only(columns=order), names=every, notes=(*table.notes, *notes))
    clock = [field for field, name in enumerate(names) if name in CLOCK]
    if clock:
        table = _joined(table, clock, _clock_texts(table, clock), "time")
    return table.only(columns=[field for field, name in enumerate(table.names) if name != SKIPPED])


def _names_beside(
    table: ReadingsTable, fields: Sequence[int], lead: int, rows: int, marks: NDArray[np.bool_]
) -> list[str] | None:
    """Return names of the additional fields; None if one is unclear.

    The first `lead` of them stand before the readings.
    """
    leading = [_is_row(table.fields[:, field], rows) for field in fields[:lead]] if rows > 1 else []
    names: list[str | None] = [
        "row"
        if at < len(leading) and leading[at]
        else _name_of(table, field, rows, mark=bool(marks[field]))
        for at, field in enumerate(fields)
    ]
    for at in range(lead - 2):
        if _is_clock(table.values[:, fields[at : at + 3]]):
            names[at : at + 3] = CLOCK
            break
    if None in names:
        return None
    only_mark_leads = lead == 1 and names[0] == SKIPPED
    rows_are_clear = lead == 0 or only_mark_leads or "row" in names
    if rows > 1 and len(fields) > 1 and not rows_are_clear:
        return None
    complete = [name or SKIPPED for name in names]
    # A file has one clock: that of hour, minute and second, or its first time.
    if "hour" in complete:
        return [SKIPPED if name == "time" else name for name in complete]
    first = complete.index("time") if "time" in complete else len(complete)
    return [SKIPPED if name == "time" and at > first else name for at, name in enumerate(complete)]


def _name_of(table: ReadingsTable, field: int, rows: int, *, mark: bool) -> str | None:
    """Return the role of an additional field: 'time', 'frame', or '-' for a mark; else None."""
    texts = table.fields[:, field]
    values = unwrapped(table.values[:, field])
    words = table.words[:, field]
    if all(is_stamp(text) for text in set(texts[words])) and words.all():
        return "time"
    if mark:
        return SKIPPED
    with np.errstate(invalid="ignore"):  # of two infinite numbers: no step that grows
        steps = np.diff(values)
    if rows > 1 and np.all(steps >= 0):
        return "frame" if set(steps) <= {0.0, 1.0} and not np.all(steps == 1) else "time"
    if grows(values):
        return "frame" if np.all(steps == 1) else "time"
    return SKIPPED if np.all(steps >= 0) else None


def _is_row(texts: NDArray[np.object_], rows: int) -> bool:
    """Return whether texts count the rows of every frame, from 0 or 1.

    The texts are numbers, or names such as R3.
    """
    numbers = np.array([(line_of(text) or ("", -1))[1] for text in texts])
    first = int(numbers.min())
    follows = (np.diff(numbers) == 1) | (numbers[1:] < numbers[:-1])
    return first in (0, 1) and int(numbers.max()) - first == rows - 1 and bool(np.all(follows))


def _is_clock(values: Array) -> bool:
    """Return whether three columns are hour, minute and second that do not run backwards."""
    hour, minute, second = values.T
    whole = np.all(values[:, :2] == np.round(values[:, :2]))
    within = np.all((values >= 0) & (values < [24, 60, 61]))
    total = 3600 * hour + 60 * minute + second
    return bool(whole and within and np.all(np.diff(total) >= 0) and total[-1] > total[0])
