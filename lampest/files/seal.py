"""The seal of a file: digests of all its bytes, piece by piece, behind its end.

HDF5 takes no notice of what stands behind its end, and cuts it off when another program changes the file: such a file
has no seal and is read as those of older versions are. The seal is text, a line for every piece: where it begins, its
length, the first half of its SHA-256, and what it holds; then the same of the seal itself.
"""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

from lampest.files.errors import InputError, printable

MARK = b"\n# lampest seal 1: begin, length, SHA-256 (first half), what it holds\n"
LAST = re.compile(rb"end ([0-9a-f]{32}) (\d{16})\n")
LENGTH_OF_LAST = 54
LINE = re.compile(r"(\d{1,16}) (\d{1,16}) ([0-9a-f]{32}) (.+)")
AT_ONCE = 2**20
# What holds more is left to HDF5's own checksums of its blocks, unless all is asked for: a tenth of a second's reading.
MOST_AT_OPENING = 2**26
END_IN_SUPERBLOCK = slice(40, 48)  # of version 0, which all our files have


@dataclass(frozen=True)
class Extent:
    """Bytes begin to begin + length of a file: values of the dataset `path`; of no length: where its header begins."""

    path: str
    begin: int
    length: int = 0


@dataclass(frozen=True)
class Piece:
    """Some bytes of a file, their digest, and what they hold in words."""

    begin: int
    length: int
    digest: str
    what: str


def seal_of(stream: BinaryIO, extents: Sequence[Extent]) -> bytes:
    """The seal of a file's bytes, of which the extents say what they hold."""
    lines = [
        f"{begin} {end - begin} {_digest(stream, begin, end - begin)} {printable(what)}\n"
        for begin, end, what in _partition(stream.seek(0, 2), extents)
    ]
    text = MARK + "".join(lines).encode("utf-8")
    return text + f"end {_short(hashlib.sha256(text))} {len(text) + LENGTH_OF_LAST:016d}\n".encode("ascii")


def check_seal(path: Path, everything: bool = False) -> tuple[Piece, ...]:
    """The pieces of a file, none where it has no seal.

    everything : also what is so large that opening the file leaves it to HDF5. Raises InputError where a piece is not
    what was written, with the path of the dataset, or the seal itself is damaged; OSError where it cannot be read.
    """
    with path.open("rb") as stream:
        pieces = _pieces(stream, path)
        sizes: dict[str, int] = {}
        for piece in pieces:
            sizes[piece.what] = sizes.get(piece.what, 0) + piece.length
        for piece in pieces:
            asked = everything or sizes[piece.what] <= MOST_AT_OPENING
            if asked and _digest(stream, piece.begin, piece.length) != piece.digest:
                raise InputError(
                    f"{path}: {piece.what} is damaged: the {piece.length} bytes from {piece.begin} on are not those "
                    "that were written (checksum)"
                )
    return pieces


def _partition(size: int, extents: Sequence[Extent]) -> Iterator[tuple[int, int, str]]:
    """(begin, end, what) without gaps: values of datasets, and between them names and attributes."""
    headers = sorted((extent.begin, extent.path) for extent in extents if not extent.length)
    values = sorted((extent.begin, extent.begin + extent.length, extent.path) for extent in extents if extent.length)
    merged: list[tuple[int, int, str]] = []
    for begin, end, what in values:
        if merged and merged[-1][1:] == (begin, what):
            begin = merged.pop()[0]
        merged.append((begin, end, what))
    number = 0
    for (_, before, _), (begin, end, what) in pairwise([(0, 0, ""), *merged, (size, size, "")]):
        while number < len(headers) and headers[number][0] < before:
            number += 1
        if before < begin:
            about = headers[number][1] if number < len(headers) and headers[number][0] < begin else "the file"
            yield before, begin, f"the names and attributes about {about}"
        if begin < end:
            yield begin, end, what


def _pieces(stream: BinaryIO, path: Path) -> tuple[Piece, ...]:
    """What the seal says, in the order of the file. Raises InputError where the seal is damaged."""
    size = stream.seek(0, 2)
    stream.seek(max(size - LENGTH_OF_LAST, 0))
    last = LAST.fullmatch(stream.read())
    if last is None:
        if _begins(stream, size):
            raise _broken(path)
        return ()
    begin = size - int(last[2])
    stream.seek(max(begin, 0))
    text = stream.read()[:-LENGTH_OF_LAST]
    lines = text[len(MARK) :].decode("utf-8", "replace").splitlines()
    found = [LINE.fullmatch(line) for line in lines]
    if not text.startswith(MARK) or _short(hashlib.sha256(text)) != last[1].decode() or None in found:
        raise _broken(path)
    pieces = tuple(Piece(int(line[1]), int(line[2]), line[3], line[4]) for line in found if line is not None)
    if [piece.begin for piece in pieces] + [begin] != [0, *(piece.begin + piece.length for piece in pieces)]:
        raise _broken(path)
    return pieces


def _begins(stream: BinaryIO, size: int) -> bool:
    """Whether a seal begins where HDF5 ends."""
    stream.seek(0)
    end = int.from_bytes(stream.read(END_IN_SUPERBLOCK.stop)[END_IN_SUPERBLOCK], "little")
    if not 0 < end < size:
        return False
    stream.seek(end)
    return any(sign == mark for sign, mark in zip(stream.read(len(MARK)), MARK, strict=False))


def _broken(path: Path) -> InputError:
    return InputError(f"{path}: the checksums at its end are damaged, so that nothing says whether the rest is")


def _digest(stream: BinaryIO, begin: int, length: int) -> str:
    found, left = hashlib.sha256(), length
    stream.seek(begin)
    while left and (part := stream.read(min(left, AT_ONCE))):
        found.update(part)
        left -= len(part)
    return _short(found)


def _short(digest: "hashlib._Hash") -> str:
    return digest.hexdigest()[:32]
