"""Surroundings of a command: encodings, full and closed streams, -OO, and Ctrl-C while it loads."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from attack.attack import environment, small_folder

from lampest import Recording

SCRIPT = [sys.executable, "-c", "from lampest.cli import main; main()"]
TABLE = ["import", "table.csv", "--rows", "3", "--columns", "4", "--out", "new.h5"]


def command(folder: Path, *words: str, **options: Any) -> subprocess.CompletedProcess[str]:
    named = {"env": environment()} | options
    return subprocess.run(
        [*SCRIPT, *words],
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        timeout=120,
        **named,
    )


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_any_encoding_takes_the_output(tmp_path: Path, encoding: str) -> None:
    """Characters that it lacks are escapes: no traceback."""
    folder = small_folder(tmp_path / "work")
    surroundings = environment() | {"PYTHONIOENCODING": encoding}
    for words in (("info", "small.h5"), ("show", "terms"), ("compare", "results.h5")):
        completed = command(folder, *words, env=surroundings, stdout=subprocess.PIPE)
        assert completed.returncode == 0 and completed.stderr == "" and completed.stdout


@pytest.mark.parametrize("words", [("info", "small.h5"), ("show", "terms"), ("--help",)])
def test_a_full_standard_output_is_one_sentence(tmp_path: Path, words: tuple[str, ...]) -> None:
    folder = small_folder(tmp_path / "work")
    with Path("/dev/full").open("w") as full:
        completed = command(folder, *words, stdout=full)
    sentence = "lampest: standard output cannot be written (No space left on device)\n"
    assert (completed.returncode, completed.stderr) == (2, sentence)


def test_a_command_runs_without_docstrings(tmp_path: Path) -> None:
    surroundings = environment() | {"PYTHONOPTIMIZE": "2"}
    folder = small_folder(tmp_path / "work")
    for words in (("--help",), ("info", "small.h5")):
        completed = command(folder, *words, env=surroundings, stdout=subprocess.PIPE)
        assert completed.returncode == 0 and completed.stderr == "" and completed.stdout


@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 1, 2)])
def test_closed_standard_streams_change_no_file(tmp_path: Path, closed: tuple[int, ...]) -> None:
    """A file that took the number of a closed stream would get its text."""
    folder = small_folder(tmp_path / "work")
    expected = command(folder, *TABLE, stdout=subprocess.DEVNULL)
    assert expected.returncode == 0, expected.stderr
    meant = (folder / "new.h5").read_bytes()
    (folder / "new.h5").unlink()
    process = subprocess.Popen(
        [*SCRIPT, *TABLE],
        cwd=folder,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: [os.close(number) for number in closed],
    )
    assert process.wait(120) == 0
    assert (folder / "new.h5").read_bytes() == meant
    assert len(Recording.load(folder / "new.h5").time)


@pytest.mark.parametrize("after", [0.05, 0.1, 0.2, 0.3, 0.5])
def test_an_interrupt_while_a_command_loads_is_no_traceback(tmp_path: Path, after: float) -> None:
    """Python itself may still print one before it runs the first line of lampest."""
    folder = small_folder(tmp_path / "work")
    begun = "import sys; sys.stdout.write('b'); sys.stdout.flush(); "
    words = [sys.executable, "-c", begun + SCRIPT[-1], "info", "small.h5"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, cwd=folder, env=environment(), **pipes) as process:
        assert process.stdout is not None and process.stdout.read(1) == b"b"
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        error = process.communicate(timeout=120)[1].decode()
    assert "Traceback" not in error and process.returncode in (0, 130, -signal.SIGINT)
