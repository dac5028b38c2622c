"""A board in a thread behind a pseudo-terminal, which sends the content of a script."""

import itertools
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from lampest.apps.board.protocol import Answer, Frame, Hello, Kind, Result, message, unstuffed
from tests.bodies import answer_body, frame_body, hello_body

IDLE = Hello(
    3, 4, 2, 16, 16, 64, (1, 0), 1_000_000, 1_000, 40, 5000, 1_000_000, 10, "reference", False
)
SETTINGS = {Kind.SET_ROWS: "rows", Kind.SET_COLUMNS: "columns", Kind.SET_READINGS: "readings"}
SETTINGS |= {Kind.SET_PERIOD: "period_us"}

# (s to wait before, bytes to send) once the board is started
Script = Callable[[Hello], Iterator[tuple[float, bytes]]]


@dataclass
class WildBoard:
    """Where it is to be opened, and how many bytes of its script the line has taken so far."""

    port: str = ""
    sent: int = 0
    deaf: bool = False
    identity: int = 0
    hello: Hello = IDLE
    _spoken_to: bool = False
    _plan: Iterator[tuple[float, bytes]] | None = None
    _ended: threading.Event = field(default_factory=threading.Event)

    def live(self, line: int, script: Script) -> None:
        """Answer commands and send the script's content when it is due, until the end.

        No message interrupts another one.
        """
        commands = b""
        answers = b""
        current = b""
        started = False
        due = 0.0
        while not self._ended.is_set():
            if self._plan is not None and not current:
                wait, current = next(self._plan, (60.0, b""))
                due = max(due + wait, time.monotonic() - 1.0)
            if not self._spoken_to:
                answers += (
                    message(hello_body(self.hello))
                    if time.monotonic() >= due and not answers
                    else b""
                )
                due = time.monotonic() + 0.1 if time.monotonic() >= due else due
            ripe = current if started or time.monotonic() >= due else b""
            outgoing = current if started else answers or ripe
            pause = 0.02 if not current else min(0.02, max(0.0, due - time.monotonic()))
            waiting, seconds = ([line], 0.02) if outgoing else ([], pause)
            readable, writable, _ = select.select([line], waiting, [], seconds)
            if writable:
                taken = os.write(line, outgoing[:512])
                if started or not answers:
                    current = current[taken:]
                    self.sent = self.sent + taken
                    started = bool(current)
                else:
                    answers = answers[taken:]
            if readable:
                *pieces, commands = (commands + os.read(line, 4096)).split(b"\0")
                for piece in filter(None, pieces):
                    self._spoken_to = True
                    previous = self._plan
                    answers += self._obey(piece, script)
                    if self._plan is not previous:
                        current = current if started else b""
                        due = time.monotonic()

    def _obey(self, piece: bytes, script: Script) -> bytes:
        """The answer to a command; the plan is another one after START and STOP."""
        body = unstuffed(piece)
        if self.deaf or body is None or len(body) != 9:
            return b""
        kind = Kind(body[1])
        tag = body[2]
        value = int.from_bytes(body[3:7], "little")
        if kind is Kind.IDENTIFY:
            return message(hello_body(self.hello))
        if kind in SETTINGS:
            self.hello = replace(self.hello, **{SETTINGS[kind]: value})
        if kind in (Kind.STOP, Kind.START):
            self.hello = replace(self.hello, running=kind is Kind.START)
            self._plan = script(self.hello) if kind is Kind.START else None
        # It does not estimate.
        result = Result.REFUSED_UNKNOWN if kind is Kind.SET_BASELINE else Result.DONE
        value = self.identity if kind is Kind.START else value
        return message(answer_body(Answer(kind, tag, result, value)))


@contextmanager
def wild_board(script: Script, hello: Hello = IDLE, identity: int = 0) -> Iterator[WildBoard]:
    """A board with that script, as long as the block lasts."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    board = WildBoard(os.ttyname(slave), hello=hello, identity=identity)
    thread = threading.Thread(target=board.live, args=(master, script), daemon=True)
    thread.start()
    try:
        yield board
    finally:
        board._ended.set()
        thread.join(5)
        os.close(master)
        os.close(slave)


def wire(
    hello: Hello,
    number: int,
    device_ms: int | None = None,
    shape: tuple[int, int] | None = None,
    identity: int = 0,
) -> bytes:
    """Frame `number` as it goes over the line; its first reading tells the number."""
    sums = np.full(shape or (hello.rows, hello.columns), 700 * hello.readings // 2, np.uint16)
    clock = 1000 + round(number * hello.period_us / 1000) if device_ms is None else device_ms
    numbers = (hello.readings, number % 2**32, clock % 2**32, 0)
    return message(frame_body(Frame(*numbers, sums + np.uint16(identity), identity=identity)))


def hundred_a_second(hello: Hello) -> Iterator[tuple[float, bytes]]:
    """A script of nothing but good frames."""
    for number in itertools.count():
        yield 0.01, wire(hello, number)
