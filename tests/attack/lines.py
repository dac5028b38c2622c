"""A board that floods, lies or repeats itself, signals to whoever records it, and guests of the live page."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count as from_zero
from pathlib import Path
from unittest import mock

import numpy as np
from attack.attack import HELD, HOUSE, MAIN, Attack
from wild_board import Script, hundred_a_second, wild_board, wire

from lampest import InputError, Recording
from lampest.recording.board import stream
from lampest.recording.board.protocol import Hello, message
from lampest.recording.board.record import record
from lampest.report.live.handover import Newest
from lampest.report.live.message import View
from lampest.report.live.server import serving
from tests.bodies import hello_body

LIMIT_S, SLACK_S = 0.5, 15.0  # how long nothing may fit here, and what the rest may take on a loaded machine
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
MARK = b"xyzzy"

Said = Callable[[Hello, int], bytes]


def _sayings(rng: np.random.Generator) -> tuple[Said, ...]:
    """What a line may say in place of frame `number`."""
    return (
        lambda hello, number: wire(hello, number),
        lambda hello, number: wire(hello, number, shape=(int(rng.integers(1, 17)), int(rng.integers(1, 17)))),
        lambda hello, number: rng.bytes(int(rng.integers(1, 600))),
        lambda hello, number: bytes(int(rng.integers(1, 600))),
        lambda hello, number: wire(hello, int(rng.integers(0, number + 1))),
        lambda hello, number: wire(hello, number + 2**32 - 9),
        lambda hello, number: wire(hello, int(rng.integers(0, 2**32)), device_ms=int(rng.integers(0, 2**32))),
        lambda hello, number: wire(hello, number)[: int(rng.integers(1, 40))],
        lambda hello, number: message(hello_body(hello)),
    )


def _script(rng: np.random.Generator) -> Script:
    """Some of the sayings, in any mixture, at any rate up to as fast as the line takes them."""
    sayings = _sayings(rng)
    weights = rng.dirichlet(np.full(len(sayings), 0.3))
    pause = float(rng.choice([0.0, 0.001, 0.01]))

    def script(hello: Hello) -> Iterator[tuple[float, bytes]]:
        for number in from_zero():
            yield pause, sayings[rng.choice(len(sayings), p=weights)](hello, number)

    return script


def _floods(rng: np.random.Generator, folder: Path, count: int) -> Iterator[str]:
    """A line of random sayings: recording ends in time, with a sentence or with frames whose losses are counted."""
    for number in range(count):
        out = folder / f"{number}.h5"
        wanted = {"frames": 30} if rng.random() < 0.5 else {"seconds": 0.5}
        with mock.patch.object(stream, "UNFIT_SECONDS", LIMIT_S), wild_board(_script(rng)) as board:
            yield _ended(board.port, out, wanted)


def _ended(port: str, out: Path, wanted: dict[str, float]) -> str:
    began, said = time.monotonic(), ""
    try:
        done = record(port, out, period=0.01, **wanted)  # type: ignore[arg-type]
        # A frame whose number and clock lie alike may be believed as far as ten seconds ahead.
        if done.lost > 1200 * (done.restarts + done.frames):
            return f"{done.lost} frames are told to be lost, {done.frames} came"
    except InputError as error:
        said = str(error)
    took = time.monotonic() - began
    if took > LIMIT_S + SLACK_S:
        return f"{wanted} took {took:.0f} s ({said})"
    if out.exists() and not len(Recording.load(out).time):
        return "an empty recording was left"
    return HELD


def _signals(rng: np.random.Generator, folder: Path, count: int) -> Iterator[str]:
    """One to five signals at any moment: a clean file with all that the line had taken, or none before it began."""
    for number in range(count):
        yield _signalled(rng, folder / f"{number}.h5")


def _signalled(rng: np.random.Generator, out: Path) -> str:
    words = [sys.executable, "-c", MAIN, "record", "--period", "0.01", "--out", str(out), "--port"]
    environment = os.environ | {"PYTHONPATH": str(HOUSE), "OMP_NUM_THREADS": "1"}
    with wild_board(hundred_a_second) as board:
        process = subprocess.Popen(
            [*words, board.port],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            preexec_fn=lambda: [signal.signal(one, signal.SIG_DFL) for one in SIGNALS],
        )
        until = time.monotonic() + 60
        while not out.exists() and process.poll() is None and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(float(rng.uniform(0, 1.5)))
        sent = board.sent // len(wire(board.hello, 300))
        for one in rng.choice(SIGNALS, int(rng.integers(1, 6))):
            process.send_signal(int(one))
        try:
            _, complained = process.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()
            return f"still there after 30 s: {process.communicate()[1]!r}"
    if process.returncode != 130 or b"Traceback" in complained:
        return f"code {process.returncode}, {complained!r}"
    came = len(Recording.load(out).time) if out.exists() else 0
    return HELD if came >= sent - 1 else f"{came} of {sent} frames are in the file"


def _guests(rng: np.random.Generator, folder: Path, count: int) -> Iterator[str]:
    """Random requests to a page that is open to others: none is let in, none is reflected, and it lives on."""
    with serving("0.0.0.0", 0, Newest(View("here", "LSM", "receiving"))) as server:
        for _ in range(count):
            yield _asked(int(server.server_address[1]), _request(rng))


def _request(rng: np.random.Generator) -> bytes:
    """Something like HTTP, with a mark in it."""
    methods, paths = (b"GET", b"POST", b"HEAD", MARK), (b"/", b"/views", b"/" + MARK, b"/?token=" + MARK)
    heads = (b"Cookie: lampest=" + MARK, b"Authorization: Bearer " + MARK, b"Host: " + MARK, MARK + b": 1")
    heads = (*heads, rng.bytes(30))
    version = (b"HTTP/1.1", b"HTTP/1.0", b"HTTP/" + MARK, b"")[rng.integers(4)]
    first = b" ".join((methods[rng.integers(4)], paths[rng.integers(4)], version)).strip()
    lines = [first, *(heads[rng.integers(len(heads))] for _ in range(rng.integers(0, 4)))]
    return b"\r\n".join(lines) + b"\r\n\r\n"


def _asked(port: int, request: bytes) -> str:
    with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
        client.sendall(request)
        client.shutdown(socket.SHUT_WR)
        try:
            answer = b"".join(iter(lambda: client.recv(4096), b""))
        except ConnectionResetError:
            return HELD
    if MARK in answer or b"receiving" in answer or re.match(rb"HTTP/1\.[01] 2", answer):
        return f"{request!r} was answered {answer[:300]!r}"
    return HELD


ATTACKS = (
    Attack("lines", "floods, replays, wraps and garbage on a serial line", _floods, quick=3, full=100),
    Attack("signals", "one to five signals to a recording at any moment", _signals, quick=1, full=50),
    Attack("page", "random requests without the token to an open live page", _guests, quick=40, full=1000),
)
