"""The real numeric arrays of MATLAB's .mat files: of level 5 (options -v6 and -v7) here, of 7.3 next door.

SciPy's reader ends the whole process on some damaged files; this one checks every size before it is used.
"""

import struct
import zlib
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.recording.foreign.frames import check_count
from lampest.recording.foreign.matlab_hdf5 import arrays_of_level_7

HEADER = 128
MOST_BYTES = 400_000_000
MATRIX, COMPRESSED = 14, 15
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
NUMERIC_CLASSES = range(6, 16)  # double, single, int8 ... uint64
COMPLEX = 0x800
BEGINNING = 4096  # of a matrix, which holds its dimensions


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Name → array in MATLAB's shape, in the file's order; texts, structures and complex arrays are left out.

    Raises InputError where the file is of another kind or damaged. Source: MATLAB, MAT-File Format, 2020.
    """
    data = path.read_bytes()
    if data.startswith((b"MATLAB 7.3", b"\x89HDF")):
        return arrays_of_level_7(path)
    order = {b"IM": "<", b"MI": ">"}.get(data[HEADER - 2 : HEADER])
    if order is None:
        raise InputError(f"{path}: no readable .mat file (save it with the option -v7)")
    arrays, rest = {}, MOST_BYTES
    try:
        for kind, body in _elements(memoryview(data)[HEADER:], order):
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
