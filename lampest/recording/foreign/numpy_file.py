"""NumPy's .npy and .npz files as arrays by name."""

import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.recording.foreign.archive import check_archive
from lampest.recording.foreign.frames import check_count

ArraysByName = dict[str, NDArray[Any]]


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
                array = _array(stream, part.file_size)
            if array is not None:
                arrays[part.filename.removesuffix(".npy")] = array
    return arrays


def _array(stream: Any, size: int) -> NDArray[Any] | None:
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
