"""Whether a file holds what was written: HDF5's own checksums, digests where they do not reach, seals of older files.

A seal is text behind the end that HDF5 sees: a line for every piece of the file with where it begins, its length, the
first half of its SHA-256, and what it holds; then the same of the seal itself. Another program that changes such a file
cuts it off.
"""

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError

DIGEST = "sha256"  # attribute: of values that stand outside of the metadata and in no chunk
FILTER_FAILED = "filter returned failure during read"  # of HDF5
MARK = b"\n# lampest seal 1: begin, length, SHA-256 (first half), what it holds\n"
LAST = re.compile(rb"end ([0-9a-f]{32}) (\d{16})\n")
LENGTH_OF_LAST = 54
LINE = re.compile(r"(\d{1,16}) (\d{1,16}) ([0-9a-f]{32}) (.+)")
MOST_AT_OPENING = 2**26  # bytes: what holds more is left to HDF5's own checksums, unless all is asked for
SUPERBLOCK_0 = b"\x89HDF\r\n\x1a\n\0"
END_IN_SUPERBLOCK = slice(40, 48)  # of version 0, which such files have


@contextmanager
def located(file: h5py.File, path: str) -> Iterator[None]:
    """Turns what the library says of a damaged place into one InputError that names it."""
    try:
        yield
    except InputError:
        raise
    except (
        OSError,
        RuntimeError,
        LookupError,
        ValueError,
        TypeError,
        AttributeError,
        ArithmeticError,
        MemoryError,
    ) as error:
        said = " ".join(str(error).split()).replace(FILTER_FAILED, "checksum or packing of its values is wrong")
        raise InputError(f"{file.filename}: {path} is damaged ({said})") from error


def digest_of(values: NDArray[Any]) -> str:
    """SHA-256 of all bytes."""
    return hashlib.sha256(values.tobytes()).hexdigest()


def check_digest(dataset: h5py.Dataset, values: Any) -> None:
    """Raise ValueError where all values of a dataset are not those of its digest; those in chunks have none."""
    if dataset.chunks is not None or DIGEST not in dataset.attrs:
        return
    if digest_of(np.asarray(values, dataset.dtype)).encode() != dataset.attrs[DIGEST]:
        raise ValueError("values and checksum differ")


def check_attribute(attributes: Any, name: str, value: Any) -> None:
    """Raise ValueError where an attribute is not that of the digest beside it; small ones have none."""
    beside = f"{name}_{DIGEST}"
    if beside in attributes and digest_of(np.asarray(value)).encode() != attributes[beside]:
        raise ValueError("value and checksum differ")


def read_through(file: h5py.File) -> tuple[int, bool]:
    """(number of datasets, whether checksums vouch for all of the file), read to the last value.

    Raises InputError with the path of the dataset that is not what was written.
    """
    vouched, datasets = [], 0
    for path, node in _all_below(file, "/"):
        with located(file, path):
            vouched.append(h5py.h5o.get_info(node.id).hdr.version > 1)
            for name, value in node.attrs.items():
                check_attribute(node.attrs, name, value)
            if isinstance(node, h5py.Dataset) and node.size:
                vouched.append(_read_values(node))
                datasets += 1
    return datasets, all(vouched)


def _all_below(file: h5py.File, path: str) -> Iterator[tuple[str, Any]]:
    """(path, group or dataset) of a group and all that it holds, but for what lies in other files."""
    with located(file, path):
        group = file[path]
        links = {name: group.get(name, getlink=True) for name in group}
    yield path, group
    for name in (name for name, link in links.items() if isinstance(link, h5py.HardLink)):
        inner = f"{path.rstrip('/')}/{name}"
        with located(file, inner):
            node = file[inner]
        if isinstance(node, h5py.Group):
            yield from _all_below(file, inner)
        else:
            yield inner, node


def _read_values(dataset: h5py.Dataset) -> bool:
    """Read all values, part by part; whether a checksum vouches for them."""
    for part in dataset.iter_chunks() if dataset.chunks else ((),):
        check_digest(dataset, dataset[part])
    compact = dataset.id.get_create_plist().get_layout() == h5py.h5d.COMPACT
    return compact or dataset.fletcher32 or DIGEST in dataset.attrs


def check_seal(path: Path, everything: bool = False) -> bool:
    """Whether a file has a seal; then its pieces are what was written.

    everything : also large ones. Raises InputError where a piece is another, with the path of the dataset, or the seal
    itself is damaged; OSError where the file cannot be read.
    """
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(size - LENGTH_OF_LAST, 0))
        last = LAST.fullmatch(stream.read())
        if last is None and not _begins(stream, size):
            if 0 < _end(stream) < size:
                raise InputError(f"{path}: is damaged: what stands behind its end are no checksums")
            return False
        stream.seek(max(size - int(last[2]), 0) if last else size)
        text = stream.read()[:-LENGTH_OF_LAST]
        lines = [LINE.fullmatch(line) for line in text[len(MARK) :].decode("utf-8", "replace").splitlines()]
        if last is None or not text.startswith(MARK) or _digest(text) != last[1].decode() or None in lines:
            raise InputError(f"{path}: the checksums at its end are damaged, so that nothing says whether the rest is")
        for begin, length, digest, what in (line.groups() for line in lines if line is not None):
            stream.seek(int(begin))
            if (everything or int(length) <= MOST_AT_OPENING) and _digest(stream.read(int(length))) != digest:
                raise InputError(
                    f"{path}: {what} is damaged: the {length} bytes from {begin} on are not those that were written "
                    "(checksum)"
                )
    return True


def _begins(stream: BinaryIO, size: int) -> bool:
    """Whether a seal begins where HDF5 ends."""
    end = _end(stream)
    stream.seek(min(end, size))
    return end > 0 and any(sign == mark for sign, mark in zip(stream.read(len(MARK)), MARK, strict=False))


def _end(stream: BinaryIO) -> int:
    """Where HDF5 ends, as the superblock of an older file says; 0 of any other."""
    stream.seek(0)
    head = stream.read(END_IN_SUPERBLOCK.stop)
    return int.from_bytes(head[END_IN_SUPERBLOCK], "little") if head.startswith(SUPERBLOCK_0) else 0


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]
