"""Frames of foreign files, and their construction from arrays.

The arrays are those of .npy, .npz, .mat and HDF5 files.
"""

import re
import struct
import warnings
import zipfile
import zlib
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from lampest.apps.foreign.clocks import Clock, clock_of_numbers, grows
from lampest.apps.foreign.words import role_of
from lampest.files import hdf5
from lampest.files.errors import InputError, counted, first_and_more
from lampest.files.typed import Validated, real_array
from lampest.panel.panel import Array, Numbers

MAX_NOTES = 20  # of a folder (tests/contracts/test_import_files.py)
MAX_BYTES = 500_000_000  # of a file, unpacked, and of its values in memory (tests/attack)
# Data elements of a .mat file in the order of their numbers from 0; '-' is reserved.
ELEMENTS = "- i1 u1 i2 u2 i4 u4 f4 - f8 - - i8 u8 matrix compressed utf-8 utf-16 utf-32"
PICKLED = (
    "it holds pickled objects, "
    "which run code when they are opened, so that lampest does not open them"
)
ONE = "(rows, columns)"
STACKED = "(rows, columns, frames)"
FRAMES = "(frames, rows, columns)"
FLAT = "(frames, rows·columns), row by row"
TIMED = "(frames, 1 + rows·columns), the time first"
LAYOUTS = (ONE, FRAMES, FLAT, TIMED, STACKED)
LAYOUTS_OF_MATLAB = (ONE, STACKED, FRAMES)
# Words in the name of a single number that counts the frames that were written.
COUNTS = {"count", "counts", "frames", "nframes", "samples", "nsamples", "length", "written"}

Arrays = dict[str, NDArray[Any]]
Shape = tuple[int, int]
Timing = Callable[[str | None], Clock] | None


@dataclass(frozen=True, eq=False)
class Frames:
    """Readings of the cells among the numbers of a file, with times and notes.

    Attributes
    ----------
    numbers : array
        All numbers of the file, in its unit and order; NaN if missing; infinite numbers are kept.
    number : array, shape (frames, rows, columns)
        Numbers into `numbers`; -1 for a cell without a number.
    named : callable
        Function index → place in the file; -1 → the file.
    timing : callable, or None
        Function unit (or None) → times of the frames, which may raise InputError. None: no times in
        the file.
    notes : tuple of str
        Sentences on the interpretation of the file.
    words : tuple of str
        Names of columns or arrays, which may contain the unit.
    parts : int
        Number of parts, equal panels perhaps, that a line with a whole frame has.
    """

    numbers: Array
    number: Numbers
    named: Callable[[int], str]
    timing: Timing
    notes: tuple[str, ...]
    words: tuple[str, ...]
    parts: int = 1

    @property
    def values(self) -> Array:
        """Readings (frames, rows, columns) in the file's unit."""
        return np.where(self.number < 0, np.nan, self.numbers[self.number])

    def place(self, frame: int, row: int, column: int) -> str:
        """Return the place of a reading in the file."""
        number = int(self.number[frame, row, column])
        return (
            self.named(number)
            if number >= 0
            else f"{self.named(-1)}: row {row}, column {column} of frame {frame}"
        )

    def arranged(self, number: Numbers, note: str) -> "Frames":
        """Return the frames with another arrangement of the same numbers, and a note on it."""
        return replace(self, number=number, notes=(*self.notes, note))


def joined_frames(parts: Sequence[Frames], files: Sequence[str], source: str, note: str) -> Frames:
    """Return the frames of several files, one after the other.

    A note that some files lack names those that have it.

    Parameters
    ----------
    parts : sequence of Frames
        Frames of each file.
    files : sequence of str
        Names of the files.
    source : str
        Name of all files together, which have no times.
    note : str
    """
    lengths = [len(part.numbers) for part in parts]
    ends = np.cumsum(lengths)
    begins = (ends - lengths).tolist()
    number = [
        np.where(part.number < 0, -1, part.number + begin)
        for part, begin in zip(parts, begins, strict=True)
    ]

    def named(at: int) -> str:
        part = int(np.searchsorted(ends, at, side="right"))
        return source if at < 0 else parts[part].named(at - begins[part])

    # Each note once, at most MAX_NOTES: first those of all files, then those of some.
    by_note: dict[str, list[str]] = {}
    for part, file in zip(parts, files, strict=True):
        for text in dict.fromkeys(part.notes):
            by_note.setdefault(text, []).append(file)
    texts = sorted(by_note, key=lambda text: len(by_note[text]) < len(parts))
    notes = [
        text if len(by_note[text]) == len(parts) else f"{first_and_more(by_note[text], 3)}: {text}"
        for text in texts[:MAX_NOTES]
    ]
    if len(texts) > MAX_NOTES:
        notes.append(f"{counted(len(texts) - MAX_NOTES, 'more note')} on single files")
    return Frames(
        np.concatenate([part.numbers for part in parts]),
        np.concatenate(number),
        named,
        None,
        (note, *notes),
        tuple(dict.fromkeys(word for part in parts for word in part.words)),
    )


@dataclass(frozen=True)
class Layout(Validated):
    """Base of users' own file layouts.

    Attributes
    ----------
    kind : str
        Name for the option `--layout`. An installed package registers an object of the class in the
        entry point group `lampest.layouts`. In Python the object itself is passed as
        `import_file(..., layout=...)`.
    suffixes : tuple of str
        Suffixes in lower case, such as '.dat', of files that are read by this layout without the
        option.

    >>> issubclass(lampest.Layout, lampest.Layout)
    True
    """

    kind: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def read(self, path: Path, rows: int, columns: int) -> tuple[Array, Array | None]:
        """Return the readings of a file and their times.

        Raises InputError with the place in the file that cannot be read.

        Returns
        -------
        readings : array, shape (frames, rows, columns)
            NaN where missing.
        times : array, shape (frames,), or None
            In the file's unit.
        """

    def frames(self, path: Path, shape: Shape) -> Frames:
        """Return the layout's readings as frames. Raises InputError if they have another shape."""
        read, times = self.read(path, *shape)
        values = real_array(read, f"{path}: layout {self.kind}").astype(float)
        if values.ndim != 3 or values.shape[1:] != shape or not len(values):
            raise InputError(
                f"{path}: layout {self.kind} gives {_by(values.shape)}, not frames × {_by(shape)}"
            )

        def named(at: int) -> str:
            return f"{path}: reading {list(map(int, np.unravel_index(max(at, 0), values.shape)))}"

        def clock(unit: str | None) -> Clock:
            seconds = real_array(times, f"{path}: times of layout {self.kind}").astype(float)
            return clock_of_numbers(
                seconds, "", lambda frame: f"{path}: time of frame {frame}", unit
            ).read_from("")

        number = np.arange(values.size).reshape(values.shape)
        return Frames(
            values.ravel(),
            number,
            named,
            clock if times is not None else None,
            (f"layout {self.kind}",),
            (),
        )


def check_count(where: object, values: int) -> None:
    """Raise InputError if a file claims to have more values than are imported."""
    if 8 * values > MAX_BYTES:
        raise InputError(f"{where}: {values} values, more than {MAX_BYTES // 8} are not imported")


def check_archive(path: Path) -> None:
    """Raise InputError if a file is no zip archive, or claims to unpack to too many bytes.

    Too many are more bytes than are imported.
    """
    with reading(path), zipfile.ZipFile(path) as archive:
        claimed = sum(part.file_size for part in archive.infolist())
    if claimed > MAX_BYTES:
        raise InputError(
            f"{path}: unpacks to {claimed} bytes, more than {MAX_BYTES} are not imported"
        )


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Convert any exception of a parser into an InputError: damaged files raise arbitrary ones."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (OSError, MemoryError, InputError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no readable {path.suffix.lower()} file ({reason})") from error


def _of_npy(path: Path) -> Arrays:
    """Return the array of a .npy file under the name ''."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except ValueError as error:
        if "pickle" in str(error) or "Python objects" in str(error):
            raise InputError(
                f"{path}: no readable .npy file ({PICKLED}; save a plain array)"
            ) from error
        raise
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise InputError(f"{path}: holds no plain array of real numbers")
    check_count(path, array.size)
    return {"": np.array(array)}


def _of_npz(path: Path) -> Arrays:
    """Return the arrays of real numbers of a .npz file by name."""
    check_archive(path)
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            name = member.removesuffix(".npy")
            if name == member:
                continue
            with archive.open(member) as stream:
                first = npy.read_magic(stream) == (1, 0)
                read = npy.read_array_header_1_0 if first else npy.read_array_header_2_0
                shape, _, dtype = read(stream)
                stream.seek(0)
                if dtype.kind in "iufM":
                    check_count(f"{path}: {name}", prod(shape))
                    arrays[name] = npy.read_array(stream, allow_pickle=False)
                if dtype.kind == "M":  # s since 1970
                    arrays[name] = arrays[name].astype("M8[ns]").astype(float) / 1e9
    return arrays


def _of_mat(path: Path) -> Arrays:
    """Return the arrays of a .mat file by name, in MATLAB's shapes and in the file's order."""
    # Source: MATLAB, MAT-File Format, 2020. Damaged files end SciPy's reader in a segmentation
    # fault.
    data = path.read_bytes()
    if data.startswith((b"MATLAB 7.3", b"\x89HDF")):
        return _of_level_7(path)
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise InputError(f"{path}: no readable .mat file (save it with the option -v7)")
    arrays = Arrays()
    at = 128
    while at + 8 <= len(data):
        kind, body, at = _element(memoryview(data), at, order)
        if kind == "compressed":
            head = np.frombuffer(
                zlib.decompressobj().decompress(body, 64), dtype=order + "u4"
            ).tolist()
            # Dimensions come behind eight words.
            check_count(path, prod(head[8 : 8 + head[7] // 4]))
            kind, body, _ = _element(
                memoryview(zlib.decompressobj().decompress(body, MAX_BYTES)), 0, order
            )
        arrays |= _matrix(body, order) if kind == "matrix" else {}
    return arrays


def _element(view: memoryview, at: int, order: str) -> tuple[str, memoryview, int]:
    """Return kind and content of the data element at a position, and the next position."""
    kind, size = struct.unpack_from(order + "II", view, at)
    name = ELEMENTS.split()[kind & 0xFFFF]
    begin = at + 8
    after = begin + size + (0 if name == "compressed" else -size % 8)
    if kind >> 16:  # the size of a small one, which holds both in eight bytes
        size = kind >> 16
        begin = at + 4
        after = at + 8
    if begin + size > len(view):
        raise ValueError("an element reaches beyond its end")
    return name, view[begin : begin + size], after


def _matrix(body: memoryview, order: str) -> Arrays:
    """Return the values of a matrix element by name.

    The result is empty for texts, structures, cells and complex values.
    """
    at = 0
    parts = []
    for _ in range(3):
        _, part, at = _element(body, at, order)
        parts.append(part)
    flags, size, name = parts
    (word,) = struct.unpack_from(order + "I", flags)
    if not 6 <= word & 0xFF <= 15 or word & 0x800:  # double to uint64; complex
        return {}
    kind, values, _ = _element(body, at, order)
    shape = np.frombuffer(size, dtype=order + "u4").tolist()
    array = np.frombuffer(values, dtype=order + kind).reshape(shape, order="F")
    return {bytes(name).decode("ascii", "replace"): array}


def _of_level_7(path: Path) -> Arrays:
    """Return the arrays of one of MATLAB's HDF5 files, whose axes are reversed in the file."""
    arrays = {}
    try:
        with hdf5.existing_file(path) as file:
            for name in hdf5.children(file, "/"):
                dataset = file[name]
                text = hdf5.read_attribute(file, f"/{name}", "MATLAB_class") == "char"
                empty = hdf5.read_attribute(file, f"/{name}", "MATLAB_empty")
                if dataset.dtype.kind in "iuf" and dataset.shape and not text and not empty:
                    arrays[name] = hdf5.read_array(file, f"/{name}", len(dataset.shape)).T
    except InputError as error:
        raise InputError(f"{error}; save it with the option -v7 instead") from error
    return arrays


def _of_hdf5(path: Path) -> Arrays:
    """Return the arrays of an HDF5 file by their paths; of compound ones each field.

    Attributes of one number are arrays of one value.

    Raises InputError for lampest's own files, and if the values are more than are imported.
    """
    arrays = Arrays()
    with hdf5.existing_file(path) as file:
        if "lampest_format" in hdf5.attribute_names(file, "/"):
            raise InputError(f"{path}: is lampest's own file, which needs no import")
        datasets = hdf5.datasets(file, "/")
        for name, node in {"": file, **datasets}.items():
            for attribute, value in node.attrs.items():
                if isinstance(value, int | float | np.number):
                    arrays[f"{name}.{attribute}".lstrip(".")] = np.array([value])
        total = 0
        for name, dataset in datasets.items():
            fields = dataset.dtype.names
            if dataset.shape is None or not (fields or dataset.dtype.kind in "iuf"):
                continue
            total += dataset.size * max(1, dataset.dtype.itemsize // 8)
            check_count(path, total)
            if dataset.shape and not fields:
                arrays[name] = hdf5.read_array(file, f"/{name}", dataset.ndim)
                continue
            values = np.atleast_1d(dataset[()])
            parts = {f"{name}.{part}": values[part] for part in fields or ()} or {name: values}
            arrays |= {part: array for part, array in parts.items() if array.dtype.kind in "iuf"}
    return arrays


# They return arrays of real numbers only.
READERS = {".npy": _of_npy, ".npz": _of_npz, ".mat": _of_mat} | dict.fromkeys(
    (".h5", ".hdf5", ".hdf"), _of_hdf5
)


def arrays_of(path: Path) -> Arrays:
    """Return the arrays of a file by name. Raises InputError if it is damaged or too large."""
    with reading(path):
        return READERS[path.suffix.lower()](path)


def frames_of_arrays(path: Path, arrays: Arrays, shape: Shape, variable: str | None) -> Frames:
    """Return the frames of the only array that fits the panel, or of the array `variable`.

    The first layout that fits the shape of the array determines its axes. Frames after the number
    of frames that the file states, and frames of zeros at the end whose times are 0, were never
    written and are left out.

    Raises InputError if no array or several arrays fit.
    """
    matlab = path.suffix.lower() == ".mat"
    layouts = LAYOUTS_OF_MATLAB if matlab else LAYOUTS
    fits = {name: _fitting(array, shape, layouts) for name, array in arrays.items()}
    name = _chosen(path, arrays, fits, shape, variable)
    array = arrays[name]
    where = f"{path}: {name}" if name else str(path)
    if not fits[name]:
        ways = f"fits {shape[0]} × {shape[1]} cells in no way: {', '.join(layouts)}"
        raise InputError(f"{where}: is {_by(array.shape)}, which {ways}")
    check_count(where, array.size)
    layout, *alternatives = fits[name]
    number: Numbers = np.arange(array.size).reshape(array.shape)
    source = f"{where}[:, 0]"
    word = ""
    origin = ""
    times: Array | None = None
    if layout == TIMED:
        number = number[:, 1:]
        times = array[:, 0]
    elif layout == STACKED:
        number = number.transpose(2, 0, 1)
    number = number.reshape(-1, *shape)
    beside = None if layout == TIMED else _times_beside(arrays, name, len(number))
    if beside is not None:
        source = f"{path}: {beside}"
        word = _last(beside)
        origin = f"array {beside} in "
        times = arrays[beside].ravel()
    second = f" ({alternatives[0]} would fit, too)" if alternatives else ""
    note = f"{f'array {name} ' if name else ''}read as {layout}{second}"
    values = array.ravel().astype(float)
    values[np.isnan(values)] = np.nan  # a signalling NaN would raise warnings in arithmetic
    written, unwritten = _written(arrays, values[number], times)

    def named(at: int) -> str:
        index = ", ".join(str(part + matlab) for part in np.unravel_index(max(at, 0), array.shape))
        return f"{where}({index})" if matlab else f"{where}[{index}]"

    def clock(unit: str | None) -> Clock:
        assert times is not None
        of_frames = np.asarray(times[:written], dtype=float)
        read = clock_of_numbers(of_frames, word, lambda frame: f"{source}[{frame}]", unit)
        return read.read_from(origin)

    timing = None if times is None else clock
    return Frames(values, number[:written], named, timing, (note, *unwritten), (name,))


def _last(name: str) -> str:
    """Return the name of an array without the groups that hold it."""
    return re.split(r"[/.]|: ", name)[-1]


def _fitting(array: NDArray[Any], shape: Shape, layouts: Sequence[str]) -> list[str]:
    """Return those of the layouts in which an array holds frames of a panel, in their order."""
    cells = shape[0] * shape[1]
    first, last = (array.shape[0], array.shape[-1]) if array.ndim else (0, 0)
    sizes = {
        ONE: shape,
        FRAMES: (first, *shape),
        FLAT: (first, cells),
        TIMED: (first, cells + 1),
        STACKED: (*shape, last),
    }
    fitting = [layout for layout in layouts if array.size and array.shape == sizes[layout]]
    if TIMED in fitting:
        # the first column has to grow, but for frames at the end that are 0
        times = np.trim_zeros(np.asarray(array[:, 0], dtype=float), "b")
        if len(times) < 2 or not grows(times):
            fitting.remove(TIMED)
    return fitting


def _times_beside(arrays: Arrays, name: str, frames: int) -> str | None:
    """Return the name of the times of an array, first of those in its group; None without any."""
    group = name.rpartition("/")[0]
    fitting = [
        time
        for time in arrays
        if role_of(_last(time)) == "time" and arrays[time].size == frames and time != name
    ]
    return min(fitting, key=lambda time: time.rpartition("/")[0] != group, default=None)


def _written(arrays: Arrays, values: Array, times: Array | None) -> tuple[int, tuple[str, ...]]:
    """Return how many frames were written, and a note on those that were not."""
    count = len(values)
    for name, array in arrays.items():
        words = set(re.findall(r"[a-z]+", _last(name).lower()))
        if array.size == 1 and words & COUNTS and array.item() in range(1, count):
            written = int(array.item())
            left = counted(count - written, "frame")
            return written, (f"{left} behind the {written} of {name} left out",)
    if times is None:
        return count, ()
    filled = np.flatnonzero((times != 0) | np.any(values != 0, axis=(1, 2)))
    last = int(filled[-1]) + 1 if len(filled) else count
    note = f"{counted(count - last, 'frame')} of zeros at the end, without a time, left out"
    return last, (note,) if last < count else ()


def _chosen(
    path: Path, arrays: Arrays, fits: dict[str, list[str]], shape: Shape, variable: str | None
) -> str:
    """Return the name of the requested array, or of the only one that fits."""
    if variable is not None:
        if variable in arrays:
            return variable
        raise InputError(
            f"{path}: no numeric array '{variable}'; there are {', '.join(arrays) or 'none'}"
        )
    chosen = [name for name in arrays if fits[name] or name == ""]
    if len(chosen) > 1:
        raise InputError(f"{path}: {', '.join(chosen)} would all fit; say which with `variable`")
    if chosen:
        return chosen[0]
    listed = ", ".join(f"{name} ({_by(array.shape)})" for name, array in arrays.items())
    raise InputError(
        f"{path}: no array fits {shape[0]} × {shape[1]} cells; "
        f"the numeric arrays are: {listed or 'none'}"
    )


def _by(size: Sequence[int]) -> str:
    """Return a shape in words, such as '2 × 3'."""
    return " × ".join(map(str, size)) or "one value"
