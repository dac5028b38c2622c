"""HDF5 files whose writer was killed: their superblock says that they are being written (SWMR), for ever.

HDF5 would open such a file only as one that grows, and there it waits without end for a checksum that is wrong.
"""

import io
import struct
from pathlib import Path
from typing import Any

WORD = 0xFFFFFFFF
# Of version 3: signature, version, two sizes, flags, base, extension, end of the file, root, checksum.
SUPERBLOCK = struct.Struct("<8sBBBBQQQQI")
BEING_WRITTEN = 4


def is_left_open(path: Path) -> bool:
    """Whether a file's superblock is whole and says that the file is being written."""
    with path.open("rb") as stream:
        head = stream.read(SUPERBLOCK.size)
    return (
        len(head) == SUPERBLOCK.size
        and bool(head[11] & BEING_WRITTEN)
        and head[-4:] == struct.pack("<I", lookup3(head))
    )


class Closed(io.FileIO):
    """A file that was left open as if it had been closed; what is on the disk stays."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "rb")
        fields = list(SUPERBLOCK.unpack(super().read(SUPERBLOCK.size)))
        fields[4], fields[7] = 0, path.stat().st_size
        fields[9] = lookup3(SUPERBLOCK.pack(*fields))
        self._head = SUPERBLOCK.pack(*fields)
        self._path = path

    def __repr__(self) -> str:
        """What h5py calls the file."""
        return str(self._path)

    def readinto(self, buffer: Any) -> int | None:
        """Bytes from where the file stands, the superblock as of a closed file."""
        begin, count = self.tell(), super().readinto(buffer)
        head = self._head[begin : begin + (count or 0)]
        memoryview(buffer).cast("B")[: len(head)] = head
        return count


def lookup3(superblock: bytes) -> int:
    """HDF5's checksum of the first 44 bytes. Source: Jenkins, lookup3.c, 2006."""
    words: tuple[int, ...] = struct.unpack("<11I", superblock[:44])
    a = b = c = 0xDEADBEEF + 44
    for first in range(0, 9, 3):
        a, b, c = (a + words[first]) & WORD, (b + words[first + 1]) & WORD, (c + words[first + 2]) & WORD
        for shift in (4, 6, 8, 16, 19, 4):
            a, b, c = b, (c + b) & WORD, (a - c & WORD) ^ _turned(c, shift)
    a, b = (a + words[9]) & WORD, (b + words[10]) & WORD
    for shift in (14, 11, 25, 16, 4, 14, 24):
        a, b, c = b, ((c ^ b) - _turned(b, shift)) & WORD, a
    return b


def _turned(word: int, shift: int) -> int:
    return (word << shift | word >> 32 - shift) & WORD
