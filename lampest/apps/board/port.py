"""Port of a board: search, HELLO, settings, start and reading.

The module also reads keys that are pressed meanwhile.
"""

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import count
from time import monotonic
from typing import Any

from serial.tools import list_ports

from lampest.apps.board.protocol import (
    MAX_BASELINE,
    PROTOCOL_VERSION,
    Answer,
    Estimate,
    Foreign,
    Frame,
    Garbage,
    Hello,
    Kind,
    Message,
    Receiver,
    Result,
    command,
)
from lampest.apps.board.source import ByteSource, NoBoardError
from lampest.files.errors import InputError

# Silence after which a board is identified anew. A Mega's bootloader listens for one second after a
# reset, and must not receive other bytes.
SILENCE_SECONDS = 2.5
HELLO_SECONDS = 8.0  # maximum wait for a board: a slow bootloader, and HELLOs a second apart
ANSWER_SECONDS = 0.5  # wait for an answer
MAX_FIRST = 1_000_000  # bytes that are kept until a board is identified: those of 2 Mbaud for 5 s
RECENT = 2000  # bytes that show whether a board prints numbers, behind its banner
MIN_TEXT = 0.9  # share of printed bytes that are characters; lost bits make others
MIN_DIGITS = 0.1  # share of digits in numbers, as of {"row": 1, "v": [0, 0, 0]}; banners have less
# USB vendors: Arduino (two), and WCH and FTDI for clones
ARDUINO_VENDORS = (0x2341, 0x2A03, 0x1A86, 0x0403)


def is_text(data: bytes) -> bool:
    """Return whether bytes are a text, but for some that were damaged."""
    signs = sum(byte in b"\t\r\n" or 32 <= byte < 127 for byte in data)
    return signs > MIN_TEXT * len(data)


def prints_numbers(data: bytes) -> bool:
    """Return whether the last bytes of a board are numbers as text."""
    recent = data[-RECENT:]
    return is_text(recent) and sum(48 <= byte < 58 for byte in recent) > MIN_DIGITS * len(recent)


def ports() -> list[Any]:
    """Return pyserial's descriptions of all serial ports, likely Arduinos first."""
    return sorted(
        list_ports.comports(), key=lambda port: (port.vid not in ARDUINO_VENDORS, port.device)
    )


def only_port() -> str:
    """Return the only port that looks like an Arduino.

    Raises InputError if there is none or more than one.
    """
    likely: list[str] = [port.device for port in ports() if port.vid in ARDUINO_VENDORS]
    if len(likely) == 1:
        return likely[0]
    reason = "no port looks like an Arduino"
    if likely:
        reason = f"several ports look like an Arduino: {', '.join(likely)}"
    raise InputError(f"{reason}; name one (`lampest record --list` lists them)")


class Board:
    """Open port of a board, with its unread messages and the number of bytes received.

    Every method raises OSError if the board is unplugged.
    """

    def __init__(self, source: ByteSource, url: str) -> None:
        self.source = source
        self._url = url
        self._receiver = Receiver()
        self._waiting: list[Message] = []  # to be read
        self._tags = count(1)
        self.heard = 0
        self.first = b""  # the first bytes, of a board that is not identified yet

    def messages(self) -> tuple[Message, ...]:
        """Return complete messages; waits at most 0.05 s for a byte.

        Raises InputError for another protocol version.
        """
        return self._taken() or self._arrived()

    def _taken(self) -> tuple[Message, ...]:
        waiting = tuple(self._waiting)
        self._waiting = []
        return waiting

    def hello(self) -> Hello | None:
        """Return the board's HELLO; None where something else comes.

        A board that did not reset is stopped and identified. One that prints numbers is not asked.
        Raises NoBoardError if nothing comes.
        """
        began = monotonic()
        requested = began - ANSWER_SECONDS
        while monotonic() < began + HELLO_SECONDS:
            messages = self.messages()
            for item in messages:
                if isinstance(item, Hello) and not item.running:
                    return item
            # A board that sends frames without a HELLO was not reset by opening the port.
            patient = 0.3 if any(isinstance(item, Frame) for item in messages) else SILENCE_SECONDS
            if monotonic() > max(began + patient, requested + ANSWER_SECONDS):
                if prints_numbers(self.first):
                    return None
                self.source.write(command(Kind.STOP) + command(Kind.IDENTIFY))
                requested = monotonic()
        if self.heard:
            return None
        raise NoBoardError(
            f"{self._url}: no lampest board answered within {HELLO_SECONDS:g} s, and nothing came"
        )

    def order(self, kind: Kind, value: int = 0) -> int:
        """Send a command until it is answered, and return the value in force.

        Raises InputError if it is refused, NoBoardError without an answer.
        """
        answer = self._ask(kind, value)
        # A running board has carried out an earlier START whose answer was lost.
        runs = kind is Kind.START and answer.result is Result.REFUSED_RUNNING
        if answer.result is not Result.DONE and not runs:
            raise InputError(f"{self._url}: {kind.name} {value} refused: {answer.result.value}")
        return int(answer.value)

    def identify(self) -> Hello:
        """Request and return a HELLO. Raises NoBoardError without an answer."""
        hello: Hello = self._ask(Kind.IDENTIFY)
        return hello

    def _ask(self, kind: Kind, value: int = 0) -> Any:
        """Send a command until its answer arrives, and return it.

        Other messages except garbage remain to be read.
        """
        tag = next(self._tags) % 256
        expected = Hello if kind is Kind.IDENTIFY else Answer
        for _ in range(4):  # a line may be disturbed
            self.source.write(command(kind, tag, value))
            until = monotonic() + ANSWER_SECONDS
            while monotonic() < until:
                arrived = [item for item in self._arrived() if not isinstance(item, Garbage)]
                answers = [
                    item
                    for item in arrived
                    if isinstance(item, expected) and getattr(item, "tag", tag) == tag
                ]
                self._waiting += [item for item in arrived if item not in answers[:1]]
                if answers:
                    return answers[0]
        raise NoBoardError(f"{self._url}: the board does not answer {kind.name}")

    def _arrived(self) -> tuple[Message, ...]:
        """Return the messages that new bytes complete.

        Raises InputError for another version, or an invalid HELLO.
        """
        data = self.source.read()
        self.heard += len(data)
        if self.heard <= MAX_FIRST:
            self.first += data
        self._receiver, messages = self._receiver.feed(data)
        for item in messages:
            if isinstance(item, Foreign):
                raise InputError(
                    f"{self._url}: the board speaks version {item.version} of the protocol "
                    f"and this lampest version {PROTOCOL_VERSION}; "
                    "upload the sketch in firmware/ that belongs to it"
                )
            if isinstance(item, Hello) and item.fault:
                raise InputError(f"{self._url}: {item.fault} (firmware pins.h)")
        return messages

    def start(
        self, rows: int, columns: int, readings: int, period_us: int | None, baseline: int = 0
    ) -> Hello:
        """Configure and start the board; return its settings.

        A period of None is 1 s, or the shortest possible one.

        The first `baseline` frames are the baseline of the board's own estimate, if it has one; 0
        leaves the baseline.
        Raises InputError if the board refuses a setting.
        """
        self.order(Kind.STOP)
        self._waiting = []
        self.order(Kind.SET_ROWS, rows)
        self.order(Kind.SET_COLUMNS, columns)
        self.order(Kind.SET_READINGS, readings)
        # The command by which boards that estimate differ from others.
        answer = self._ask(Kind.SET_BASELINE, min(baseline, MAX_BASELINE))
        shortest = self.identify().shortest_period_us
        if period_us is not None and period_us < shortest:
            raise InputError(
                f"a period of {period_us / 1e6:g} s is too short: "
                f"{rows} × {columns} cells with {readings} readings each take {shortest / 1e6:g} s"
            )
        self.order(Kind.SET_PERIOD, max(1_000_000, shortest) if period_us is None else period_us)
        settings = self.identify()
        if settings.size != (rows, columns, readings):
            raise NoBoardError(f"{self._url}: the board restarted while it was being set")
        identity = self.order(Kind.START)
        estimates = answer.result is Result.DONE
        settings = replace(settings, estimates=estimates, identity=identity)
        # HELLOs from before the start would look like a restart.
        self._waiting = [item for item in self._waiting if isinstance(item, Frame | Estimate)]
        return settings

    def stop(self) -> tuple[Message, ...]:
        """Stop the board, and return all messages up to its answer that arrive within 2 s.

        Missing boards and missing answers are ignored.
        """
        with suppress(OSError, InputError):
            self.order(Kind.STOP)
        return self._taken()


@contextmanager
def pressed_keys(*, listens: bool = True) -> Iterator[Callable[[], str]]:
    """Yield a function that returns the keys pressed since its last call.

    The terminal is restored at the end. Nothing is pressed where standard input is a board's.
    """
    if not listens:
        yield lambda: ""
        return
    try:
        import termios
        import tty

        descriptor = sys.stdin.fileno()
        before = termios.tcgetattr(descriptor)
        if os.tcgetpgrp(descriptor) != os.getpgrp():
            raise OSError("in the background, where touching the terminal would stop the process")
    except Exception:  # no POSIX terminal: then nothing can be marked
        yield lambda: ""
        return

    def pressed() -> str:
        ready = select.select([descriptor], [], [], 0)[0]
        return os.read(descriptor, 64).decode("ascii", "ignore") if ready else ""

    try:
        tty.setcbreak(descriptor)
        yield pressed
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
