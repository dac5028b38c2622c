"""Integrity of HDF5 files: HDF5's own checksums, and SHA-256 digests of values that these do not cover.

A file whose writer was killed remains marked as being written (SWMR). HDF5 would open it as a growing file, and wait
without end for a wrong checksum to be corrected. `Closed` presents such a file as a closed one.
"""

import hashlib
import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError

DIGEST = "sha256"  # attribute with the digest of values that are neither in the metadata nor in chunks
# Superblock of version 3: signature, version, two sizes, flags, base, extension, end of the file, root, checksum.
SUPERBLOCK = struct.Struct("<8sBBBBQQQQI")


@contextmanager
def located(file: h5py.File, path: str) -> Iterator[None]:
    """Convert any exception of the library about a damaged object into an InputError that names the object."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        wrong = "checksum or packing of its values is wrong"
        reason = " ".join(str(error).split()).replace("filter returned failure during read", wrong)
        raise InputError(f"{file.filename}: {path} is damaged ({reason})") from error


def digest_of(values: NDArray[Any]) -> str:
    """Return the SHA-256 of all bytes of an array."""
    return hashlib.sha256(values.tobytes()).hexdigest()


def check_digest(attributes: Any, value: Any, name: str = "") -> None:
    """Raise ValueError if a value differs from its digest; `name` is that of an attribute, or '' for a dataset."""
    digest = attributes.get(f"{name}_{DIGEST}" if name else DIGEST)
    if digest is not None and digest_of(np.asarray(value)).encode() != digest:
        raise ValueError("values and checksum differ")


def read_through(file: h5py.File) -> tuple[int, bool]:
    """Read all values of a file; return the number of datasets, and whether checksums cover all of the file.

    Raises InputError with the path of the first damaged dataset.
    """
    covered, datasets = True, 0
    for path, node in nodes_below(file, "/"):
        with located(file, path):
            covered &= h5py.h5o.get_info(node.id).hdr.version > 1
            for name, value in node.attrs.items():
                check_digest(node.attrs, value, name)
            if isinstance(node, h5py.Dataset) and node.size:
                covered &= _read_values(node)
                datasets += 1
    return datasets, covered


def nodes_below(file: h5py.File, path: str) -> Iterator[tuple[str, Any]]:
    """Yield (path, group or dataset) of a group and of everything within it; links to other files are not followed."""
    with located(file, path):
        group = file[path]
        links = {name: group.get(name, getlink=True) for name in group}
    yield path, group
    for name in (name for name, link in links.items() if isinstance(link, h5py.HardLink)):
        inner = f"{path.rstrip('/')}/{name}"
        with located(file, inner):
            node = file[inner]
        if isinstance(node, h5py.Group):
            yield from nodes_below(file, inner)
        else:
            yield inner, node


def _read_values(dataset: h5py.Dataset) -> bool:
    """Read all values chunk by chunk; return whether a checksum covers them."""
    for chunk in dataset.iter_chunks() if dataset.chunks else ():
        dataset[chunk]
    if not dataset.chunks:
        check_digest(dataset.attrs, dataset[()])
    compact = dataset.id.get_create_plist().get_layout() == h5py.h5d.COMPACT
    return compact or dataset.fletcher32 or DIGEST in dataset.attrs


def _superblock(path: Path) -> tuple[Any, ...]:
    """Return the fields of a file's superblock, (0, ...) for a shorter file."""
    with path.open("rb") as stream:
        head = stream.read(SUPERBLOCK.size)
    return SUPERBLOCK.unpack(head) if len(head) == SUPERBLOCK.size else (0,) * 10


def is_left_open(path: Path) -> bool:
    """Return whether a file has an intact superblock that marks it as being written."""
    fields = _superblock(path)
    return bool(fields[4] & 4) and fields[9] == lookup3(SUPERBLOCK.pack(*fields))


def bytes_beyond(path: Path) -> int:
    """Return the number of bytes after the end that the superblock of a closed file states."""
    fields = _superblock(path)
    return 0 if fields[1] < 2 or fields[4] & 4 else path.stat().st_size - int(fields[7])


class Closed(io.FileIO):
    """File left open by its writer, read as if it had been closed; the file on disk remains unchanged."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "rb")
        fields = list(_superblock(path))
        fields[4], fields[7] = 0, path.stat().st_size
        fields[9] = lookup3(SUPERBLOCK.pack(*fields))
        self._head = SUPERBLOCK.pack(*fields)
        self._path = path

    def __repr__(self) -> str:
        """Return the name that h5py shows for the file."""
        return str(self._path)

    def readinto(self, buffer: Any) -> int | None:
        """Read bytes from the current position; the superblock reads as that of a closed file."""
        begin, count = self.tell(), super().readinto(buffer)
        head = self._head[begin : begin + (count or 0)]
        memoryview(buffer).cast("B")[: len(head)] = head
        return count


def lookup3(superblock: bytes) -> int:
    """Return HDF5's checksum of the first 44 bytes. Source: Jenkins, lookup3.c, 2006."""
    words: tuple[int, ...] = struct.unpack("<11I", superblock[:44])
    a = b = c = 0xDEADBEEF + 44

    def rotated(word: int, shift: int) -> int:
        word %= 2**32
        return word << shift | word >> 32 - shift

    for first in range(0, 9, 3):
        a, b, c = a + words[first], b + words[first + 1], c + words[first + 2]
        for shift in (4, 6, 8, 16, 19, 4):
            a, b, c = b, c + b, (a - c) ^ rotated(c, shift)
    a, b = a + words[9], b + words[10]
    for shift in (14, 11, 25, 16, 4, 14, 24):
        a, b, c = b, (c ^ b) - rotated(b, shift), a
    return b % 2**32
