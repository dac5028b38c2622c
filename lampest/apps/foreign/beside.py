"""Additional fields in a line of readings.

Such fields are clocks of several columns, numbers of frames and rows, and constant marks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lampest.apps.foreign.arrays import Shape
from lampest.apps.foreign.clocks import EPOCH as LEAST_EPOCH
from lampest.apps.foreign.clocks import grows, is_stamp, unwrapped
from lampest.apps.foreign.places import first_number, places_named, within_panel
from lampest.apps.foreign.table import ReadingsTable
from lampest.apps.foreign.words import MAX_CUT, PART_OF_CLOCK, parted
from lampest.panel.panel import Array, Mask

MAX_BESIDE = 8  # fields beside the readings of a line that names none
MIN_WRAP = 0.9  # of a counter's range that its number falls by where it wraps
MIN_LINES = 3  # a field is a mark only if it is the same in as many lines
SKIPPED = "-"
CLOCK = ("hour", "minute", "second")
EPOCH = ("epoch", "nanosecond")  # of ROS
PART_OF_EPOCH = {
    "sec": "epoch",
    "secs": "epoch",
    "nsec": "nanosecond",
    "nsecs": "nanosecond",
    "nanosec": "nanosecond",
    "nanosecs": "nanosecond",
}
DATE = ("year", "month", "day")


def with_one_clock(table: ReadingsTable) -> ReadingsTable:
    """Return the table with the columns of a clock's parts as one time.

    The parts are the year, month and day, the hour, minute and second, or the seconds since 1970
    and nanoseconds, that the table names.
    """
    words = [parted(name)[0] for name in table.names]
    of_epoch = [PART_OF_EPOCH.get(word.rpartition("_")[2]) for word in words]
    of_clock = [PART_OF_CLOCK.get(word) for word in words]
    # Seconds beside nanoseconds are those since 1970.
    first, second = (of_epoch, of_clock) if "nanosecond" in of_epoch else (of_clock, of_epoch)
    parts = [one or other or word for one, other, word in zip(first, second, words, strict=True)]
    for needed in (DATE, CLOCK, EPOCH):
        if not {*needed} <= {*parts}:
            continue
        fields = [parts.index(part) for part in needed]
        after = fields[-1] + 1
        if needed == CLOCK and parts[after : after + 1] == ["millisecond"]:
            fields.append(after)
        table = _clocked(table, {parts[at]: at for at in fields})
        parts = [part for at, part in enumerate(parts) if at not in fields]
    return table


def _clocked(table: ReadingsTable, fields: Mapping[str, int]) -> ReadingsTable:
    """Return the table without the fields of a clock's parts, which are its clock."""
    clock = {part: int(table.columns[at]) for part, at in fields.items()}
    others = [at for at in range(table.width) if at not in fields.values()]
    parts = ", ".join(table.names[at] or f"field {at + 1}" for at in fields.values())
    whole = "date" if "year" in fields else "time"
    clocked = replace(table.only(columns=others), clock={**table.clock, **clock})
    return clocked.with_notes(f"{parts} are one {whole}")


def described(table: ReadingsTable, shape: Shape) -> ReadingsTable:
    """Return a table without a header with names for the additional fields, and without marks.

    The additional fields stand before or after the readings: a clock, a time, a frame's number, or
    marks, which are equal in every line. A row's number always stands before the readings. Where
    the fields cannot be distinguished, and where there is a single leading one, the table is
    returned unchanged.
    """
    same = np.append(False, np.all(table.fields[1:] == table.fields[:-1], axis=1))
    clear = table.only(~same & np.any(table.fields != "", axis=1))  # not doubled, nor damaged
    numbers = not np.any(clear.words)
    cells = shape[0] * shape[1]
    fits = numbers and table.width in (cells, shape[1])
    # It would fit with rows and columns exchanged, unless a field counts the rows.
    turned = numbers and table.width == shape[0]
    if any(table.names) or len(table.lines) < MIN_LINES or fits:
        return table
    marks = np.array([np.all(column == column[0]) and column[0] != "" for column in clear.fields.T])
    for needed, rows in ((cells, 1), (shape[1], shape[0])):
        extra = table.width - needed
        if not 1 <= extra <= MAX_BESIDE:
            continue
        for lead in range(extra, -1, -1):
            fields = [*range(lead), *range(needed + lead, table.width)]
            names = _names_beside(clear, fields, lead, rows, marks)
            if names is None or (turned and "row" not in names):
                continue
            alone = names == ["row"] or (len(names) == 1 and rows == 1 and names != [SKIPPED])
            return table if alone and lead == extra else _named(table, names, fields)
        if extra == 1:
            return table
    return table


def _named(table: ReadingsTable, names: Sequence[str], fields: Sequence[int]) -> ReadingsTable:
    """Return the table with its named fields first, and without those called '-'."""
    others = [at for at in range(table.width) if at not in fields]
    titles = [f"field {at + 1}" for at in fields]
    pairs = list(zip(titles, names, strict=True))
    named = [f"{title} {name}" for title, name in pairs if name != SKIPPED]
    marks = [title for title, name in pairs if name == SKIPPED]
    notes = list[str]()
    if named:
        notes.append(f"no header: {', '.join(named)}; `layout` says otherwise")
    if marks:
        notes.append(f"{', '.join(marks)} left out: beside the readings, and no time")
    table = replace(
        table.only(columns=[*fields, *others]), names=(*names, *[""] * len(others))
    ).with_notes(*notes)
    parts = {name: at for at, name in enumerate(names) if name in (*CLOCK, *EPOCH)}
    if parts:
        table = _clocked(table, parts)
    return table.only(columns=[name != SKIPPED for name in table.names])


def _names_beside(
    table: ReadingsTable, fields: Sequence[int], lead: int, rows: int, marks: Mask
) -> list[str] | None:
    """Return names of the additional fields; None if one is unclear.

    The first `lead` of them stand before the readings.
    """
    names = [
        "row"
        if rows > 1 and at < lead and _is_row(table, field, rows)
        else _name_of(table, field, rows, mark=bool(marks[field]))
        for at, field in enumerate(fields)
    ]
    for at in range(lead - 1):
        if _is_clock(table.values[:, fields[:lead][at : at + 3]]):
            names[at : at + 3] = CLOCK
            break
        if _is_epoch(table.values[:, fields[:lead][at : at + 2]]):
            names[at : at + 2] = EPOCH
            break
    if None in names:
        return None
    only_mark_leads = lead == 1 and names[0] == SKIPPED
    rows_are_clear = lead == 0 or only_mark_leads or "row" in names
    if rows > 1 and len(fields) > 1 and not rows_are_clear:
        return None
    complete = [name or SKIPPED for name in names]
    # A file has one clock: that of hour, minute and second, or its first time.
    first = complete.index("time") if "time" in complete else -1
    if "hour" in complete or "epoch" in complete:
        first = -1
    return [SKIPPED if name == "time" and at != first else name for at, name in enumerate(complete)]


def _name_of(table: ReadingsTable, field: int, rows: int, *, mark: bool) -> str | None:
    """Return the role of an additional field: 'time', 'frame', or '-' for a mark; else None."""
    words = table.words[:, field]
    if words.all() and all(map(is_stamp, set(table.fields[:, field]))):
        return "time"
    if mark:
        return SKIPPED
    values = _counting(unwrapped(table.line_numbers(field)))
    with np.errstate(invalid="ignore"):  # of two infinite numbers: no step that grows
        steps = np.diff(values)
    rising = np.mean(steps >= 0) >= 1 - MAX_CUT  # but for lines that are lost or swapped
    counts = np.mean((steps == 0) | (steps == 1)) >= 1 - MAX_CUT
    if rows > 1 and rising:
        return "frame" if counts and np.any(steps == 0) else "time"
    if grows(values):
        return "frame" if counts else "time"
    return SKIPPED if np.all(steps >= 0) else None


def _counting(values: Array) -> Array:
    """Return whole numbers that go on where a frame's number wraps, such as from 255 to 0."""
    with np.errstate(invalid="ignore"):  # of two infinite numbers
        falls = np.diff(values) < 0
    if not np.any(falls) or not np.all(np.isfinite(values) & (values == np.round(values))):
        return values
    size = float(values.max()) + 1
    wraps = values[:-1] - values[1:] >= MIN_WRAP * size
    return values + size * np.cumsum(np.append(0, wraps))


def _is_row(table: ReadingsTable, field: int, rows: int) -> bool:
    """Return whether a field counts the rows of every frame, from 0 or 1: 3, R3 or 'row 3'."""
    role = {"row": field}
    shape = (rows, 1)
    places = places_named(table, role, shape, first_number(table, role, shape))
    numbers = places[within_panel(places, shape)[:, 0], 0]
    steps = np.diff(numbers)
    follows = np.mean((steps == 1) | (steps < 0)) >= 1 - MAX_CUT if len(steps) else False
    named = len(numbers) >= (1 - MAX_CUT) * len(places)
    return bool(follows and named and len(np.unique(numbers)) == rows)


def _is_clock(values: Array) -> bool:
    """Return whether three columns are hour, minute and second that do not run backwards."""
    if values.shape[1] != 3:
        return False
    hour, minute, second = values.T
    whole = np.all(values[:, :2] == np.round(values[:, :2]))
    within = np.all((values >= 0) & (values < [24, 60, 61]))
    total = 3600 * hour + 60 * minute + second
    return bool(whole and within and np.all(np.diff(total) >= 0) and total[-1] > total[0])


def _is_epoch(values: Array) -> bool:
    """Return whether two columns are seconds since 1970 and nanoseconds."""
    seconds, nanoseconds = values.T
    whole = np.all(np.isfinite(values) & (values == np.round(values)))
    since = whole and np.all(np.diff(seconds) >= 0) and seconds[0] >= LEAST_EPOCH
    within = np.all((nanoseconds >= 0) & (nanoseconds < 1e9))
    return bool(since and within and np.ptp(nanoseconds) > 0)
