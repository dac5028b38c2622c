"""Boards that print, behind a pseudo-terminal, a socket, a pipe or a file: what sketches send.

The forms of lines are those of published projects: rows of a mat as Arduino sketches print them,
frames of a Teensy, objects of JSON.
"""

import json
import os
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from lampest import Array

Form = Callable[[int, Array], str]
STEP_MS = 40
RESET_SECONDS = 0.4  # from opening a port until its board has reset
BANNER = (
    "\r\nets Jul 29 2019 12:21:46\r\n\r\n"
    "rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n"
    "configsip: 0, SPIWP:0xee\r\nMat ready\r\n"
)


def joined(values: Sequence[int], separator: str) -> str:
    """Return numbers between separators."""
    return separator.join(map(str, values))


def rows_and_a_blank_line(number: int, codes: Array) -> str:
    """Serial.print of each row, and Serial.println() behind the frame."""
    return "".join(joined(row, ",") + "\r\n" for row in codes) + "\r\n"


def frame_with_millis(number: int, codes: Array) -> str:
    """millis() and all cells in one line."""
    return f"{1000 + STEP_MS * number},{joined(codes.ravel(), ',')}\r\n"


def json_frames(number: int, codes: Array) -> str:
    """An object for each frame."""
    return json.dumps({"t": STEP_MS * number, "data": codes.tolist()}) + "\n"


def mat_codes(frames: int, shape: tuple[int, int], seed: int = 0) -> Array:
    """Return codes of a mat, on which a weight stands in the second half."""
    rng = np.random.default_rng(seed)
    codes = 300 + 40 * rng.random(shape) + rng.normal(0, 1, (frames, *shape))
    codes[frames // 2 :, 1:3, 1:3] += 300
    return codes.round().astype(int)


def printed(form: Form, codes: Array) -> list[bytes]:
    """Return the bytes of every frame."""
    return [form(number, frame).encode() for number, frame in enumerate(codes)]


def _send(parts: Sequence[bytes], put: Callable[[bytes], None], period: float) -> None:
    """Send parts, one each period, as far as the other side takes them."""
    for part in parts:
        time.sleep(period)
        try:
            put(part)
        except OSError:
            return


@contextmanager
def in_thread(work: Callable[[], None]) -> Iterator[None]:
    """Do the work in a thread beside the block."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    yield
    thread.join(20)


def _opened(terminal: int) -> bool:
    """Return whether another process has locked a terminal for itself alone.

    Looking does not lock it, which would keep the other one out.
    """
    inode = os.fstat(terminal).st_ino
    locks = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    return any("FLOCK" in lock and lock[-3].endswith(f":{inode}") for lock in locks)


@contextmanager
def on_terminal(parts: Sequence[bytes], period: float = 0.02) -> Iterator[str]:
    """Yield a pseudo-terminal on which a board prints once somebody has opened it."""
    master, slave = os.openpty()
    tty.setraw(slave)
    ended = threading.Event()

    def put(part: bytes) -> None:
        while part and not ended.is_set():
            part = part[os.write(master, part[:512]) :]

    def send() -> None:
        while not (_opened(slave) or ended.is_set()):
            time.sleep(0.05)
        time.sleep(RESET_SECONDS)
        _send(parts, put, period)

    os.set_blocking(master, True)
    with in_thread(send):
        try:
            yield os.ttyname(slave)
        finally:
            ended.set()
            tty.tcflush(slave, tty.TCIFLUSH)
            os.close(slave)
            os.close(master)


@contextmanager
def on_socket(parts: Sequence[bytes], period: float = 0.02) -> Iterator[str]:
    """Yield the address of a board that prints to whoever connects."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                _send(parts, connection.sendall, period)
                time.sleep(0.5)

        with in_thread(serve):
            yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


@contextmanager
def in_datagrams(parts: Sequence[bytes], period: float = 0.02) -> Iterator[str]:
    """Yield the address to which a board sends datagrams."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

        def put(part: bytes) -> None:
            sender.sendto(part, ("127.0.0.1", port))

        def send() -> None:
            time.sleep(0.5)
            _send(parts, put, period)

        with in_thread(send):
            yield f"udp://:{port}"


@contextmanager
def in_file(parts: Sequence[bytes], path: Path, period: float = 0.02) -> Iterator[str]:
    """Yield a file that grows; its first frames are there from the beginning."""
    path.write_bytes(b"".join(parts[:2]))

    def put(part: bytes) -> None:
        with path.open("ab") as file:
            file.write(part)

    with in_thread(lambda: _send(parts[2:], put, period)):
        yield str(path)
