"""Integrity of HDF5 files: SHA-256 digests of all values, in addition to HDF5's own checksums.

HDF5's Fletcher sum of a chunk notices turned bits. The sum of zeros is zero, and no sum depends on
the position: a chunk that is zeroed, exchanged with another one, or taken from another file passes
the test. `seal` therefore writes the digest of every block of values, with the place of the block,
next to its dataset, and the digest of all datasets next to the root.

A file whose writer was killed remains marked as being written (SWMR). HDF5 would open it as a
growing file, and wait without end for a wrong checksum to be corrected. `Closed` presents such a
file as a closed one.
"""

import hashlib
import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import Dataset, File, Group
from numpy.typing import NDArray

from lampest.files.errors import InputError

DIGEST = "sha256"  # attribute with the digest of one text or, of a text in older files, beside it
# Attribute of a dataset: for each block of its first axis "first row:digest".
BLOCKS = f"blocks_{DIGEST}"
# Attribute of the root: digest of the paths and the blocks of all datasets.
DATASETS = f"datasets_{DIGEST}"
# Chunks of a dataset: a day at 100 frames a second has half a million while it is recorded.
MAX_CHUNKS = 10_000_000
MAX_ATTRIBUTE_BYTES = 4_000  # HDF5 may store larger ones without a checksum
# Superblock of version 3: signature, version, two sizes, flags, base, extension, end of the file,
# root, checksum.
SUPERBLOCK = struct.Struct("<8sBBBBQQQQI")
WRITTEN = 1  # flag of a superblock: a process writes the file
SWMR = 4  # flag of a superblock: other processes may read the file meanwhile


@contextmanager
def located(file: File, path: str) -> Iterator[None]:
    """Convert any exception of the library about a damaged object into an InputError.

    The InputError names the object.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        wrong = "checksum or packing of its values is wrong"
        reason = " ".join(str(error).split()).replace("filter returned failure during read", wrong)
        raise InputError(f"{file.filename}: {path} is damaged ({reason})") from error


@dataclass(frozen=True)
class Integrity:
    """Result of the verification of a whole file.

    Attributes
    ----------
    datasets : int
        Number of datasets with values.
    without_digest : tuple of str
        Paths of datasets that HDF5's checksums alone protect: against turned bits, not against
        zeros or exchange.
    without_checksum : tuple of str
        Paths of datasets that nothing protects.
    """

    datasets: int
    without_digest: tuple[str, ...]
    without_checksum: tuple[str, ...]


def digest_of(values: NDArray[Any]) -> str:
    """Return the SHA-256 of all bytes of an array."""
    return hashlib.sha256(values.tobytes()).hexdigest()


def check_digest(attributes: Any, value: Any, name: str = "") -> None:
    """Raise ValueError if a value differs from its digest.

    `name` is that of an attribute, or '' for a dataset.
    """
    label = f"{name}_{DIGEST}" if name else DIGEST
    # Most values have none; `get` takes ten times as long to find that.
    if label not in attributes:
        return
    if digest_of(np.asarray(value)).encode() != np.asarray(attributes[label]).item():
        raise ValueError("values and checksum differ")


def set_attribute(
    node: Any,
    name: str,
    data: NDArray[Any],
    kinds: tuple[Any, Any] | None = None,
    path: bytes = b".",
) -> None:
    """Write an attribute of the object at a path from an h5py identifier.

    It replaces an earlier one and its digest. The SHA-256 of a large one is written as a further
    one. `kinds` are its HDF5 types in the file and in memory, by default those of its elements.
    """
    # The functions beneath `h5py.AttributeManager`, which takes three times as long.
    for label in (name.encode(), f"{name}_{DIGEST}".encode()):
        if not h5py.h5a.exists(node, label, obj_name=path):
            break
        h5py.h5a.delete(node, label, obj_name=path)
    if data.nbytes > MAX_ATTRIBUTE_BYTES and not data.dtype.hasobject:
        digest = np.asarray(np.bytes_(digest_of(data)))
        set_attribute(node, f"{name}_{DIGEST}", digest, path=path)
    in_file, in_memory = kinds or types_of(data.dtype)
    space = h5py.h5s.create_simple(data.shape)
    written = h5py.h5a.create(node, name.encode(), in_file, space, obj_name=path)
    written.write(np.ascontiguousarray(data).reshape(data.shape), in_memory)


def types_of(dtype: np.dtype[Any]) -> tuple[Any, Any]:
    """Return the HDF5 types of an array's elements in a file and in memory."""
    return h5py.h5t.py_create(dtype, logical=True), h5py.h5t.py_create(dtype)


def attribute(node: Any, name: str, path: bytes = b".") -> NDArray[Any] | None:
    """Return an attribute of the object at a path from an h5py identifier; None if absent."""
    if not h5py.h5a.exists(node, name.encode(), obj_name=path):
        return None
    held = h5py.h5a.open(node, name.encode(), obj_name=path)
    data = np.empty(held.shape, held.dtype)
    held.read(data, None if data.dtype.hasobject else types_of(data.dtype)[1])
    return data


def set_digests(dataset: Dataset, values: Any) -> None:
    """Write the digests of a dataset's values next to it, block by block: by chunks, or as a whole.

    `values` are all its values, or the dataset itself, whose values are then read.
    """
    length = (*dataset.shape, 1)[0]
    step = dataset.chunks[0] if dataset.chunks else length
    entries = [
        _entry(first, values[first : first + step] if dataset.shape else values[()])
        for first in range(0, length, step)
    ]
    set_attribute(dataset.id, BLOCKS, np.array(entries, dtype="S"))


def seal(file: File) -> None:
    """Write the digest of all datasets of a complete file, and those that datasets lack."""
    total = hashlib.sha256()
    for name in names_below(file):  # in the order of `nodes_below`
        entries = attribute(file.id, BLOCKS, name)
        node = None if entries is not None else file[name]
        if isinstance(node, Dataset) and node.size and not node.dtype.hasobject:
            set_digests(node, node)
            entries = attribute(file.id, BLOCKS, name)
        if entries is not None:
            _add_dataset(total, "/" + name.decode("utf-8", "surrogateescape"), entries)
    set_attribute(file.id, DATASETS, np.asarray(np.bytes_(total.hexdigest())))


def read_verified(dataset: Dataset, part: slice = slice(None)) -> Any:
    """Return the values of a dataset, or a part of its first axis.

    Raises ValueError if they differ from a digest. The blocks that contain the part are read as a
    whole. Without digests the values are returned as they are.
    """
    if BLOCKS not in dataset.attrs:
        values = dataset[part] if dataset.shape else dataset[()]
        if dataset.chunks is None and part == slice(None):
            check_digest(dataset.attrs, values)
        return values
    return _read_blocks(dataset, _entries(dataset), part)


def _read_blocks(dataset: Dataset, entries: dict[int, bytes], part: slice) -> Any:
    """Return the values of a dataset with the digests `entries`, as `read_verified`."""
    if dataset.shape:
        begin, end, _ = part.indices(len(dataset))
        edges = pairwise([*entries, len(dataset)])
        inside = [(first, last) for first, last in edges if first < end and last > begin]
        start = inside[0][0] if inside else begin
        values = dataset[start : inside[-1][1] if inside else end]
        blocks = {first: values[first - start : last - start] for first, last in inside}
        values = values[begin - start : max(end, begin) - start]
    else:
        values = dataset[()]
        blocks = {0: values}
    for first, block in blocks.items():
        if _entry(first, block) != entries[first]:
            raise ValueError(f"values from row {first} on and their digest differ")
    return values


def check_chunks(dataset: Dataset) -> None:
    """Raise ValueError if a dataset declares more than MAX_CHUNKS chunks.

    HDF5 would visit all of them.
    """
    if dataset.chunks:
        sizes = zip(dataset.shape, dataset.chunks, strict=True)
        count = prod(-(-size // part) for size, part in sizes)
        if count > MAX_CHUNKS:
            raise ValueError(f"it declares {count} chunks; more than {MAX_CHUNKS} are not read")


def verified_blocks(dataset: Dataset) -> Iterator[tuple[Any, Any]]:
    """Yield all values of a dataset by blocks, with their place.

    Raises ValueError if they differ from a digest, or are in too many chunks.
    """
    check_chunks(dataset)
    if dataset.shape and BLOCKS in dataset.attrs:
        entries = _entries(dataset)
        for first, last in pairwise([*entries, len(dataset)]):
            yield slice(first, last), _read_blocks(dataset, entries, slice(first, last))
    elif dataset.chunks:
        for chunk in dataset.iter_chunks():
            yield chunk, dataset[chunk]
    elif dataset.size:
        yield (), read_verified(dataset)


def _entries(dataset: Dataset) -> dict[int, bytes]:
    """Return the entries of `BLOCKS` by the first row of their block.

    Raises ValueError if they are damaged.
    """
    held = dataset.attrs[BLOCKS]
    check_digest(dataset.attrs, held, BLOCKS)
    return {int(entry.partition(b":")[0]): entry for entry in np.atleast_1d(held).tolist()}


def _entry(first: int, values: Any) -> bytes:
    """Return 'first row:SHA-256 of first row, type, shape and bytes' of a block."""
    block = np.asarray(values)
    digest = hashlib.sha256(f"{first} {block.dtype.str} {block.shape} ".encode())
    # The view copies nothing, because blocks may be large.
    digest.update(np.ascontiguousarray(block).reshape(-1).view(np.uint8).data)
    return f"{first}:{digest.hexdigest()}".encode()


def digests_below(group: Group) -> dict[str, bytes]:
    """Return the digests of the datasets below a group by their paths in it."""
    entries = {name: attribute(group.id, BLOCKS, name) for name in names_below(group)}
    return {name.decode(): held.tobytes() for name, held in entries.items() if held is not None}


def names_below(group: Group) -> list[bytes]:
    """Return the paths of all objects in a group, which are not opened."""
    names = list[bytes]()
    h5py.h5o.visit(group.id, names.append)
    return names


def _add_dataset(total: Any, path: str, entries: NDArray[Any]) -> None:
    """Add the path of a dataset and the digests of its blocks to the digest of all datasets."""
    total.update(path.encode("utf-8", "surrogateescape") + b" " + entries.tobytes())


def check_datasets(file: File) -> None:
    """Raise InputError if datasets were exchanged or removed, as by the header of another file.

    No values are read. Files of older versions have no digest of all datasets.
    """
    total = hashlib.sha256()
    for path, node in nodes_below(file, "/"):
        with located(file, path):
            entries = attribute(node.id, BLOCKS) if isinstance(node, Dataset) else None
        if entries is not None:
            _add_dataset(total, path, entries)
    with located(file, f"/@{DATASETS}"):
        expected = file.attrs.get(DATASETS)
    if expected is not None and expected != total.hexdigest().encode():
        raise InputError(
            f"{file.filename}: datasets were added, removed or exchanged after the file was written"
        )


def read_through(file: File) -> Integrity:
    """Read and verify all values of a file.

    Raises InputError with the path of the first damaged dataset, or if datasets were exchanged or
    removed.
    """
    datasets = 0
    without_digest = []
    without_checksum = []
    for path, node in nodes_below(file, "/"):
        with located(file, path):
            for name, value in node.attrs.items():
                check_digest(node.attrs, value, name)
            protected = h5py.h5o.get_info(node.id).hdr.version > 1
            if isinstance(node, Dataset) and node.size:
                datasets += 1
                for _ in verified_blocks(node):
                    pass
                if BLOCKS not in node.attrs:
                    without_digest.append(path)
                    # A digest or one of HDF5's checksums covers the values.
                    compact = node.id.get_create_plist().get_layout() == h5py.h5d.COMPACT
                    protected &= compact or node.fletcher32 or DIGEST in node.attrs
            if not protected:
                without_checksum.append(path)
    check_datasets(file)
    return Integrity(datasets, tuple(without_digest), tuple(without_checksum))


def nodes_below(file: File, path: str) -> Iterator[tuple[str, Any]]:
    """Yield (path, group or dataset) of a group and of everything within it.

    Links to other files are not followed.
    """
    with located(file, path):
        group = file[path]
        links = {name: group.get(name, getlink=True) for name in group}
    yield path, group
    for name in (name for name, link in links.items() if isinstance(link, h5py.HardLink)):
        inner = f"{path.rstrip('/')}/{name}"
        with located(file, inner):
            node = file[inner]
        if isinstance(node, Group):
            yield from nodes_below(file, inner)
        else:
            yield inner, node


def _superblock(path: Path) -> tuple[Any, ...]:
    """Return the fields of a file's superblock, (0, ...) for a shorter file."""
    with path.open("rb") as stream:
        head = stream.read(SUPERBLOCK.size)
    return SUPERBLOCK.unpack(head) if len(head) == SUPERBLOCK.size else (0,) * 10


def is_left_open(path: Path) -> bool:
    """Return whether a file has an intact superblock that marks it as being written."""
    fields = _superblock(path)
    return bool(fields[4] & SWMR) and fields[9] == lookup3(SUPERBLOCK.pack(*fields))


def bytes_beyond(path: Path) -> int:
    """Return the number of bytes after the end that the superblock of a closed file states."""
    fields = _superblock(path)
    return 0 if fields[1] < 2 or fields[4] & SWMR else path.stat().st_size - int(fields[7])


def marked_as_written(data: bytes) -> bytes:
    """Return the bytes of a superblock that says SWMR with the flag of its writer as well.

    HDF5 sets that flag only for its own files, and other processes read with both flags alone.
    Other bytes are returned unchanged.
    """
    fields = SUPERBLOCK.unpack(data) if len(data) == SUPERBLOCK.size else (0,) * 10
    if fields[:2] != (b"\x89HDF\r\n\x1a\n", 3) or fields[4] != SWMR:
        return data
    return _with_flags(list(fields), SWMR | WRITTEN)


def _with_flags(fields: list[Any], flags: int) -> bytes:
    """Return a superblock with other flags, and its checksum."""
    fields[4] = flags
    fields[9] = lookup3(SUPERBLOCK.pack(*fields))
    return SUPERBLOCK.pack(*fields)


class Closed(io.FileIO):
    """File left open by its writer, read as if it had been closed.

    The file on disk remains unchanged.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "rb")
        fields = list(_superblock(path))
        fields[7] = path.stat().st_size
        self._head = _with_flags(fields, 0)
        self._path = path

    def __repr__(self) -> str:
        """Return the name that h5py shows for the file."""
        return str(self._path)

    def readinto(self, buffer: Any) -> int | None:
        """Read bytes from the current position; the superblock reads as that of a closed file."""
        begin = self.tell()
        count = super().readinto(buffer)
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
        a = a + words[first]
        b = b + words[first + 1]
        c = c + words[first + 2]
        for shift in (4, 6, 8, 16, 19, 4):
            a, b, c = b, c + b, (a - c) ^ rotated(c, shift)
    a = a + words[9]
    b = b + words[10]
    for shift in (14, 11, 25, 16, 4, 14, 24):
        a, b, c = b, (c ^ b) - rotated(b, shift), a
    return b % 2**32
