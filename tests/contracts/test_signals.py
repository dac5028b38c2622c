"""Every signal that can be caught ends a recording as Ctrl-C does: all that the board had sent, in a clean file."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from wild_board import WildBoard, hundred_a_second, wild_board, wire

from lampest import Recording
from tests.small_files import COMMAND

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]


def default_signals() -> None:
    """As a terminal starts a program, whatever the tests were started by."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


@contextmanager
def loaded(processes: int) -> Iterator[None]:
    """A machine on which others are at work."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


@contextmanager
def recorder(board: WildBoard, out: Path, *words: str) -> Iterator["subprocess.Popen[str]"]:
    arguments = [COMMAND, "record", "--port", board.port, "--out", str(out), "--period", "0.01", *words]
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=default_signals
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for(board: WildBoard, frames: int) -> int:
    """How many frames the line has taken once it has taken so many."""
    until = time.monotonic() + 60
    length = len(wire(board.hello, 300))
    while board.sent < frames * length:
        assert time.monotonic() < until
        time.sleep(0.01)
    return board.sent // length


@pytest.mark.slow
@pytest.mark.parametrize("number", SIGNALS)
def test_all_that_was_sent_before_a_signal_is_in_the_file(tmp_path: Path, number: signal.Signals) -> None:
    out = tmp_path / "r.h5"
    with loaded(3), wild_board(hundred_a_second) as board, recorder(board, out) as process:
        while not out.exists():
            assert process.poll() is None
        sent = wait_for(board, 60)
        for _ in range(3):
            process.send_signal(number)
        said, complained = process.communicate(timeout=60)
    found = Recording.load(out)
    assert process.returncode == 130
    assert len(found.time) >= sent and found.acquisition.sequence.tolist() == list(range(len(found.time)))
    assert said.startswith(f"{len(found.time)} frames, 0 lost, 0 restarts")
    assert f"lampest: {number.name} ended the recording; " in complained and complained.endswith("is kept\n")
    assert {path.name for path in tmp_path.iterdir()} == {"r.h5"}


def test_a_signal_before_the_first_frame_leaves_nothing(tmp_path: Path) -> None:
    with wild_board(lambda hello: iter(())) as board, recorder(board, tmp_path / "r.h5") as process:
        while not board.hello.running:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=30)
    assert process.returncode == 130
    assert not list(tmp_path.iterdir())


def test_what_is_ignored_from_the_start_stays_so(tmp_path: Path) -> None:
    """`nohup lampest record …` outlives its terminal."""
    out = tmp_path / "r.h5"
    words = ["nohup", COMMAND, "record", "--out", str(out), "--count", "40", "--period", "0.01", "--port"]
    with wild_board(hundred_a_second) as board:
        process = subprocess.Popen([*words, board.port], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not out.exists():
            assert process.poll() is None
        os.kill(process.pid, signal.SIGHUP)
        assert process.wait(60) == 0
    assert len(Recording.load(out).time) == 40


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_live_ends_with_130_too(number: signal.Signals) -> None:
    lamprey = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
    words = [COMMAND, "live", "--recording", str(lamprey), "--speed", "1000", "--http", "127.0.0.1:0"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=default_signals
    ) as process:
        assert process.stdout is not None and process.stdout.readline().startswith("http://127.0.0.1:")
        process.send_signal(number)
        _, complained = process.communicate(timeout=30)
    assert (process.returncode, complained) == (130, "lampest: interrupted; what was finished is kept\n")
