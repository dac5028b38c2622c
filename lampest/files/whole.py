"""Atomic writing of files.

Outputs appear completely or not at all, and never replace inputs of the same command.
"""

import fcntl
import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from glob import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

from lampest.files.errors import InputError
from lampest.files.process import in_bytes


@dataclass(frozen=True)
class Touched:
    """Files of a command so far: read, written, and its own.

    A command may read and write its own files again.
    """

    read: set[Path] = field(default_factory=set)
    written: set[Path] = field(default_factory=set)
    own: set[Path] = field(default_factory=set)

    def owns(self, path: Path) -> bool:
        """Return whether the command may read and write the file again."""
        return any(path.is_relative_to(own) for own in self.own)


_TOUCHED: ContextVar[Touched | None] = ContextVar("files touched by a command", default=None)


@contextmanager
def sparing(inputs: Iterable[Path] = ()) -> Iterator[None]:
    """Refuse, within the block, outputs that would replace an input or another output.

    An input is recognised under any name. `inputs` are files that will be read. See `note_read` and
    `check_output`.
    """
    before = _TOUCHED.set(_TOUCHED.get() or Touched())
    try:
        for path in inputs:
            note_read(path)
        yield
    finally:
        _TOUCHED.reset(before)


def note_read(path: Path) -> None:
    """Register a file as read, except the command's own ones.

    Every function that reads a user's files calls it.
    """
    touched = _TOUCHED.get()
    if touched and not touched.owns(path.absolute()):
        touched.read.add(path.absolute())


def own(path: Path) -> None:
    """Declare a file, or a folder's files, as both input and output.

    A command declares its own files before it reads or writes them. Raises InputError if the file
    was read before.
    """
    _refuse_touched(path)
    touched = _TOUCHED.get()
    if touched:
        touched.own.add(path.absolute())


def refuse_inputs(outputs: Sequence[Path]) -> None:
    """Raise InputError if an output is an input, or two outputs are the same file."""
    for path in outputs:
        _refuse_touched(path)
    if len({path.resolve() for path in outputs}) < len(outputs):
        raise InputError(f"{outputs[-1]}: two outputs have this name; give one of them another")


def _refuse_touched(path: Path) -> None:
    """Raise InputError if an output is an input of the command, or another output of it."""
    touched = _TOUCHED.get() or Touched()
    if any(_same(path, read) for read in touched.read):
        raise InputError(f"{path}: is an input; give the output another name")
    if path.absolute() in touched.written:
        raise InputError(f"{path}: two outputs have this name; give one of them another")


def _same(path: Path, touched: Path) -> bool:
    try:
        return path.is_file() and path.samefile(touched)
    except (OSError, ValueError):  # the touched file is absent, or one of the names is impossible
        return False


@contextmanager
def _to_write(path: Path) -> Iterator[None]:
    """Create the folder of an output.

    Raises InputError as `check_output`, and for errors of the disk in the block.
    """
    check_output(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`.

    The file gets its name once it is complete and on disk.

    Raises InputError as `check_output`, and if the folder cannot be written or the disk is full; no
    file remains then. Temporary files of killed processes of this computer are removed.
    """
    with _to_write(path):
        # Files of processes that have ended are removed.
        for part in path.parent.glob(f".{escape(path.name)}.*-{_host()}????.part"):
            try:
                os.kill(int(part.name.removeprefix(f".{path.name}.").partition("-")[0]), 0)
            except ProcessLookupError:
                part.unlink(missing_ok=True)
            except (OSError, ValueError, OverflowError):  # a file of another user
                continue
        unfinished = path.with_name(
            f".{path.name}.{os.getpid()}-{_host()}{secrets.token_hex(2)}.part"
        )
        os.close(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            yield unfinished
            with unfinished.open("rb") as handle:
                os.fsync(handle.fileno())
            unfinished.replace(path)
            sync_folder(path.parent)
        finally:
            with suppress(OSError):
                unfinished.unlink()
    touched = _TOUCHED.get()
    if touched and not touched.owns(path.absolute()):
        touched.written.add(path.absolute())


def sync_folder(folder: Path) -> None:
    """Write the names in a folder to the disk, so that a new file survives a power failure."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):  # a file system that cannot do it for folders
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _host() -> str:
    """Return four characters that identify this computer.

    Other computers may share the folder and have equal process ids.
    """
    return f"{crc32(os.uname().nodename.encode()) % 2**16:04x}"


@contextmanager
def folder_beside(path: Path) -> Iterator[Path]:
    """Yield a temporary folder next to `path`, which is removed at the end.

    Raises InputError as `whole_file`.
    """
    with _to_write(path), TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        yield Path(folder)


def write_whole(path: Path, text: str) -> None:
    """Write a text in UTF-8, surrogates as escapes. Raises InputError as `whole_file`."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(text.encode("utf-8", "backslashreplace"))


def check_output(path: Path) -> None:
    """Raise InputError unless `path` is free, or a regular file.

    The file must be neither an input nor another output.
    """
    if path.name in ("", ".."):
        raise InputError(f"'{path}' names no file that could be written")
    kinds = {"d": "folder", "l": "link", "c": "device", "b": "device", "p": "pipe", "s": "socket"}
    if kind := kinds.get(_letter(path)):
        raise InputError(f"{path}: is a {kind}; an output replaces regular files alone")
    _refuse_touched(path)


def check_room(path: Path, size: int) -> None:
    """Raise InputError if the disk of a future file has less than `size` bytes free."""
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    free = shutil.disk_usage(folder).free
    if size > free:
        raise InputError(
            f"{path}: {in_bytes(size)} may be needed on the disk, and {in_bytes(free)} are free"
        )


def output_folder(folder: Path) -> Path:
    """Return a folder, created if absent.

    Raises InputError if it is the root, no folder, or cannot be created.
    """
    if folder.resolve() == Path(folder.resolve().anchor):
        raise InputError(f"{folder}: is the root of all files, no folder for results")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder}: cannot be written ({getattr(error, 'strerror', None) or error})"
        ) from error
    return folder


def inner_folder(folder: Path, name: str) -> Path:
    """Return a folder within a folder.

    Raises InputError if it is no folder, or a link that leads out.
    """
    inner = folder / name
    letter = _letter(inner)
    if letter == "l" and not inner.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"{inner}: is a link that leads out of {folder}; nothing is written or removed there"
        )
    if letter not in ("", "d", "l"):
        raise InputError(f"{inner}: is no folder")
    return inner


def opened_for_locking(path: Path, *, make: bool = False) -> int:
    """Return a descriptor of a regular file, never through a link; `make` creates an absent file.

    Raises OSError if it cannot be opened, InputError if it is no regular file.
    """
    if _letter(path) not in ("", "-"):
        check_output(path)
    made = os.O_RDWR | os.O_CREAT if make else os.O_RDONLY
    descriptor = os.open(path, made | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError(f"{path}: is no regular file, which a lock must be")
    return descriptor


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a shared lock on a file within the block, at most until the process ends.

    Readers of the file are not affected.
    """
    with os.fdopen(opened_for_locking(path), "rb") as handle:
        fcntl.flock(handle, fcntl.LOCK_SH)
        yield


def is_locked(path: Path) -> bool:
    """Return whether a living process holds a lock on the file."""
    with os.fdopen(opened_for_locking(path), "rb") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


def remove_own(path: Path) -> None:
    """Remove a regular file, if it exists; anything else of that name remains."""
    if _letter(path) == "-":
        path.unlink(missing_ok=True)


def _letter(path: Path) -> str:
    """Return the type letter of `ls` for a path, '-' for a regular file; '' if nothing exists."""
    try:
        return stat.filemode(path.lstat().st_mode)[0]
    except FileNotFoundError:
        return ""
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})"
        ) from error
