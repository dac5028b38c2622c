"""Layouts of panels in tables: which fields of a line hold the readings of which cells.

A layout is data, an `TableLayout`; `lampest.apps.foreign.division` divides the lines into frames.
"""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.apps.foreign.arrays import Shape
from lampest.apps.foreign.beside import described, with_one_clock
from lampest.apps.foreign.clocks import is_stamp
from lampest.apps.foreign.places import first_number, places_named, within_panel
from lampest.apps.foreign.table import ReadingsTable
from lampest.apps.foreign.words import COLUMN, MAX_CUT, ROW, cell_of, line_of, role_of
from lampest.files.errors import InputError, counted
from lampest.panel.panel import Array, Numbers

Cells = dict[int, tuple[int, int]]


@dataclass(frozen=True, eq=False)
class TableLayout:
    """Where the lines of a table hold readings, and what else they say.

    The reading of a field belongs to the cell (row, column) of the field, counted from the cell at
    which its line begins: position · (rows · columns) // lines. The position is the row or the
    cell that the line names, or else the number of the line within its frame.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the panel.
    lines : int
        Lines of a frame.
    cells : mapping
        Field → (row, column) of its reading.
    note : str
        Sentence on the layout.
    roles : mapping
        'row', 'column', 'cell' and 'frame' → field with the number or name of the line's.
    times : tuple of int
        Fields with the date and the time.
    first : int
        Number of the first row and column, 0 or 1.
    """

    shape: Shape
    lines: int
    cells: Cells
    note: str
    roles: Mapping[str, int] = dataclasses.field(default_factory=dict)
    times: tuple[int, ...] = ()
    first: int = 0

    @cached_property
    def places(self) -> tuple[Numbers, Numbers]:
        """Fields with readings, and the place of each behind the cell at which its line begins."""
        places = [row * self.shape[1] + column for row, column in self.cells.values()]
        return np.array([*self.cells], dtype=np.intp), np.array(places, dtype=np.intp)

    def positions(self, table: ReadingsTable) -> Numbers | None:
        """Return the position of each line, -1 where it is missing; None if lines name none."""
        if not {"row", "column", "cell"} & set(self.roles):
            return None
        places = places_named(table, self.roles, self.shape, self.first)
        within = np.asarray(np.all(within_panel(places, self.shape), axis=1))
        rows, columns = np.where(within[:, None], places, 0).T.astype(np.intp)
        cells = rows * self.shape[1] + columns
        return np.where(within, cells * self.lines // (self.shape[0] * self.shape[1]), -1)

    @property
    def used(self) -> frozenset[int]:
        """Fields that hold readings, or say anything of frames and times."""
        return frozenset((*self.cells, *self.roles.values(), *self.times))


def arranged(table: ReadingsTable, shape: Shape) -> tuple[ReadingsTable, TableLayout]:
    """Return a table's columns of use, and its layout by its header and the fields of its lines.

    Raises InputError if these do not determine the layout, or if the table does not fit the panel.
    """
    table = with_one_clock(table)
    cells = shape[0] * shape[1]
    # A program that prints a tab before each value leaves an empty first field.
    if (
        table.width not in (1, cells, shape[1])
        and not table.names[0]
        and np.all(table.fields[:, :2] == "", axis=0).tolist() == [True, False]
    ):
        note = "a separator before the first value of every line"
        return arranged(table.only(columns=slice(1, None)).with_notes(note), shape)
    # One value a line; else one frame a line; else one row a line; else again without empty
    # columns.
    order = _single_values(table, shape)
    if order is not None:
        return table, _values_in_lines(table, shape, order)
    table = described(table, shape)
    names = table.names
    if table.width == 1 and shape[1] > 1 and len(table.lines) >= cells:
        note = f"one number a line, {cells} lines a frame; row by row"
        return table, TableLayout(shape, cells, {0: (0, 0)}, note)
    named = _cells_by_name(table.source.source, names, shape) or _cells_by_number(names, shape)
    extra = sum(role_of(name) in ("time", "date", "frame", "row") for name in names)
    if names.count("") in (cells, shape[1]):  # the values of a list, beside named fields
        extra = table.width - names.count("")
    if named is not None or table.width in (cells, cells + 1, cells + extra):
        return table, _frames_in_lines(table, shape, named)
    if table.width in (shape[1], shape[1] + 1, shape[1] + extra):
        return table, _rows_in_lines(table, shape)
    filled = np.any(table.fields != "", axis=0)
    if not np.all(filled):
        empty = ", ".join(names[at] or f"field {at + 1}" for at in np.flatnonzero(~filled))
        note = f"empty columns left out: {empty}"
        return arranged(table.only(columns=filled).with_notes(note), shape)
    panels = table.width // cells
    several = f"they may be {panels} panels, which a scene with `modules` reads as one image; "
    raise InputError(
        f"{table.place(0, None)}: {counted(table.width, 'field')}; "
        f"{several if panels > 1 and table.width - panels * cells <= extra else ''}"
        f"{shape[0]} × {shape[1]} cells need {cells}, {cells + 1} with the time, "
        f"or 3 or 4 for row, column, value and frame, or {shape[1]} in a line for each row; "
        "`layout` says what each field is"
    )


def _cells_by_name(source: str, names: Sequence[str], shape: Shape) -> tuple[Cells, str] | None:
    """Return (row, column) of the cells in the names of columns, by column, and a sentence.

    The result is None without such names.
    """
    named = {field: cell_of(name) for field, name in enumerate(names) if not role_of(name)}
    places = {field: cell for field, cell in named.items() if cell is not None}
    if not places:
        return None
    first = min(1, *map(min, places.values()))
    fields: dict[tuple[int, int], int] = {}
    for field, (row, column) in places.items():
        same = fields.setdefault((row - first, column - first), field)
        if same != field:
            headers = f"{names[same]!r} and {names[field]!r}"
            raise InputError(f"{source}: the header's {headers} are the same cell")
        if row - first >= shape[0] or column - first >= shape[1]:
            sizes = f"{shape[0]} × {shape[1]} cells, counted from {first}"
            raise InputError(
                f"{source}: the header's {names[field]!r} is beyond the panel of {sizes}"
            )
    cells = {field: cell for cell, field in fields.items()}
    row, column = next(iter(fields))
    example = f"{names[next(iter(cells))]!r} is row {row}, column {column}"
    unnamed = shape[0] * shape[1] - len(cells)
    gap = f"; {counted(unnamed, 'cell')} without a column, missing" if unnamed else ""
    order = ", row by row" if list(fields) == sorted(fields) else ""
    return cells, f"cells by their names{order}, which count from {first} ({example}){gap}"


def _cells_by_number(names: Sequence[str], shape: Shape) -> tuple[Cells, str] | None:
    """Return the cells of columns named by one word and the numbers of all cells, or None.

    A sentence is returned with the cells.
    """
    named = {field: line_of(name) for field, name in enumerate(names) if not role_of(name)}
    lines = {field: line for field, line in named.items() if line is not None}
    first = min((number for _, number in lines.values()), default=0)
    one_word = len({word for word, _ in lines.values()}) == 1
    for way, base, firsts in (
        ("row by row", shape[1], (0, 1)),
        ("a digit for the row and one for the column", 10, (0, 11)),
    ):
        cells = {field: divmod(number - first, base) for field, (_, number) in lines.items()}
        if one_word and first in firsts and sorted(cells.values()) == list(np.ndindex(shape)):
            return cells, f"cells by their numbers from {first}, {way}"
    return None


def _frames_in_lines(
    table: ReadingsTable, shape: Shape, named: tuple[Cells, str] | None
) -> TableLayout:
    """Return the layout of a table with one frame a line.

    `named` contains the cells by column, and a sentence. None: cells row by row in the order of the
    fields.
    """
    names = table.names
    roles = [role_of(name) for name in names]
    times = [at for at, role in enumerate(roles) if role in ("date", "time")]
    if named is None:
        cells = shape[0] * shape[1]
        values = [at for at, role in enumerate(roles) if role not in ("date", "time", "frame")]
        values = (values if len(values) >= cells else list(range(table.width)))[-cells:]
        unnamed = not times and values[0] == 1 and roles[0] != "frame"
        # One field more than cells, of numbers or stamps and not of names of boards alone; where a
        # header leaves it without a name it is a counter.
        texts = table.fields[table.words[:, 0], 0]
        timed = len(texts) < len(table.lines) or any(map(is_stamp, texts))
        if unnamed and (names[0] or not any(names)) and timed:
            times = [0]
        unknown = (
            f"; {names[values[0]]!r} and the other names tell no cells"
            if any(names[at] for at in values)
            else ""
        )
        named = dict(zip(values, np.ndindex(shape), strict=True)), f"cells row by row{unknown}"
    places, how = named
    unused = [
        name or "a column without a name"
        for at, name in enumerate(names)
        if at not in places and at not in times
    ]
    omitted = f"; left out: {', '.join(unused[:5])}" if unused else ""
    frame = {"frame": roles.index("frame")} if "frame" in roles else {}
    note = f"one frame a line, {how}{omitted}"
    return TableLayout(shape, 1, places, note, frame, tuple(times))


def _single_values(table: ReadingsTable, shape: Shape) -> dict[str, int] | None:
    """Return the fields of a table of single values by role, or None.

    The roles are row, column, cell, value, frame, time, date.
    """
    cells = shape[0] * shape[1]
    if any(table.names):
        roles = [role_of(name) for name in table.names]
        short = [name.strip().lower() for name in table.names]
        if {"r", "c"} <= set(short):  # beside a c, an r is no resistance
            roles[short.index("r")] = "row"
            roles[short.index("c")] = "column"
        order = {role: roles.index(role) for role in reversed(roles) if role is not None}
        has_place = {"row", "column"} <= set(order) or "cell" in order
        return order if "value" in order and has_place else None
    if table.width not in (2, 3, 4) or table.width in (cells, cells + 1):
        return None
    places = _places_by_values(table, shape)
    if places is None and table.width not in (2, shape[1], shape[1] + 1):
        places = dict(zip(("row", "column", "value", "frame"), range(table.width), strict=False))
    return places


def _places_by_values(table: ReadingsTable, shape: Shape) -> dict[str, int] | None:
    """Return the fields of row and column, or cell, of value and counter by role, or None.

    Two neighbouring fields take the numbers of rows and of columns alone, in either order, or one
    field counts the cells. The value stands behind them; the counter of frames or the time stands
    before them, or behind the value.
    """
    cells = shape[0] * shape[1]
    before = table.width - 3
    pairs = ((before, before + 1), (before + 1, before), (0, 1), (1, 0))
    options = [{"row": row, "column": column} for row, column in pairs if table.width > 2]
    if shape[1] > 1:
        options += [{"cell": field} for field in (table.width - 2, 0)]
    for roles in options:
        places = places_named(table, roles, shape, first_number(table, roles, shape))
        within = within_panel(places, shape).all(axis=1)
        named = places[within]
        steps = np.diff(named @ np.array([shape[1], 1]))
        kinds = [len(np.unique(numbers)) for numbers in named.T]
        if "cell" in roles:
            clear = len(np.unique(named, axis=0)) == cells and np.median(np.abs(steps)) == 1
        else:
            clear = len(named) == 1 or np.all((np.array(kinds) > 1) | (np.array(shape) == 1))
        if np.mean(within) < 1 - MAX_CUT or not clear:
            continue
        value = max(roles.values()) + 1
        counters = [at for at in range(table.width) if at not in (*roles.values(), value)]
        of_counters = {_counter_role(table.line_numbers(at)): at for at in counters}
        return roles | {"value": value} | of_counters
    return None


def _counter_role(numbers: Array) -> str:
    """Return 'frame' for numbers, (lines,), that count by one, otherwise 'time'."""
    distinct = np.unique(numbers[np.isfinite(numbers)])
    whole = len(distinct) and np.all(distinct == np.round(distinct))
    return (
        "frame" if whole and np.median(np.diff(distinct, prepend=distinct[:1] - 1)) == 1 else "time"
    )


def _values_in_lines(table: ReadingsTable, shape: Shape, order: dict[str, int]) -> TableLayout:
    """Return the layout of a table of single values, with the fields `order` by role.

    Raises InputError if more than a few lines name no cell of the panel, or if they may count from
    0 or from 1.
    """
    if {"row", "column"} <= set(order):
        order = {role: at for role, at in order.items() if role != "cell"}
    listed = ", ".join(sorted(order, key=order.__getitem__))
    roles = {role: at for role, at in order.items() if role in ("row", "column", "cell", "frame")}
    first = first_number(table, roles, shape)
    places = places_named(table, roles, shape, first)
    strange = ~within_panel(places, shape)
    for axis, axis_name in enumerate(("row", "column")):
        role = "cell" if "cell" in roles else axis_name
        field = roles[role]
        bad = strange[:, axis] & (table.fields[:, field] != "")
        if bad.sum() > MAX_CUT * len(bad):
            beyond = f"{axis_name} {{0}} is beyond the panel's {first} to {first + shape[axis] - 1}"
            if role == "cell":
                beyond = f"cell {{0}} is beyond the panel of {shape[0]} × {shape[1]} cells"
            number = places[np.argmax(bad), axis]
            table.refuse(bad, field, beyond if number == np.round(number) else "{0} is no index")
    if np.array_equal(strange, ~within_panel(places_named(table, roles, shape, 1 - first), shape)):
        names = "cells" if "cell" in roles else "rows and columns"
        raise InputError(
            f"{table.place(0, None)}: {names} may count from 0 or from 1: "
            "no line names the first or the last"
        )
    times = tuple(order[role] for role in ("date", "time") if role in order)
    note = f"one value a line as {listed}; indices count from {first}"
    cells = {order["value"]: (0, 0)}
    return TableLayout(shape, shape[0] * shape[1], cells, note, roles, times, first)


def _rows_in_lines(table: ReadingsTable, shape: Shape) -> TableLayout:
    """Return the layout of a table with one row of the panel a line.

    Further fields before it are the row's name, the frame's number or the time.
    """
    extra = table.width - shape[1]
    given = [role_of(name) for name in table.names[:extra]]
    times = [at for at, role in enumerate(given) if role in ("time", "date")]
    roles = {"frame": given.index("frame")} if "frame" in given else {}
    others = [at for at, role in enumerate(given) if role not in ("time", "date", "frame")]
    others = [at for at in others if given[at] == "row"] or others
    first = 0
    if others:
        labelled = others[-1]
        numbers = table.line_numbers(labelled)
        if not any(table.names) and np.nanmax(numbers, initial=0.0) > shape[0]:
            times = [labelled]
        else:
            # More than a few texts that name no row of the panel, or a column, are refused.
            roles["row"] = labelled
            texts = table.fields[:, labelled]
            first = first_number(table, {"row": labelled}, shape)
            named_rows = places_named(table, {"row": labelled}, shape, first)
            bad = np.asarray(np.any(~within_panel(named_rows, shape), axis=1))
            if np.sum(bad & (texts != "")) > MAX_CUT * len(bad):
                table.refuse(bad, labelled, f"{{0!r}} is none of the panel's {shape[0]} rows")
            lines = map(line_of, texts)
            columns = np.array([bool(line and re.fullmatch(COLUMN, line[0])) for line in lines])
            table.refuse(columns, labelled, "{0!r} names a column; `transpose` swaps the two")
    # Columns are in the order of the numbers in their names, or of the fields.
    names = table.names[extra:]
    named_columns = list(filter(None, map(line_of, names)))
    begin = min((number for _, number in named_columns), default=0)
    places = [number - begin for _, number in named_columns]
    order = f"columns by their names from {begin}"
    if begin > 1 or sorted(places) != list(range(shape[1])) or len(names) != shape[1]:
        places = list(range(shape[1]))
        order = "columns from left to right"
    elif any(re.fullmatch(ROW, word) for word, _ in named_columns):
        raise InputError(
            f"{table.source.source}: the header's {names[0]!r} names a row; `transpose` swaps"
        )
    cells = {extra + at: (0, column) for at, column in enumerate(places)}
    named = "rows by their names" if "row" in roles else "rows from top to bottom"
    note = f"one row a line, {shape[0]} lines a frame; {named}, {order}"
    return TableLayout(shape, shape[0], cells, note, roles, tuple(times), first)
