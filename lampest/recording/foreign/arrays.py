"""Arrays of .npy, .npz and .mat files as frames: which of them holds the panel, and in which order of axes."""

import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.recording.foreign.frames import MOST_BYTES, Clock, Frames, check_count, clock_of_numbers
from lampest.recording.foreign.words import role_of

ArraysByName = dict[str, NDArray[Any]]
MATRIX, COMPRESSED = 14, 15
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
FLAT, STACKED = "(frames, rows·columns), row by row", "(rows, columns, frames)"
AXES = {
    "(rows, columns)": ("row", "column"),
    STACKED: ("row", "column", "frame"),
    "(frames, rows, columns)": ("frame", "row", "column"),
    FLAT: ("frame", "cell"),
}
NUMPY_LAYOUTS = ("(rows, columns)", "(frames, rows, columns)", FLAT, STACKED)
MATLAB_LAYOUTS = ("(rows, columns)", STACKED, "(frames, rows, columns)")  # as MATLAB stacks matrices


def check_archive(path: Path, kind: str) -> None:
    """Raise InputError where a file is no zip archive, or its parts claim more bytes than are imported."""
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


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (OSError, MemoryError, InputError):
        raise
    except Exception as error:  # parsers of damaged files raise whatever they meet
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no readable {path.suffix.lower()} file ({said})") from error


def _of_npy(path: Path) -> ArraysByName:
    """The one array under the name ''."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise InputError(f"{path}: holds no plain array of real numbers")
    check_count(path, array.size)
    return {"": np.array(array)}


def _of_npz(path: Path) -> ArraysByName:
    check_archive(path, ".npz")
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        for name in (name for name in archive.namelist() if name.endswith(".npy")):
            with archive.open(name) as stream:
                first = npy.read_magic(stream) == (1, 0)
                dtype = (npy.read_array_header_1_0 if first else npy.read_array_header_2_0)(stream)[2]
                stream.seek(0)
                if dtype.kind in "iuf":
                    arrays[name.removesuffix(".npy")] = npy.read_array(stream, allow_pickle=False)
    return arrays


def _of_mat(path: Path) -> ArraysByName:
    """Arrays in MATLAB's shape, in the file's order; texts, structures, cells and complex arrays are left out."""
    # Source: MATLAB, MAT-File Format, 2020. Damaged files end SciPy's reader in a segmentation fault.
    data = path.read_bytes()
    if data.startswith((b"MATLAB 7.3", b"\x89HDF")):
        return _of_level_7(path)
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise InputError(f"{path}: no readable .mat file (save it with the option -v7)")
    arrays, rest = {}, MOST_BYTES
    for kind, body in _elements(memoryview(data)[128:], order):
        if kind == COMPRESSED:
            _check_claim(path, body, order, rest)
            unpacker = zlib.decompressobj()
            unpacked = unpacker.decompress(body, max(rest, 1))
            if not unpacker.eof:
                raise ValueError("a compressed element is cut, or too large")
            rest -= len(unpacked)
            kind, body = next(_elements(memoryview(unpacked), order), (0, body))
        name, array = _matrix(body, order) if kind == MATRIX else ("", None)
        if array is not None:
            arrays[name] = array
    return arrays


def _elements(view: memoryview, order: str, cut: bool = False) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of data elements that follow one another; cut : whether the last one may end early."""
    at = 0
    while at + 8 <= len(view):
        kind, size = struct.unpack_from(order + "II", view, at)
        start, after = at + 8, at + 8 + size + (0 if kind == COMPRESSED else -size % 8)
        if kind >> 16:  # a small one holds both in eight bytes
            kind, size, start, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        if (start + size > len(view) and not cut) or (after == at + 8 and size > 4):
            raise ValueError("an element reaches beyond its end")
        yield kind, view[start : start + size]
        at = after


def _check_claim(path: Path, body: memoryview, order: str, most: int) -> None:
    """Raise InputError where a compressed matrix claims more than is imported: its beginning says so, unpacked."""
    begin = zlib.decompressobj().decompress(body, 4096)
    if len(begin) < 8:
        return
    kind, size = struct.unpack_from(order + "II", begin)
    if size > most:
        raise InputError(f"{path}: unpacks to {size} bytes or more, and {most} are imported")
    parts = [part for _, part in _elements(memoryview(begin)[8:], order, cut=True)] if kind == MATRIX else []
    if len(parts) > 1:
        check_count(path, prod(np.frombuffer(parts[1][: len(parts[1]) // 4 * 4], dtype=order + "i4").tolist()))


def _matrix(body: memoryview, order: str) -> tuple[str, NDArray[Any] | None]:
    """A matrix element's name and values: flags, dimensions, name and real part stand one after another."""
    parts = [part for part, _ in zip(_elements(body, order), range(4), strict=False)]
    if len(parts) < 4 or len(parts[0][1]) != 8:
        return "", None
    (flags,) = struct.unpack_from(order + "I", parts[0][1])
    if not 6 <= flags & 0xFF <= 15 or flags & 0x800:  # double to uint64; complex
        return "", None
    size = np.frombuffer(parts[1][1], dtype=order + "i4").tolist()
    kind, values = parts[3]
    if kind not in NUMBERS:
        raise ValueError(f"values of the unknown kind {kind}")
    array = np.frombuffer(values, dtype=order + NUMBERS[kind])
    if len(size) < 2 or min(size) < 0 or prod(size) != array.size:
        raise ValueError(f"an array of {' × '.join(map(str, size)) or 'no'} values holds {array.size}")
    return bytes(parts[2][1]).decode("ascii", "replace"), array.reshape(size, order="F")


def _of_level_7(path: Path) -> ArraysByName:
    """HDF5 has MATLAB's axes in reverse."""
    arrays = {}
    try:
        with hdf5.existing_file(path) as file:
            for name in hdf5.child_datasets(file, "/"):
                dataset = file[name]
                text = hdf5.read_attribute(file, f"/{name}", "MATLAB_class") == "char"
                empty = hdf5.read_attribute(file, f"/{name}", "MATLAB_empty")
                if dataset.dtype.kind in "iuf" and dataset.shape and not text and not empty:
                    arrays[name] = hdf5.read_array(file, f"/{name}", len(dataset.shape)).T
    except InputError as error:
        raise InputError(f"{error}; save it with the option -v7 instead") from error
    return arrays


# Suffix → how its arrays are read, and the orders of axes that are tried.
ARRAYS: dict[str, tuple[Callable[[Path], ArraysByName], Sequence[str]]] = {
    ".npy": (_of_npy, NUMPY_LAYOUTS),
    ".npz": (_of_npz, NUMPY_LAYOUTS),
    ".mat": (_of_mat, MATLAB_LAYOUTS),
}


def frames_of_arrays(path: Path, shape: tuple[int, int], variable: str | None) -> Frames:
    """Frames (frames, rows, columns) of the one array that fits, or of the variable, in the first order that does.

    Raises InputError where the file is damaged, or none or several fit.
    """
    read, layouts = ARRAYS[path.suffix.lower()]
    with _reading(path):
        arrays = read(path)
    fits = {name: [layout for layout in layouts if _fits(array.shape, layout, shape)] for name, array in arrays.items()}
    name = _chosen(path, arrays, fits, shape, variable)
    array, where = arrays[name], f"{path}: {name}" if name else str(path)
    if not fits[name]:
        hint = "; with --transpose it would" if shape[0] != shape[1] and array.shape[-2:] == shape[::-1] else ""
        ways = f"fits {shape[0]} × {shape[1]} cells in no way: {', '.join(layouts)}"
        raise InputError(f"{where}: is {_by(array.shape)}, which {ways}{hint}")
    check_count(where, array.size)
    layout, *others = fits[name]
    every: NDArray[np.intp] = np.arange(array.size).reshape(array.shape)
    number = (every.transpose(2, 0, 1) if layout == STACKED else every).reshape(-1, *shape)
    note = f"{f'array {name} ' if name else ''}read as {layout}{f' ({others[0]} would fit, too)' if others else ''}"
    timing, of_matlab = _timing(path, arrays, name, len(number)), layouts is MATLAB_LAYOUTS

    def named(at: int) -> str:
        index = ", ".join(str(part + of_matlab) for part in np.unravel_index(max(at, 0), array.shape))
        return f"{where}({index})" if of_matlab else f"{where}[{index}]"

    return Frames(array.ravel(), number, named, timing, (note,), (name,))


def _chosen(
    path: Path,
    arrays: ArraysByName,
    fits: dict[str, list[str]],
    shape: tuple[int, int],
    variable: str | None,
) -> str:
    if variable is not None and variable not in arrays:
        raise InputError(f"{path}: no numeric array '{variable}'; there are {', '.join(arrays) or 'none'}")
    if variable is not None or list(arrays) == [""]:
        return variable or ""
    chosen = [name for name in arrays if fits[name]]
    if len(chosen) > 1:
        raise InputError(f"{path}: {', '.join(chosen)} would all fit; say which with --variable")
    if not chosen:
        listed = ", ".join(f"{name} ({_by(array.shape)})" for name, array in arrays.items()) or "none"
        raise InputError(f"{path}: no array fits {shape[0]} × {shape[1]} cells; the numeric arrays are: {listed}")
    return chosen[0]


def _fits(size: tuple[int, ...], layout: str, shape: tuple[int, int]) -> bool:
    sizes = {"row": shape[0], "column": shape[1], "cell": shape[0] * shape[1]}
    axes = AXES[layout]
    return len(size) == len(axes) and all(
        has == sizes.get(axis, has or 1) for has, axis in zip(size, axes, strict=True)
    )


def _timing(path: Path, arrays: ArraysByName, chosen: str, frames: int) -> Callable[[], Clock] | None:
    """The one array that is called like a time and has one value for each frame."""
    times = [name for name in arrays if name != chosen and role_of(name) == "time" and arrays[name].size == frames]
    if len(times) != 1:
        return None

    def clock() -> Clock:
        values = np.asarray(arrays[times[0]], dtype=float).ravel()
        read = clock_of_numbers(values, times[0], lambda frame: f"{path}: {times[0]}[{frame}]")
        return read.said(f"array {times[0]} in ")

    return clock


def _by(size: Sequence[int]) -> str:
    return " × ".join(str(part) for part in size) or "one value"
