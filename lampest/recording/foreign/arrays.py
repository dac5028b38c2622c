"""Arrays of .npy, .npz and .mat files as frames: which of them holds the panel, and in which order of axes.

A file may claim anything: sizes are held against what it holds before they are used.
"""

import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.recording.foreign.clock import clock_of_numbers
from lampest.recording.foreign.frames import MOST_BYTES, Clock, Frames, check_count
from lampest.recording.foreign.words import role_of

ArraysByName = dict[str, NDArray[Any]]
MAT_HEADER = 128
MATRIX, COMPRESSED = 14, 15
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
NUMERIC_CLASSES = range(6, 16)  # double, single, int8 ... uint64
COMPLEX = 0x800
BEGINNING = 4096  # of a matrix, which holds its dimensions
FLAT = "(frames, rows·columns), row by row"
AXES = {
    "(rows, columns)": ("row", "column"),
    "(rows, columns, frames)": ("row", "column", "frame"),
    "(frames, rows, columns)": ("frame", "row", "column"),
    FLAT: ("frame", "cell"),
}
NUMPY_LAYOUTS = ("(rows, columns)", "(frames, rows, columns)", FLAT, "(rows, columns, frames)")
MATLAB_LAYOUTS = ("(rows, columns)", "(rows, columns, frames)", "(frames, rows, columns)")  # as MATLAB stacks matrices


def check_archive(path: Path, kind: str) -> None:
    """Raise InputError where a file is no zip archive, or its parts claim more bytes than are imported.

    Python's reader of zip files gives no more of a part than it claims.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            parts = archive.infolist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: no readable {kind} file ({' '.join(str(error).split())})") from error
    claimed = sum(part.file_size for part in parts)
    if claimed > MOST_BYTES:
        raise InputError(f"{path}: unpacks to {claimed} bytes, more than {MOST_BYTES} are not imported")
    if any(part.flag_bits & 1 for part in parts):
        raise InputError(f"{path}: is locked with a password")


def array_of_npy(path: Path) -> ArraysByName:
    """The one array under the name ''. Raises InputError where it is damaged, or of anything but real numbers."""
    with _reading(path, ".npy"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise InputError(f"{path}: holds no plain array of real numbers")
    check_count(path, array.size)
    return {"": np.array(array)}


def arrays_of_npz(path: Path) -> ArraysByName:
    """Name → array of real numbers. Raises InputError where one is damaged, or larger than the file says."""
    check_archive(path, ".npz")
    arrays = {}
    with _reading(path, ".npz"), zipfile.ZipFile(path) as archive:
        for part in archive.infolist():
            if not part.filename.endswith(".npy"):
                continue
            with archive.open(part) as stream:
                array = _array_of_part(stream, part.file_size)
            if array is not None:
                arrays[part.filename.removesuffix(".npy")] = array
    return arrays


def _array_of_part(stream: Any, size: int) -> NDArray[Any] | None:
    """An array of numbers whose header claims no more than its part has; None of texts and objects."""
    shape, _, dtype = _header(stream)
    if dtype.kind not in "iuf":
        return None
    claimed = dtype.itemsize
    for length in shape:
        claimed *= length
    if claimed > size:
        raise ValueError(f"an array claims {claimed} bytes in a part of {size}")
    stream.seek(0)
    array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
    return array


def _header(stream: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = npy.read_magic(stream)
    return npy.read_array_header_1_0(stream) if version == (1, 0) else npy.read_array_header_2_0(stream)


@contextmanager
def _reading(path: Path, kind: str) -> Iterator[None]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (OSError, MemoryError, InputError):
        raise
    except Exception as error:  # its parser of headers raises whatever Python's parser does
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no readable {kind} file ({said})") from error


def arrays_of_level_7(path: Path) -> dict[str, NDArray[Any]]:
    """Name → array in MATLAB's shape (HDF5 has its axes in reverse); texts, structures and cells are left out.

    Raises InputError where the file is no HDF5, or an array is damaged or claims what it does not hold.
    """
    arrays = {}
    try:
        with hdf5.existing_file(path) as file:
            for name in hdf5.child_datasets(file, "/"):
                dataset = file[name]
                kind = hdf5.read_attribute(file, f"/{name}", "MATLAB_class")
                if dataset.dtype.kind not in "iuf" or kind == "char" or not dataset.shape:
                    continue
                if hdf5.read_attribute(file, f"/{name}", "MATLAB_empty"):
                    continue
                arrays[name] = hdf5.read_array(file, f"/{name}", len(dataset.shape)).T
    except InputError as error:
        raise InputError(f"{error}; save it with the option -v7 instead") from error
    return arrays


def arrays_of_mat(path: Path) -> dict[str, NDArray[Any]]:
    """Name → array in MATLAB's shape, in the file's order; texts, structures and complex arrays are left out.

    Raises InputError where the file is of another kind or damaged. Source: MATLAB, MAT-File Format, 2020.
    """
    data = path.read_bytes()
    if data.startswith((b"MATLAB 7.3", b"\x89HDF")):
        return arrays_of_level_7(path)
    order = {b"IM": "<", b"MI": ">"}.get(data[MAT_HEADER - 2 : MAT_HEADER])
    if order is None:
        raise InputError(f"{path}: no readable .mat file (save it with the option -v7)")
    arrays, rest = {}, MOST_BYTES
    try:
        for kind, body in _elements(memoryview(data)[MAT_HEADER:], order):
            if kind == COMPRESSED:
                _check_claim(path, body, order, rest)
                unpacked = _unpacked(body, rest)
                rest -= len(unpacked)
                kind, body = next(_elements(memoryview(unpacked), order), (0, body))
            if kind == MATRIX:
                name, array = _matrix(body, order)
                if array is not None:
                    arrays[name] = array
    except InputError:
        raise
    except (ValueError, struct.error, zlib.error) as error:
        raise InputError(f"{path}: no readable .mat file ({error})") from error
    return arrays


def _elements(view: memoryview, order: str, cut: bool = False) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of the data elements that follow one another; small ones hold both in eight bytes.

    cut : whether the last one may end early.
    """
    at = 0
    while at + 8 <= len(view):
        kind, size = struct.unpack_from(order + "II", view, at)
        start, after = at + 8, at + 8 + size + (0 if kind == COMPRESSED else -size % 8)
        if kind >> 16:
            kind, size, start, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if size > 4:
                raise ValueError("a small element larger than four bytes")
        if start + size > len(view) and not cut:
            raise ValueError("an element reaches beyond its end")
        yield kind, view[start : start + size]
        at = after


def _unpacked(body: memoryview, most: int) -> bytes:
    unpacker = zlib.decompressobj()
    unpacked = unpacker.decompress(body, max(most, 1))
    if not unpacker.eof:
        raise ValueError("a compressed element is cut, or too large")
    return unpacked


def _check_claim(path: Path, body: memoryview, order: str, most: int) -> None:
    """Raise InputError where a compressed matrix claims more than is imported: its beginning says so.

    What a compressed element claims to hold costs nothing to read, and all the memory to unpack.
    """
    begin = zlib.decompressobj().decompress(body, BEGINNING)
    if len(begin) < 8:
        return
    kind, size = struct.unpack_from(order + "II", begin)
    if size > most:
        raise InputError(f"{path}: unpacks to {size} bytes or more, and {most} are imported")
    if kind != MATRIX:
        return
    parts = [part for _, part in _elements(memoryview(begin)[8:], order, cut=True)]
    if len(parts) > 1:
        claimed = prod(int(part) for part in np.frombuffer(parts[1][: len(parts[1]) // 4 * 4], dtype=order + "i4"))
        check_count(path, claimed)


def _matrix(body: memoryview, order: str) -> tuple[str, NDArray[Any] | None]:
    """A matrix element's name and values: flags, dimensions, name and real part stand one after another."""
    parts = [part for part, _ in zip(_elements(body, order), range(4), strict=False)]
    if len(parts) < 3 or len(parts[0][1]) != 8:
        return "", None
    (flags,) = struct.unpack_from(order + "I", parts[0][1])
    if flags & 0xFF not in NUMERIC_CLASSES or flags & COMPLEX or len(parts) < 4:
        return "", None
    size = tuple(int(part) for part in np.frombuffer(parts[1][1], dtype=order + "i4"))
    name = bytes(parts[2][1]).decode("ascii", "replace")
    kind, values = parts[3]
    if kind not in NUMBERS:
        raise ValueError(f"values of the unknown kind {kind}")
    array = np.frombuffer(values, dtype=order + NUMBERS[kind])
    if len(size) < 2 or min(size) < 0 or prod(size) != array.size:
        raise ValueError(f"an array of {' × '.join(map(str, size)) or 'no'} values holds {array.size}")
    return name, array.reshape(size, order="F")


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
            f"{where}: is {_by(array.shape)}, which fits {shape[0]} × {shape[1]} cells in no way: {listed}{hint}"
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
        listed = ", ".join(f"{name} ({_by(array.shape)})" for name, array in arrays.items()) or "none"
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


def _by(size: Sequence[int]) -> str:
    return " × ".join(str(part) for part in size) or "one value"


def _place(where: str, axes: tuple[str, ...], first: int, shape: tuple[int, int]) -> Callable[[int, int, int], str]:
    """How to name a value of an array: its indices in the file's order, counted from `first`."""

    def place(frame: int, row: int, column: int) -> str:
        index: dict[str, Any] = {"frame": frame, "row": row, "column": column, "cell": row * shape[1] + column}
        brackets = "({})" if first else "[{}]"
        return f"{where}{brackets.format(', '.join(str(index[axis] + first) for axis in axes))}"

    return place
