"""Data frames and labelled arrays of other libraries as frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lampest.apps.foreign.clocks import Clock
from lampest.apps.foreign.division import frames_of
from lampest.apps.foreign.form import readings_table
from lampest.apps.foreign.lines import FieldLine, field_lines
from lampest.apps.foreign.records import text_of_value
from lampest.apps.foreign.unit import understood_unit
from lampest.apps.foreign.words import role_of, units_of
from lampest.files.errors import InputError, in_words
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.unit import check_unit


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
    lines = [FieldLine(0, names)]
    for number, values in enumerate(table.itertuples(index=indexed, name=None), 1):
        lines.append(FieldLine(number, [text_of_value(value) for value in values]))

    def at(number: int, field: int | None) -> str:
        return f"table: line {number - 1}" + ("" if field is None else f", column {names[field]!r}")

    frames = frames_of(readings_table(field_lines("table", "line", at, (), lines)), panel.shape)
    values = np.where(panel.present, frames.values, np.nan)
    named = unit or understood_unit(values, named_units(frames.words, "table"), scene, "table")[0]
    return values, named, panel, None if frames.timing is None else frames.timing(None)


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


def named_units(words: Sequence[str], source: object) -> tuple[str, ...]:
    """Return the units that the file's own words permit.

    Raises InputError with the file if they are not imported.
    """
    try:
        return units_of(words)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error


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
