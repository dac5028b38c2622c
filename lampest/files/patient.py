"""Files for HDF5 whose writes never fail: room is reserved ahead, refused bytes are kept.

The HDF5 library may end the process, or damage its file, if a write fails. A `PatientFile` hands
every write to the disk in order. What the disk refuses is kept in memory, with all that follows,
and tried again later. The disk therefore always has the state of a moment, as after a kill.
"""

import io
import os
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

from lampest.files.checksums import marked_as_written

AHEAD = 2**20  # bytes that are reserved at once


class PatientFile(io.RawIOBase):
    """New file for HDF5 that keeps bytes that the disk refuses.

    Raises FileExistsError if the file exists, and OSError if it cannot be created.

    Attributes
    ----------
    trouble : OSError or None
        Newest refusal of the disk; None after a success.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.trouble: OSError | None = None
        self._path = path
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self._descriptor = os.open(path, flags, 0o666)
        self._position = 0
        self._end = 0
        self._reserved = 0
        self._refused = deque[tuple[int, bytes]]()

    def __repr__(self) -> str:
        """Return the name that h5py shows for the file."""
        return str(self._path)

    @property
    def in_place(self) -> bool:
        """Whether the file still has its name: it was not removed, renamed or replaced."""
        try:
            return os.path.samestat(self._path.stat(), os.fstat(self._descriptor))
        except OSError:
            return False

    def reserve(self, size: int) -> bool:
        """Reserve `size` bytes behind all bytes so far, and return whether the disk has room."""
        if not self.flushed():
            return False
        needed = self._end + size
        for end in (needed + AHEAD, needed) if needed > self._reserved else ():
            try:
                _allocate(self._descriptor, self._reserved, end)
            except OSError as error:
                self.trouble = error
            else:
                self._reserved = end
                break
        if needed > self._reserved:
            return False
        self.trouble = None
        return True

    def flushed(self) -> bool:
        """Try refused writes again, and return whether the disk has all bytes now."""
        try:
            while self._refused:
                begin, data = self._refused[0]
                count = os.pwrite(self._descriptor, data, begin)
                self._refused[0] = begin + count, data[count:]
                if count == len(data):
                    self._refused.popleft()
        except OSError as error:
            self.trouble = error
        return not self._refused

    def write(self, data: Any, /) -> int:
        """Write bytes at the position; those that the disk refuses are tried again later."""
        content = bytes(data)
        if self._position == 0:
            content = marked_as_written(content)
        self._refused.append((self._position, content))
        self._position += len(content)
        self._end = max(self._end, self._position)
        self.flushed()
        return len(content)

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes from the position, refused ones included; zeros behind the end."""
        view = memoryview(buffer).cast("B")
        begin = self._position
        stored = os.pread(self._descriptor, len(view), begin)
        view[:] = stored + bytes(len(view) - len(stored))
        for place, data in self._refused:
            first = max(place, begin)
            last = min(place + len(data), begin + len(view))
            if first < last:
                view[first - begin : last - begin] = data[first - place : last - place]
        self._position += len(view)
        return len(view)

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Set the position. The end is that of the bytes written, without the reserve."""
        self._position = offset + (0, self._position, self._end)[whence]
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def truncate(self, size: int | None = None, /) -> int:
        """Set the end; the reserve behind it is given back when the file is closed."""
        self._end = self._position if size is None else size
        return self._end

    def readable(self) -> bool:
        """Return True."""
        return True

    def writable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def close(self) -> None:
        """Try refused writes a last time, give the reserve back, and close the file.

        Raises OSError if the disk still refuses bytes.
        """
        if self.closed:
            return
        complete = self.flushed()
        if complete:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._end)
        os.close(self._descriptor)
        super().close()
        if not complete and self.trouble is not None:
            raise self.trouble


def _allocate(descriptor: int, begin: int, end: int) -> None:
    """Reserve the bytes from `begin` to `end` of a file. Raises OSError if the disk has no room."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, begin, end - begin)
        return
    while begin < end:  # systems without that call
        begin += os.pwrite(descriptor, bytes(min(AHEAD, end - begin)), begin)
