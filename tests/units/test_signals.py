"""Signals end a recording as Ctrl-C does, with all frames in a clean file."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from fuzz.batches import SIGNALS, batch, default_signals, finished, without_progress
from support import until
from wild_board import Script, WildBoard, hundred_a_second, wild_board, wire

from lampest import Recording
from lampest.files.process import ending_signals
from tests.small_files import COMMAND

LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
Running = subprocess.Popen[str]


def started(*words: object, preexec_fn: Callable[[], None] | None = default_signals) -> Running:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([str(word) for word in words], preexec_fn=preexec_fn, **pipes)


@contextmanager
def recorder(script: Script, out: Path) -> Iterator[tuple[WildBoard, Running]]:
    with (
        wild_board(script) as board,
        started(
            COMMAND, "record", "--port", board.port, "--out", out, "--period", "0.01"
        ) as process,
    ):
        try:
            yield board, process
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("number", SIGNALS)
def test_the_file_contains_all_frames_sent_before_a_signal(
    tmp_path: Path, number: signal.Signals
) -> None:
    out = tmp_path / "r.h5"
    with recorder(hundred_a_second, out) as (board, process):
        length = len(wire(board.hello, 300))
        until(lambda: out.exists() and board.sent >= 60 * length)
        sent = board.sent // length
        for _ in range(3):
            process.send_signal(number)
        stdout, stderr = process.communicate(timeout=60)
    recording = Recording.load(out)
    assert process.returncode == 130
    assert len(recording.time) >= sent and recording.acquisition.sequence.tolist() == list(
        range(len(recording.time))
    )
    assert stdout.startswith(f"{len(recording.time)} frames, 0 lost, 0 restarts")
    assert f"lampest: {number.name} ended the recording; " in stderr and stderr.endswith(
        "is kept\n"
    )
    assert {path.name for path in tmp_path.iterdir()} == {"r.h5"}


def test_a_signal_before_the_first_frame_leaves_nothing(tmp_path: Path) -> None:
    with recorder(lambda hello: iter(()), tmp_path / "r.h5") as (board, process):
        until(lambda: board.hello.running)
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=30)
    assert process.returncode == 130 and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_recording_outlives_its_terminal_with_nohup(tmp_path: Path) -> None:
    out = tmp_path / "r.h5"
    words = ("nohup", COMMAND, "record", "--out", out, "--count", 40, "--period", "0.01", "--port")
    with (
        wild_board(hundred_a_second) as board,
        started(*words, board.port, preexec_fn=None) as process,
    ):
        until(out.exists)
        process.send_signal(signal.SIGHUP)
        assert process.wait(60) == 0
    assert len(Recording.load(out).time) == 40


@pytest.mark.slow
@pytest.mark.parametrize("number", SIGNALS[1:])
def test_live_ends_with_code_130(number: signal.Signals) -> None:
    words = ("live", "--recording", LAMPREY, "--speed", 1000, "--http", "127.0.0.1:0")
    with started(COMMAND, *words) as process:
        assert process.stdout is not None and process.stdout.readline().startswith(
            "http://127.0.0.1:"
        )
        process.send_signal(number)
        _, stderr = process.communicate(timeout=30)
    assert (process.returncode, stderr) == (
        130,
        "lampest: interrupted; what was finished is kept\n",
    )


def test_a_second_signal_within_a_second_does_not_interrupt_the_clean_up() -> None:
    """An exception inside a destructor is printed and lost."""
    with pytest.raises(KeyboardInterrupt), ending_signals():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGTERM)
            cleaned = True
    assert cleaned


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGQUIT, signal.SIGINT, signal.SIGHUP])
def test_a_signal_to_the_whole_group_of_a_batch_prints_one_line(
    tmp_path: Path, number: signal.Signals
) -> None:
    cases = batch(tmp_path, 12)
    run = cases.start(tmp_path / "out", 2)
    until(lambda: finished(tmp_path / "out") > 0 or run.poll() is not None)
    os.killpg(run.pid, number)
    _, stderr = run.communicate(timeout=60)
    assert run.returncode == 130, stderr
    assert without_progress(stderr) == ["lampest: interrupted; what was finished is kept"]


def test_an_interrupt_inside_a_destructor_is_raised_again_and_not_printed(
    capfd: pytest.CaptureFixture[str],
) -> None:
    class Interrupted:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(KeyboardInterrupt), ending_signals() as request:
        Interrupted()
        time.sleep(10)
        pytest.fail("the interrupt was lost")
    assert request() == "SIGTERM" and capfd.readouterr().err == ""
