"""Records of foreign files: JSON, JSON lines, Parquet and Feather, as arrays or as a table."""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from lampest.apps.foreign.arrays import Arrays, check_count, reading
from lampest.apps.foreign.lines import FieldLine, FieldLines, field_lines
from lampest.apps.foreign.notation import flat_names
from lampest.apps.foreign.segments import alternate, few_values, several_sources, unused_note
from lampest.apps.foreign.words import role_of
from lampest.files.errors import InputError, extra

MAX_TEXT = 100_000_000  # bytes of JSON: its values take ten times as much memory
INDEX = "__index_level_0__"  # pandas' name of a row's number in Parquet

Content = tuple[Any, tuple[str, ...]]  # a file's content, and notes on it


def records_of(path: Path) -> tuple[Arrays | FieldLines, tuple[str, ...]]:
    """Return the content of a file of records.

    Records of single values are the lines of a table.

    Raises InputError if the file is damaged or too large, or if its lists have different lengths.

    Returns
    -------
    content : dict of arrays by name, or FieldLines
    notes : tuple of str
        Remarks of the reader for the user.
    """
    content, notes = READERS[path.suffix.lower()](path)
    records = content if isinstance(content, list) else [content]
    if not records or not all(isinstance(record, dict) for record in records):
        return _arrays(path, {"": content}), notes
    held = _short_names([part for record in records for part in _parts(record)])
    if len(held) == 1 and not isinstance(content, list):
        return _arrays(path, held[0]), notes
    if all(_is_value(value) for record in held for value in record.values()):
        fields = list(dict.fromkeys(name for record in held for name in record))

        def at(number: int, field: int | None) -> str:
            return f"{path}: record {number}" + ("" if field is None else f", {fields[field]!r}")

        lines = [FieldLine(0, ["" if name == INDEX else name for name in fields])]
        lines += [
            FieldLine(n, [text_of_value(record.get(name)) for name in fields])
            for n, record in enumerate(held, 1)
        ]
        return field_lines(str(path), "record", at, [f"{len(held)} records"], lines), notes
    names = dict.fromkeys(name for record in held for name in record)
    columns = {name: [record.get(name) for record in held] for name in names}
    for name, values in columns.items():
        texts = [text_of_value(value) for value in values if _is_value(value)]
        few = few_values(texts) if role_of(name) is None and len(texts) == len(values) else []
        if few and alternate(texts):
            raise InputError(f"{path}: {several_sources(name, few)}")
        notes = (*notes, unused_note(name, few)) if few else notes
    return _arrays(path, columns), notes


def _parts(record: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the records within a record, with its own values in each; itself if it has none."""
    values = dict(flat_names(record))
    within = [
        name
        for name, value in values.items()
        if isinstance(value, list) and value and all(isinstance(part, dict) for part in value)
    ]
    if not within:
        yield values
        return
    longest = max(within, key=lambda name: len(values[name]))
    own = {name: value for name, value in values.items() if _is_value(value)}
    for part in values[longest]:
        yield from _parts(own | {f"{longest}.{name}": value for name, value in part.items()})


def _short_names(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return records with the last words of their names, where these are different."""
    names = dict.fromkeys(name for record in records for name in record)
    last = Counter(name.rpartition(".")[2] for name in names)
    short = {
        name: name.rpartition(".")[2] if last[name.rpartition(".")[2]] == 1 else name
        for name in names
    }
    return [{short[name]: value for name, value in record.items()} for record in records]


def _is_value(value: Any) -> bool:
    return value is None or isinstance(value, str | int | float | datetime)


def _arrays(path: Path, values: dict[str, Any]) -> Arrays:
    """Return lists of numbers as arrays, and lists of dates as seconds since 1970.

    Other parts are left out.
    """
    arrays = Arrays()
    for name, value in values.items():
        where = f"{path}: {name}" if name else str(path)
        if isinstance(value, list) and any(
            isinstance(part, list) or hasattr(part, "shape") for part in value
        ):
            arrays[name] = _numbers(value, where)
        elif isinstance(value, list) and all(
            isinstance(part, int | float | None) for part in value
        ):
            arrays[name] = np.array(value, dtype=float)
        elif (
            role_of(name) == "time"
            and isinstance(value, list)
            and all(_is_value(part) for part in value)
        ):
            with reading(path):
                arrays[name] = np.array([_seconds(part) for part in value])
    return arrays


def _numbers(value: list[Any], where: str) -> Any:
    """Return nested lists as an array; null is a missing reading.

    Raises InputError with the place of a fault.
    """
    lengths = [len(part) if hasattr(part, "__len__") else 0 for part in value]
    if len(set(lengths)) > 1:
        usual = max(lengths, key=lengths.count)
        odd = next(number for number, length in enumerate(lengths) if length != usual)
        raise InputError(f"{where}[{odd}]: {lengths[odd]} values, where others have {usual}")
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{where}: its lists differ in length, or hold what is no number"
        ) from error
    check_count(where, array.size)
    return array


def _seconds(value: Any) -> float:
    """Return a date as seconds since 1970, in UTC without a zone."""
    if value is None:
        return nan
    date = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def text_of_value(value: Any) -> str:
    """Return a value as the text of a text file, with all digits of a number."""
    if value is None:
        return ""
    if isinstance(value, datetime):
        return value.isoformat()
    return (
        repr(float(value)).removesuffix(".0")
        if isinstance(value, int | float | np.number)
        else str(value)
    )


def _of_json(path: Path) -> Content:
    """Return the value of a JSON file, or its lines of one value each, and notes."""
    text = _text_of(path)
    with reading(path):
        try:
            return json.loads(text), ()
        except ValueError as error:
            if "Extra data" not in str(error) or "\n" not in text.strip():
                raise
    return _of_json_lines(path)  # one value a line under the name of one value


def _of_json_lines(path: Path) -> Content:
    """Return one value for each line; a last line that is cut is left out, and named in a note."""
    lines = [
        (number, line) for number, line in enumerate(_text_of(path).splitlines(), 1) if line.strip()
    ]
    values = []
    notes: tuple[str, ...] = ()
    for number, line in lines:
        try:
            values.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            if number != lines[-1][0] or not values:
                raise InputError(
                    f"{path}:{number}: no JSON ({' '.join(str(error).split())})"
                ) from error
            notes = (f"left out: line {number}, the last one, which is cut off",)
    return values, notes


def _text_of(path: Path) -> str:
    """Return the text of a file. Raises InputError for more than MAX_TEXT bytes."""
    size = path.stat().st_size
    if size > MAX_TEXT:
        raise InputError(
            f"{path}: {size} bytes, more than {MAX_TEXT} of JSON are not imported; save it as .npy"
        )
    with reading(path):
        return path.read_text(encoding="utf-8-sig")


def _of_arrow(path: Path) -> Content:
    """Return the rows of a Parquet or Feather file, and notes."""
    with extra("export"):
        from pyarrow import feather, parquet
    with reading(path):
        if path.suffix.lower() == ".feather":
            return feather.read_table(path).to_pylist(), ()
        known = parquet.read_metadata(path)
        check_count(path, known.num_rows * known.num_columns)
        return parquet.read_table(path).to_pylist(), ()


READERS: dict[str, Callable[[Path], Content]] = {
    ".json": _of_json,
    ".jsonl": _of_json_lines,
    ".ndjson": _of_json_lines,
    ".parquet": _of_arrow,
    ".feather": _of_arrow,
}
