"""Files that appear whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lampest.files.errors import InputError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to; it takes that name once it is complete and on the disk.

    Raises InputError where the folder cannot be written or the disk is full; nothing is left behind then.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield unfinished
        with unfinished.open("rb") as handle:
            os.fsync(handle.fileno())
        unfinished.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with suppress(OSError):
            unfinished.unlink()


def write_whole(path: Path, text: str) -> None:
    """Write a text in UTF-8 with the line ends it has. Raises InputError where the place cannot be written."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(text.encode("utf-8"))
