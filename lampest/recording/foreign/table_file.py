"""Measurements as text: one frame a line, or one value a line with its row and column; what is found is said."""

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lampest.files.errors import InputError
from lampest.panel.panel import Array

MOST_FIELDS = 10_000_000
LONGEST_LINE = 1_000_000
DELIMITERS = {";": "semicolon", "\t": "tab", ",": "comma", " ": "blank"}
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE | re.ASCII)
MEANINGS = {
    "row": {"row", "rows"},
    "column": {"column", "col", "columns", "cols"},
    "value": {"value", "resistance", "ohm", "volt", "voltage", "code", "r", "v"},
    "frame": {"frame", "scan", "step"},
}


@dataclass(frozen=True, eq=False)
class Frames:
    """Values of a file (frames, rows, columns), times in s or None, notes, and how the file names a value's place."""

    values: Array
    time: Array | None
    notes: tuple[str, ...]
    place: Callable[[int, int, int], str]


class _Line(NamedTuple):
    number: int
    fields: list[str]


def read_table(path: Path, shape: tuple[int, int]) -> Frames:
    """Frames from a text table with or without a header, its fields apart by comma, semicolon, tab or blanks.

    A line holds rows · columns values of one frame, row by row, with the time in s before them where there is one value
    more; or row, column and value, with a frame number where there are several frames. Indices count from 0 or 1.
    Raises InputError with file, line and column (the number of the field) where something does not fit.
    """
    text = _text(path)
    delimiter = _delimiter(text)
    lines = _lines(path, text, delimiter)
    if not lines:
        raise InputError(f"{path}: holds no values")
    comma = delimiter != "," and any("," in field for line in lines[:20] for field in line.fields)
    notes = [f"fields apart by {DELIMITERS[delimiter]}" + (", decimal commas" if comma else "")]
    names = None
    if not any(_is_number(field, comma) for field in lines[0].fields):
        names = [field.strip().lower() for field in lines[0].fields]
        notes.append(f"line {lines[0].number} taken as header")
        lines = lines[1:]
        if not lines:
            raise InputError(f"{path}: holds a header but no values")
        if len(lines[0].fields) != len(names):
            found = len(lines[0].fields)
            raise InputError(f"{path}:{lines[0].number}: {found} fields, where the header has {len(names)}")
    order = _long_order(names, len(lines[0].fields), shape[0] * shape[1])
    numbers = _numbers(path, lines, comma)
    if order is None:
        return _wide(path, lines, numbers, shape, notes)
    return _long(path, lines, numbers, shape, order, notes)


def _text(path: Path) -> str:
    data = path.read_bytes()
    if b"\0" in data:
        raise InputError(f"{path}: no text table (it holds zero bytes)")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: no text table (byte {error.start} is not UTF-8)") from error


def _delimiter(text: str) -> str:
    for line in text.splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return next((sign for sign in (";", "\t", ",") if sign in line), " ")
    return ","


def _lines(path: Path, text: str, delimiter: str) -> list[_Line]:
    """Lines that hold anything, without comments; their numbers as an editor shows them."""
    lines, count = [], 0
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if len(line) > LONGEST_LINE:
            raise InputError(f"{path}:{number}: longer than {LONGEST_LINE} characters, which no table is")
        fields = line.split() if delimiter == " " else next(_parsed(path, number, line, delimiter))
        count += len(fields)
        if count > MOST_FIELDS:
            raise InputError(f"{path}:{number}: more than {MOST_FIELDS} values are not imported")
        lines.append(_Line(number, fields))
    return lines


def _parsed(path: Path, number: int, line: str, delimiter: str) -> Iterator[list[str]]:
    try:
        yield from csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True)
    except csv.Error as error:
        raise InputError(f"{path}:{number}: {error}") from error


def _is_number(field: str, comma: bool) -> bool:
    return NUMBER.fullmatch((field.replace(",", ".") if comma else field).strip()) is not None


def _long_order(names: Sequence[str] | None, fields: int, cells: int) -> dict[str, int] | None:
    """Which field is row, column, value and frame in a table of single values; None for a table of frames."""
    if names is not None:
        order = {
            meaning: place
            for place, name in reversed(list(enumerate(names)))
            for meaning, words in MEANINGS.items()
            if re.split(r"[\s\[(_]", name)[0] in words
        }
        if {"row", "column", "value"} <= set(order):
            return order
        return None
    if fields in (cells, cells + 1) or fields not in (3, 4):
        return None
    return dict(zip(("row", "column", "value", "frame"), range(fields), strict=False))


def _numbers(path: Path, lines: Sequence[_Line], comma: bool) -> list[list[float]]:
    width, numbers = len(lines[0].fields), []
    for line in lines:
        if len(line.fields) != width:
            raise InputError(
                f"{path}:{line.number}: {len(line.fields)} fields, where line {lines[0].number} has {width}"
            )
        for place, field in enumerate(line.fields, 1):
            if not _is_number(field, comma):
                shown = field.strip()[:40]
                raise InputError(f"{path}:{line.number}:{place}: {shown!r} is no number (field {place} of the line)")
        numbers.append([float((field.replace(",", ".") if comma else field).strip()) for field in line.fields])
    return numbers


def _wide(
    path: Path, lines: Sequence[_Line], numbers: list[list[float]], shape: tuple[int, int], notes: list[str]
) -> Frames:
    cells, width = shape[0] * shape[1], len(lines[0].fields)
    if width not in (cells, cells + 1):
        raise InputError(
            f"{path}:{lines[0].number}: {width} fields; {shape[0]} × {shape[1]} cells need {cells}, {cells + 1} with "
            "the time, or 3 or 4 for row, column, value and frame"
        )
    offset, table = width - cells, np.array(numbers, dtype=float)
    time = table[:, 0] if offset else None
    if time is not None:
        bad = ~np.isfinite(time) | (np.diff(time, prepend=-np.inf) <= 0)
        if np.any(bad):
            line = lines[int(np.argmax(bad))]
            raise InputError(f"{path}:{line.number}:1: times must be finite and grow from line to line")
    notes.append("one frame a line, row by row" + (", first field is the time in s" if offset else ""))

    def place(frame: int, row: int, column: int) -> str:
        return f"{path}:{lines[frame].number}:{offset + row * shape[1] + column + 1}"

    return Frames(table[:, offset:].reshape(-1, *shape), time, tuple(notes), place)


def _long(
    path: Path,
    lines: Sequence[_Line],
    numbers: list[list[float]],
    shape: tuple[int, int],
    order: dict[str, int],
    notes: list[str],
) -> Frames:
    table = np.array(numbers, dtype=float)
    indices = {name: _whole(path, lines, table[:, order[name]], order[name]) for name in order if name != "value"}
    first = _first_index(path, lines, indices, shape, order)
    frame_numbers = np.unique(indices["frame"]) if "frame" in indices else np.zeros(1)
    frames = np.searchsorted(frame_numbers, indices["frame"]) if "frame" in indices else np.zeros(len(lines), dtype=int)
    if len(frame_numbers) * shape[0] * shape[1] > max(MOST_FIELDS, 2 * len(lines)):
        raise InputError(f"{path}: {len(frame_numbers)} frames of {shape[0]} × {shape[1]} cells are not imported")
    values = np.full((len(frame_numbers), *shape), np.nan)
    where = np.full(values.shape, -1)
    for number, line in enumerate(lines):
        index = int(frames[number]), int(indices["row"][number]) - first, int(indices["column"][number]) - first
        if where[index] >= 0:
            hint = "" if "frame" in order else "; several frames need a field with the frame's number"
            earlier = lines[where[index]].number
            raise InputError(f"{path}:{line.number}: the same cell as in line {earlier}{hint}")
        where[index], values[index] = number, table[number, order["value"]]
    if np.any(where < 0):
        frame, row, column = (int(part) for part in np.argwhere(where < 0)[0])
        which = f" of frame {frame_numbers[frame]:g}" if "frame" in order else ""
        raise InputError(f"{path}: row {row + first}, column {column + first}{which} is missing")
    said = ", ".join(sorted(order, key=order.__getitem__))
    notes.append(f"one value a line as {said}; indices count from {first}")

    def place(frame: int, row: int, column: int) -> str:
        return f"{path}:{lines[where[frame, row, column]].number}:{order['value'] + 1}"

    return Frames(values, None, tuple(notes), place)


def _whole(path: Path, lines: Sequence[_Line], values: Array, field: int) -> Array:
    bad = ~np.isfinite(values) | (values != np.round(values)) | (np.abs(values) > 1e9)
    if np.any(bad):
        at = int(np.argmax(bad))
        raise InputError(f"{path}:{lines[at].number}:{field + 1}: {values[at]:g} is no index")
    return values


def _first_index(
    path: Path, lines: Sequence[_Line], indices: dict[str, Array], shape: tuple[int, int], order: dict[str, int]
) -> int:
    """0 where any row or column has the number 0, else 1. Raises InputError for numbers beyond the panel."""
    first = 0 if min(indices["row"].min(), indices["column"].min()) <= 0 else 1
    for name, size in zip(("row", "column"), shape, strict=True):
        bad = (indices[name] < first) | (indices[name] >= first + size)
        if np.any(bad):
            at = int(np.argmax(bad))
            raise InputError(
                f"{path}:{lines[at].number}:{order[name] + 1}: {name} {indices[name][at]:g} is beyond the panel's "
                f"{first} to {first + size - 1}"
            )
    return first
