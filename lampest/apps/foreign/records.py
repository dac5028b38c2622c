"""Records of JSON, JSON lines, Parquet and Feather files, data frames and labelled arrays.

Records become arrays or the lines of a table.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import chain
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from lampest.apps.foreign.arrays import Arrays, check_count, reading
from lampest.apps.foreign.clocks import Clock
from lampest.apps.foreign.division import frames_of
from lampest.apps.foreign.form import readings_table
from lampest.apps.foreign.lines import FieldLine, FieldLines, field_lines
from lampest.apps.foreign.notation import flat_names
from lampest.apps.foreign.segments import alternate, few_values, several_sources, unused_note
from lampest.apps.foreign.unit import understood_unit
from lampest.apps.foreign.words import role_of
from lampest.files.errors import InputError, extra, in_words
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.unit import check_unit

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
    held = [part for record in records for part in _parts(record)]
    # Last words of names, where these are different, are enough.
    short = {name: name.rpartition(".")[2] for name in dict.fromkeys(chain.from_iterable(held))}
    often = Counter(short.values())
    names = {name: word if often[word] == 1 else name for name, word in short.items()}
    held = [{names[name]: value for name, value in record.items()} for record in held]
    if len(held) == 1 and not isinstance(content, list):
        return _arrays(path, held[0]), notes
    fields = list(names.values())
    if all(_is_value(value) for record in held for value in record.values()):

        def at(number: int, field: int | None) -> str:
            return f"{path}: record {number}" + ("" if field is None else f", {fields[field]!r}")

        rows = ([record.get(name) for name in fields] for record in held)
        lines = _record_lines(["" if name == INDEX else name for name in fields], rows)
        return field_lines(str(path), "record", at, [f"{len(held)} records"], lines), notes
    columns = {name: [record.get(name) for record in held] for name in fields}
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


def _is_value(value: Any) -> bool:
    return value is None or isinstance(value, str | int | float | datetime)


def _arrays(path: Path, values: dict[str, Any]) -> Arrays:
    """Return lists of numbers as arrays, and lists of dates as seconds since 1970.

    Other parts are left out.
    """
    arrays = Arrays()
    for name, value in values.items():
        if not isinstance(value, list):
            continue
        if any(isinstance(part, list) or hasattr(part, "shape") for part in value):
            # Nested lists become an array; null is a missing reading.
            where = f"{path}: {name}" if name else str(path)
            lengths = [len(part) if hasattr(part, "__len__") else 0 for part in value]
            if len(set(lengths)) > 1:
                usual = max(lengths, key=lengths.count)
                odd = next(number for number, length in enumerate(lengths) if length != usual)
                raise InputError(
                    f"{where}[{odd}]: {lengths[odd]} values, where others have {usual}"
                )
            try:
                array = np.array(value, dtype=float)
            except (TypeError, ValueError, OverflowError) as error:
                raise InputError(
                    f"{where}: its lists differ in length, or hold what is no number"
                ) from error
            check_count(where, array.size)
            arrays[name] = array
        elif all(isinstance(part, int | float | None) for part in value):
            arrays[name] = np.array(value, dtype=float)
        elif role_of(name) == "time" and all(map(_is_value, value)):
            with reading(path):
                arrays[name] = np.array([_seconds(part) for part in value])
    return arrays


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
    if isinstance(value, int | float | np.number):
        return repr(float(value)).removesuffix(".0")
    return str(value)


def _record_lines(names: Sequence[str], rows: Iterable[Iterable[Any]]) -> Iterator[FieldLine]:
    """Yield the lines of records: their names as line 0, then their values as texts."""
    for number, values in enumerate(chain([names], rows)):
        yield FieldLine(number, [text_of_value(value) for value in values])


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
    for number, line in lines:
        try:
            values.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            if number != lines[-1][0] or not values:
                raise InputError(
                    f"{path}:{number}: no JSON ({' '.join(str(error).split())})"
                ) from error
            return values, (f"left out: line {number}, the last one, which is cut off",)
    return values, ()


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
        read = feather.read_table
        if path.suffix.lower() == ".parquet":
            known = parquet.read_metadata(path)
            check_count(path, known.num_rows * known.num_columns)
            read = parquet.read_table
        return read(path).to_pylist(), ()


READERS: dict[str, Callable[[Path], Content]] = {
    ".json": _of_json,
    ".jsonl": _of_json_lines,
    ".ndjson": _of_json_lines,
    ".parquet": _of_arrow,
    ".feather": _of_arrow,
}


def understood_table(
    table: Any, unit: str | None, scene: Scene | None, rows: int | None, columns: int | None
) -> tuple[Array, str, Panel, Clock | None]:
    """Return the content of a data frame: values, their unit, the panel and the times.

    Raises InputError with line and column if it does not fit the panel, or no unit fits.

    Returns
    -------
    values : array, shape (frames, rows, columns)
    unit : str
    panel : Panel
    clock : Clock or None
    """
    panel = panel_of(rows, columns, scene)
    check_unit(unit, scene, "table")
    if not all(hasattr(table, name) for name in ("columns", "index", "itertuples")):
        raise InputError(f"from_dataframe needs a pandas.DataFrame, not {in_words(table)}")
    indexed = getattr(table.index, "name", None) is not None or hasattr(table.index, "tz")
    names = [str(table.index.name or "time")] * indexed + [str(name) for name in table.columns]
    lines = _record_lines(names, table.itertuples(index=indexed, name=None))

    def at(number: int, field: int | None) -> str:
        return f"table: line {number - 1}" + ("" if field is None else f", column {names[field]!r}")

    frames = frames_of(readings_table(field_lines("table", "line", at, (), lines)), panel.shape)
    values = np.where(panel.present, frames.values, np.nan)
    unit, _ = understood_unit(values, unit, frames.words, scene, "table")
    return values, unit, panel, None if frames.timing is None else frames.timing(None)


def labelled_array(data: Any) -> tuple[Array, Array | None, str | None]:
    """Return the values, times and unit of a labelled array.

    Raises InputError for another object, or if its dimensions are not time, row and column.

    Returns
    -------
    values : array, shape (frames, rows, columns)
    times : array, shape (frames,), or None
        In seconds; None without coordinates of time.
    unit : str or None
    """
    if not all(hasattr(data, name) for name in ("dims", "coords", "attrs", "transpose")) or hasattr(
        data, "data_vars"
    ):
        raise InputError(
            f"from_xarray needs an xarray.DataArray, not {in_words(data)}; "
            "of a Dataset name a variable"
        )
    places = {role_of(str(name)): name for name in data.dims}
    frame = places.get("time", places.get("frame"))
    wanted = [frame, places.get("row"), places.get("column")]
    if None in wanted or len(data.dims) != len(wanted):
        raise InputError(
            f"the dimensions must be time, row and column, not {', '.join(map(str, data.dims))}"
        )
    values = np.asarray(data.transpose(*wanted).values, dtype=float)
    seconds = None
    if frame in data.coords and role_of(str(frame)) == "time":
        times = np.asarray(data.coords[frame].values)
        dated = times.dtype.kind in "mM"
        seconds = (times - times[0]) / np.timedelta64(1, "s") if dated else times.astype(float)
    units = data.attrs.get("units")
    return values, seconds, None if units is None else str(units)


def panel_of(rows: int | None, columns: int | None, scene: Scene | None) -> Panel:
    """Return the requested panel, or the scene's; both must agree."""
    if scene is not None:
        shape = scene.panel.shape
        size = (shape[0] if rows is None else rows, shape[1] if columns is None else columns)
        if shape != size:
            raise InputError(
                f"the scene's panel has {shape[0]} × {shape[1]} cells, not {size[0]} × {size[1]}"
            )
        return scene.panel
    if rows is None or columns is None:
        raise InputError("how large is the panel? Say `rows` and `columns`, or give a `scene`")
    try:
        return Panel(rows, columns)
    except ValueError as error:
        raise InputError(f"{rows} × {columns}: {error}") from error
