"""Foreign measurements → a recording: text tables, NumPy's .npy and MATLAB's .mat."""

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lampest.files.document import read_document, validated
from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.foreign.matlab_file import read_arrays
from lampest.recording.foreign.table_file import Frames, read_table
from lampest.recording.recording import MEASURED, UNLOADED, Recording

UNITS = ("ohm", "volt", "code")
MOST_BYTES = 500_000_000
MOST_VALUES = 50_000_000


def import_file(
    path: str | Path,
    rows: int,
    columns: int,
    scene: Scene | None = None,
    unit: str = "ohm",
    baseline_frames: int = 0,
    transpose: bool = False,
    variable: str | None = None,
) -> tuple[Recording, tuple[str, ...]]:
    """A recording of rows × columns cells, and sentences on what was found out or assumed about the file.

    The suffix says what the file is: .npy, .mat, and a text table for every other.

    Parameters
    ----------
    scene : panel, readout and series resistance; None: this panel and resistances alone.
    unit : what the numbers are: 'ohm' of two-point readouts; 'volt' at the converter and its 'code' need the scene's
        readout.
    baseline_frames : the first so many frames were taken without load.
    transpose : the file's rows are the panel's columns.
    variable : which array of a .mat file; needed where several would do.

    Raises InputError with file and place where anything does not fit.
    """
    path = Path(path)
    panel = _panel(rows, columns, scene)
    if unit not in UNITS:
        raise InputError(f"the unit '{unit}' is unknown; there are {', '.join(UNITS)}")
    if unit != "ohm" and (scene is None or scene.readout is None):
        raise InputError(f"{path}: {unit} values need a scene with a readout, which tells how they become ohm")
    if scene is not None and unit == "ohm" != scene.circuit.unit:
        raise InputError(f"{path}: the scene's readout gives {scene.circuit.unit}; say unit volt or code")
    frames = _read(path, (columns, rows) if transpose else (rows, columns), variable)
    notes = list(frames.notes)
    values, place = frames.values, frames.place
    if transpose:
        values, place = values.transpose(0, 2, 1), _transposed(place)
        notes.append("transposed: the file's rows are the panel's columns")
    if not 0 <= baseline_frames <= len(values):
        raise InputError(
            f"{path}: {baseline_frames} baseline frames asked for, but the file holds {len(values)} frames"
        )
    scene = scene or Scene(panel)
    recorded = _recorded(values, unit, scene, place)
    time = np.arange(len(values), dtype=float) if frames.time is None else frames.time
    if frames.time is None:
        notes.append("no time in the file: one frame a second is assumed")
    role = np.where(np.arange(len(values)) < baseline_frames, UNLOADED, MEASURED).astype(np.uint8)
    notes.append(f"{len(values)} frames of {rows} × {columns} cells, the first {baseline_frames} of them unloaded")
    return Recording(scene, recorded, time, role, name=path.stem), tuple(notes)


def read_scene(path: str | Path) -> Scene:
    """The scene of a YAML file, which holds nothing else or has it under `scene`.

    Raises InputError with line and column.
    """
    document = read_document(Path(path))
    if isinstance(document.content, dict) and "scene" in document.content:
        document = dataclasses.replace(document, content=document.content["scene"], marks=document.marks["scene"])
    scene: Scene = validated(document, Scene)
    return scene


def _panel(rows: int, columns: int, scene: Scene | None) -> Panel:
    try:
        panel = Panel(rows, columns)
    except ValueError as error:
        raise InputError(f"{rows} × {columns}: {error}") from error
    if scene is not None and scene.panel.shape != panel.shape:
        found = " × ".join(str(size) for size in scene.panel.shape)
        raise InputError(f"the scene's panel has {found} cells, not {rows} × {columns}")
    return panel


def _transposed(place: Callable[[int, int, int], str]) -> Callable[[int, int, int], str]:
    return lambda frame, row, column: place(frame, column, row)


def _read(path: Path, shape: tuple[int, int], variable: str | None) -> Frames:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise InputError(f"{path}: no file")
        if size > MOST_BYTES:
            raise InputError(f"{path}: {size} bytes, more than {MOST_BYTES} are not imported")
        if path.suffix.lower() == ".npy":
            return _read_numpy(path, shape)
        if path.suffix.lower() == ".mat":
            return _read_matlab(path, shape, variable)
        return read_table(path, shape)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise InputError(f"{path}: claims more data than the memory holds") from error


def _read_numpy(path: Path, shape: tuple[int, int]) -> Frames:
    """(frames, rows, columns), (rows, columns) or (frames, rows·columns), row by row."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mapped = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, MemoryError):
        raise
    except Exception as error:  # its parser of headers raises whatever Python's parser does
        found = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no readable .npy file ({found})") from error
    if not isinstance(mapped, np.ndarray) or mapped.dtype.kind not in "iuf":
        raise InputError(f"{path}: holds no plain array of real numbers")
    if mapped.size > MOST_VALUES:
        raise InputError(f"{path}: {mapped.size} values, more than {MOST_VALUES} are not imported")
    layouts: dict[str, tuple[int, ...]] = {"(rows, columns)": shape, "(frames, rows, columns)": (-1, *shape)}
    layouts["(frames, rows·columns), row by row"] = (-1, shape[0] * shape[1])
    fits = [name for name, wanted in layouts.items() if _fits(mapped.shape, wanted)]
    if not fits:
        raise InputError(_wrong_shape(str(path), mapped.shape, layouts, shape))
    values = np.array(mapped, dtype=float).reshape(-1, *shape)
    return Frames(values, None, (f"read as {fits[0]}",), _array_place(str(path), ("frame", "row", "column")))


def _read_matlab(path: Path, shape: tuple[int, int], variable: str | None) -> Frames:
    """(rows, columns, frames) as MATLAB stacks matrices, else (rows, columns) or (frames, rows, columns)."""
    arrays = read_arrays(path)
    sizes = {name: array.shape for name, array in arrays.items()}
    layouts: dict[str, tuple[int, ...]] = {"(rows, columns)": shape, "(rows, columns, frames)": (*shape, -1)}
    layouts["(frames, rows, columns)"] = (-1, *shape)
    if variable is not None and variable not in sizes:
        raise InputError(f"{path}: no numeric array '{variable}'; there are {', '.join(sizes) or 'none'}")
    chosen = (
        [variable]
        if variable
        else [name for name, size in sizes.items() if any(_fits(size, w) for w in layouts.values())]
    )
    if len(chosen) > 1:
        raise InputError(f"{path}: {', '.join(chosen)} would all fit; say which with --variable")
    if not chosen:
        listed = ", ".join(f"{name} ({_times(size)})" for name, size in sizes.items()) or "none"
        raise InputError(f"{path}: no array fits {shape[0]} × {shape[1]} cells; the numeric arrays are: {listed}")
    name = chosen[0]
    fits = [layout for layout, wanted in layouts.items() if _fits(sizes[name], wanted)]
    if not fits:
        raise InputError(_wrong_shape(f"{path}: {name}", sizes[name], layouts, shape))
    if arrays[name].size > MOST_VALUES:
        raise InputError(f"{path}: {name} has {arrays[name].size} values, more than {MOST_VALUES} are not imported")
    values = arrays[name].astype(float)
    if fits[0] == "(rows, columns, frames)":
        values = values.transpose(2, 0, 1)
        place = _array_place(f"{path}: {name}", ("row", "column", "frame"), 1)
    elif fits[0] == "(rows, columns)":
        place = _array_place(f"{path}: {name}", ("row", "column"), 1)
    else:
        place = _array_place(f"{path}: {name}", ("frame", "row", "column"), 1)
    return Frames(values.reshape(-1, *shape), None, (f"array {name} read as {fits[0]}",), place)


def _fits(size: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return len(size) == len(wanted) and all(
        has == wants or (wants == -1 and has > 0) for has, wants in zip(size, wanted, strict=True)
    )


def _wrong_shape(where: str, size: tuple[int, ...], layouts: dict[str, tuple[int, ...]], shape: tuple[int, int]) -> str:
    hint = "; with --transpose it would" if shape[0] != shape[1] and size[-2:] == shape[::-1] else ""
    return f"{where}: is {_times(size)}, which fits {shape[0]} × {shape[1]} cells in no way: {', '.join(layouts)}{hint}"


def _times(size: Sequence[int]) -> str:
    return " × ".join(str(part) for part in size) or "one value"


def _array_place(where: str, order: tuple[str, ...], first: int = 0) -> Callable[[int, int, int], str]:
    """How to name a value of an array: its indices in the file's order, counted from `first`."""

    def place(frame: int, row: int, column: int) -> str:
        index = {"frame": frame + first, "row": row + first, "column": column + first}
        brackets = "({})" if first else "[{}]"
        return f"{where}{brackets.format(', '.join(str(index[name]) for name in order))}"

    return place


def _recorded(values: Array, unit: str, scene: Scene, place: Callable[[int, int, int], str]) -> Array:
    """Values in their unit → what a recording of this readout holds, (frames, rows, columns)."""
    _refuse(~np.isfinite(values), values, place, "is no finite number")
    readout = scene.readout
    if unit == "ohm" or readout is None:
        _refuse(values <= 0, values, place, "must be a positive resistance in ohm")
        return values
    if unit == "code":
        highest = 2**readout.adc_bits - 1
        _refuse((values < 0) | (values > highest), values, place, f"is no code of a {readout.adc_bits}-bit converter")
        _refuse((values == 0) | (values == highest), values, place, "is a saturated code, whose voltage is unknown")
        return readout.recorded_from_volt(readout.volt_from_code(values))
    outside = (values < 0) | (values > readout.supply_volt)
    _refuse(outside, values, place, f"lies outside 0 to {readout.supply_volt:g} V, the readout's supply")
    saturated = (values == 0) | (values == readout.supply_volt)
    _refuse(saturated, values, place, "V is saturated: it may be anything beyond")
    return readout.recorded_from_volt(values)


def _refuse(bad: np.ndarray, values: Array, place: Callable[[int, int, int], str], why: str) -> None:
    if np.any(bad):
        frame, row, column = (int(part) for part in np.argwhere(bad)[0])
        raise InputError(f"{place(frame, row, column)}: {values[frame, row, column]:.6g} {why}")
