"""Arrays as frames: which of a file's arrays holds the panel, and in which order of axes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lampest.files.errors import InputError
from lampest.recording.foreign.clock import clock_of_numbers
from lampest.recording.foreign.frames import Clock, Frames, check_count
from lampest.recording.foreign.headers import role_of
from lampest.recording.foreign.numpy_file import ArraysByName

FLAT = "(frames, rows·columns), row by row"
AXES = {
    "(rows, columns)": ("row", "column"),
    "(rows, columns, frames)": ("row", "column", "frame"),
    "(frames, rows, columns)": ("frame", "row", "column"),
    FLAT: ("frame", "cell"),
}
NUMPY_LAYOUTS = ("(rows, columns)", "(frames, rows, columns)", FLAT, "(rows, columns, frames)")
MATLAB_LAYOUTS = ("(rows, columns)", "(rows, columns, frames)", "(frames, rows, columns)")  # as MATLAB stacks matrices


def frames_of_arrays(
    source: str,
    arrays: ArraysByName,
    shape: tuple[int, int],
    variable: str | None,
    layouts: Sequence[str],
    first: int,
) -> Frames:
    """Frames (frames, rows, columns) of the one array that fits, its layout the first that does.

    first : the number of the first place in an array, 0 as NumPy counts or 1 as MATLAB does.
    Raises InputError where none or several fit.
    """
    name = _chosen(source, arrays, shape, variable, layouts)
    array, where = arrays[name], f"{source}: {name}" if name else source
    fits = [layout for layout in layouts if _fits(array.shape, _sizes(layout, shape))]
    if not fits:
        hint = "; with --transpose it would" if shape[0] != shape[1] and array.shape[-2:] == shape[::-1] else ""
        listed = ", ".join(layouts)
        raise InputError(
            f"{where}: is {_times(array.shape)}, which fits {shape[0]} × {shape[1]} cells in no way: {listed}{hint}"
        )
    check_count(where, array.size)
    axes = AXES[fits[0]]
    values = array.astype(float)
    if fits[0] == "(rows, columns, frames)":
        values = values.transpose(2, 0, 1)
    values = values.reshape(-1, *shape)
    also = f" ({fits[1]} would fit, too)" if len(fits) > 1 else ""
    called = f"array {name} " if name else ""
    timing = _timing(source, arrays, name, len(values))
    return Frames(values, timing, (f"{called}read as {fits[0]}{also}",), _place(where, axes, first, shape), (name,))


def _chosen(
    source: str, arrays: ArraysByName, shape: tuple[int, int], variable: str | None, layouts: Sequence[str]
) -> str:
    if variable is not None and variable not in arrays:
        raise InputError(f"{source}: no numeric array '{variable}'; there are {', '.join(arrays) or 'none'}")
    if variable is not None:
        return variable
    if list(arrays) == [""]:
        return ""
    chosen = [
        name for name, array in arrays.items() if any(_fits(array.shape, _sizes(layout, shape)) for layout in layouts)
    ]
    if len(chosen) > 1:
        raise InputError(f"{source}: {', '.join(chosen)} would all fit; say which with --variable")
    if not chosen:
        listed = ", ".join(f"{name} ({_times(array.shape)})" for name, array in arrays.items()) or "none"
        raise InputError(f"{source}: no array fits {shape[0]} × {shape[1]} cells; the numeric arrays are: {listed}")
    return chosen[0]


def _sizes(layout: str, shape: tuple[int, int]) -> tuple[int, ...]:
    """The size of every axis, -1 for any."""
    sizes = {"frame": -1, "row": shape[0], "column": shape[1], "cell": shape[0] * shape[1]}
    return tuple(sizes[axis] for axis in AXES[layout])


def _fits(size: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return len(size) == len(wanted) and all(
        has == wants or (wants == -1 and has > 0) for has, wants in zip(size, wanted, strict=True)
    )


def _timing(source: str, arrays: ArraysByName, chosen: str, frames: int) -> Callable[[], Clock] | None:
    """The one array that is called like a time and has one value for each frame."""
    times = [
        name for name, array in arrays.items() if name != chosen and role_of(name) == "time" and array.size == frames
    ]
    if len(times) != 1:
        return None
    name, values = times[0], np.asarray(arrays[times[0]], dtype=float).ravel()

    def clock() -> Clock:
        read = clock_of_numbers(values, name, lambda frame: f"{source}: {name}[{frame}]")
        return Clock(read.seconds, read.start, f"time: array {name} in {read.sentence}")

    return clock


def _times(size: Sequence[int]) -> str:
    return " × ".join(str(part) for part in size) or "one value"


def _place(where: str, axes: tuple[str, ...], first: int, shape: tuple[int, int]) -> Callable[[int, int, int], str]:
    """How to name a value of an array: its indices in the file's order, counted from `first`."""

    def place(frame: int, row: int, column: int) -> str:
        index: dict[str, Any] = {"frame": frame, "row": row, "column": column, "cell": row * shape[1] + column}
        brackets = "({})" if first else "[{}]"
        return f"{where}{brackets.format(', '.join(str(index[axis] + first) for axis in axes))}"

    return place
