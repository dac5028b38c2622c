"""Bytes of a board: from a serial port, a socket, datagrams, standard input, or a growing file.

No other module opens ports; this one and `lampest.apps.board.port` use pyserial.
"""

import os
import select
import socket
import sys
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Condition, Thread
from time import monotonic, sleep
from typing import NamedTuple
from urllib.parse import urlsplit

import serial

from lampest.files.errors import InputError

POLL_SECONDS = 0.05  # longest wait for a byte
FILE_POLL_SECONDS = 0.01  # between looks at a file, which nothing announces
CONNECT_SECONDS = 5.0  # longest wait for a connection over TCP
BLOCK = 65_536  # bytes that are read at once
MAX_WAITING = 64_000_000  # bytes that wait for a slow reader: 16 minutes of 16 × 16 at 50 Hz
RECEIVE_BUFFER = 4_000_000  # bytes of datagrams in the kernel, a minute of 16 × 16 at 50 Hz
# Rates of boards that print, usual ones first; those of USB ignore it.
PRINTED_BAUDS = (115_200, 9_600, 57_600, 230_400, 250_000, 460_800, 921_600, 1_000_000, 2_000_000)
# Linux: datagrams that the kernel dropped, as ancillary data of the next one (socket(7))
SO_RXQ_OVFL = 40


class NoBoardError(InputError):
    """No board answers at the port, which may be absent."""


class ByteSource(ABC):
    """Open source of bytes.

    Every method raises OSError if the other side is gone.

    Attributes
    ----------
    one_way : bool
        Whether nothing can be written.
    ended : bool
        Whether no further byte will come.
    dropped : int
        Datagrams that the kernel dropped.
    begins_late : bool
        Whether the next bytes are older than their arrival, as those of a file at first.
    """

    one_way = True
    ended = False
    dropped = 0
    begins_late = False

    @abstractmethod
    def read(self) -> bytes:
        """Return the bytes that came; waits at most POLL_SECONDS for the first."""

    def write(self, data: bytes) -> None:
        """Send bytes. Sources that go one way have no way to."""
        raise NotImplementedError

    def set_baud(self, baud: int) -> bool:
        """Change the rate, and return whether there is one."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Close the source."""


class SerialSource(ByteSource):
    """Serial port, or another port that pyserial opens (rfc2217://, loop://)."""

    one_way = False

    def __init__(self, url: str, baud: int) -> None:
        self._port = serial.serial_for_url(
            url, baud, timeout=POLL_SECONDS, write_timeout=2.0, exclusive=True
        )

    def reset_board(self) -> None:
        """Reset the board by DTR; ports without DTR stay as they are."""
        with suppress(OSError, ValueError):
            self._port.reset_input_buffer()
            self._port.dtr = False
            sleep(0.1)
            self._port.reset_input_buffer()
            self._port.dtr = True

    def set_baud(self, baud: int) -> bool:
        """Change the rate, and forget what arrived at the rate before."""
        self._port.baudrate = baud
        self._port.reset_input_buffer()
        return True

    def read(self) -> bytes:
        """Return the bytes that came."""
        return bytes(self._port.read(self._port.in_waiting or 1))

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._port.write(data)

    def close(self) -> None:
        """Close the port."""
        self._port.close()


class SocketSource(ByteSource):
    """Connection over TCP."""

    one_way = False

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), CONNECT_SECONDS)
        self._socket.settimeout(POLL_SECONDS)

    def read(self) -> bytes:
        """Return the bytes that came."""
        try:
            data = self._socket.recv(BLOCK)
        except TimeoutError:
            return b""
        if not data:
            raise OSError("the connection was closed")
        return data

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class DatagramSource(ByteSource):
    """Datagrams over UDP; each ends a line."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.settimeout(POLL_SECONDS)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            if sys.platform == "linux":
                self._socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise

    def read(self) -> bytes:
        """Return the next datagram."""
        try:
            data, ancillary, *_ = self._socket.recvmsg(BLOCK, socket.CMSG_SPACE(4))
        except TimeoutError:
            return b""
        for level, kind, value in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, SO_RXQ_OVFL):
                self.dropped = int.from_bytes(value[:4], sys.byteorder)
        return data if data.endswith((b"\n", b"\r")) else data + b"\n"

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class StandardInput(ByteSource):
    """Standard input, such as the end of a pipe."""

    def __init__(self) -> None:
        self._descriptor = sys.stdin.fileno()

    def read(self) -> bytes:
        """Return the bytes that came."""
        if not select.select([self._descriptor], [], [], POLL_SECONDS)[0]:
            return b""
        data = os.read(self._descriptor, BLOCK)
        self.ended = not data
        return data

    def close(self) -> None:
        """Leave standard input open, which is not ours."""


class GrowingFile(ByteSource):
    """File that another program writes, or a named pipe, from its beginning."""

    begins_late = True

    def __init__(self, path: Path) -> None:
        self._path = path
        self._open()

    def _open(self) -> None:
        self._file = os.open(self._path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))

    def read(self) -> bytes:
        """Return the bytes that were added; a file that was cut or replaced begins anew."""
        data = b""
        with suppress(BlockingIOError):  # a pipe without a byte
            data = os.read(self._file, BLOCK)
        if data:
            return data
        self.begins_late = False
        current = self._path.stat()
        if current.st_ino != os.fstat(self._file).st_ino:
            self.close()
            self._open()
        elif self._path.is_file() and current.st_size < os.lseek(self._file, 0, os.SEEK_CUR):
            os.lseek(self._file, 0, os.SEEK_SET)
        sleep(FILE_POLL_SECONDS)
        return b""

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def source_at(url: str, baud: int) -> ByteSource:
    """Open a port's source: tcp://HOST:PORT, udp://:PORT, -, a file, or a serial port.

    Raises OSError or ValueError if it cannot be opened.
    """
    if url.startswith(("tcp://", "udp://")):
        parts = urlsplit(url)
        if parts.port is None:
            raise ValueError(f"no port is named; write {parts.scheme}://HOST:PORT")
        if parts.scheme == "udp":
            return DatagramSource(parts.hostname or "", parts.port)
        return SocketSource(parts.hostname or "127.0.0.1", parts.port)
    if url == "-":
        return StandardInput()
    path = Path(url)
    if "://" not in url and (path.is_file() or path.is_fifo()):
        return GrowingFile(path)
    return SerialSource(url, baud)


@contextmanager
def opened_source(url: str, baud: int) -> Iterator[ByteSource]:
    """Open a source, reset the board behind it where that is possible, and close it at the end.

    Raises NoBoardError.
    """
    try:
        source = source_at(url, baud)
    except (OSError, ValueError) as error:
        raise NoBoardError(f"{url}: cannot be opened ({' '.join(str(error).split())})") from error
    try:
        if isinstance(source, SerialSource):
            source.reset_board()
        yield source
    finally:
        with suppress(OSError):
            source.close()


class Piece(NamedTuple):
    """Bytes that arrived together.

    Attributes
    ----------
    data : bytes
    arrived : float or None
        Arrival in s on the host's steady clock; None for bytes that a file held before.
    lost : int
        Bytes, or datagrams, that were lost before them because they came too fast.
    """

    data: bytes
    arrived: float | None
    lost: int = 0


class Listener:
    """Thread that takes bytes from a source as they come, so that none waits for the estimates.

    Operating systems keep 4 kB of a serial port and drop what comes then. Up to MAX_WAITING bytes
    wait here for their reader; more are dropped and counted.
    """

    def __init__(self, source: ByteSource, heard: bytes = b"") -> None:
        self._source = source
        self._changed = Condition()
        self._waiting: deque[Piece] = deque()
        self._size = 0
        self._lost = 0
        self._ended = False
        self._error: OSError | None = None
        if heard:
            self._put(Piece(heard, monotonic()))
        self._thread = Thread(target=self._listen, name="lampest-listener", daemon=True)

    def __enter__(self) -> "Listener":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended = True
        self._thread.join()

    @property
    def behind(self) -> float:
        """Age of the oldest waiting bytes in s."""
        with self._changed:
            oldest = self._waiting[0].arrived if self._waiting else None
        return 0.0 if oldest is None else monotonic() - oldest

    def take(self) -> tuple[Piece, ...] | None:
        """Return the pieces that came, after POLL_SECONDS at most; None at the source's end.

        Raises OSError if the source is gone.
        """
        with self._changed:
            if not self._waiting and not self._ended:
                self._changed.wait(POLL_SECONDS)
            pieces = tuple(self._waiting)
            self._waiting.clear()
            self._size = 0
            if pieces or not self._ended:
                return pieces
        if self._error is not None:
            raise self._error
        return None

    def _listen(self) -> None:
        """Take bytes until the end."""
        try:
            while not (self._ended or self._source.ended):
                late = self._source.begins_late
                dropped = self._source.dropped
                data = self._source.read()
                self._lost += self._source.dropped - dropped
                if data:
                    self._put(Piece(data, None if late else monotonic()))
        except OSError as error:
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify()

    def _put(self, piece: Piece) -> None:
        """Let a piece wait; without room it is lost."""
        with self._changed:
            if self._size + len(piece.data) > MAX_WAITING:
                self._lost += len(piece.data)
                return
            self._waiting.append(piece._replace(lost=self._lost))
            self._size += len(piece.data)
            self._lost = 0
            self._changed.notify()
