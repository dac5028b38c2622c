"""Seals of files of older versions: digests of all bytes, piece by piece, behind the end that HDF5 sees.

A line for every piece: where it begins, its length, the first half of its SHA-256, and what it holds; then the same of
the seal itself. Another program that changes such a file cuts it off.
"""

import hashlib
import re
from pathlib import Path
from typing import BinaryIO

from lampest.files.errors import InputError

MARK = b"\n# lampest seal 1: begin, length, SHA-256 (first half), what it holds\n"
LAST = re.compile(rb"end ([0-9a-f]{32}) (\d{16})\n")
LENGTH_OF_LAST = 54
LINE = re.compile(r"(\d{1,16}) (\d{1,16}) ([0-9a-f]{32}) (.+)")
MOST_AT_OPENING = 2**26  # bytes: what holds more is left to HDF5's own checksums, unless all is asked for
END_IN_SUPERBLOCK = slice(40, 48)  # of version 0, which such files have


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
    stream.seek(0)
    end = int.from_bytes(stream.read(END_IN_SUPERBLOCK.stop)[END_IN_SUPERBLOCK], "little")
    stream.seek(min(end, size))
    return end > 0 and any(sign == mark for sign, mark in zip(stream.read(len(MARK)), MARK, strict=False))


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]
