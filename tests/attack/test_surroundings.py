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
INSTALLED = Path(__file__).parents[2] / "scripts" / "lampest"  # as the wheel brings it
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of `small_folder`, for tests that leave them as they are."""
    return small_folder(tmp_path_factory.mktemp("surroundings") / "work")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("encoding", "words"),
    [("ascii", ("show", "terms")), ("latin-1", ("compare", "results.h5"))],
)
def test_any_encoding_takes_the_output(folder: Path, encoding: str, words: tuple[str, ...]) -> None:
    """Characters that it lacks are escapes: no traceback."""
    surroundings = environment() | {"PYTHONIOENCODING": encoding}
    completed = command(folder, *words, env=surroundings, stdout=subprocess.PIPE)
    assert completed.returncode == 0 and completed.stderr == ""
    assert "\\u" in completed.stdout or "\\x" in completed.stdout


@pytest.mark.parametrize("words", [("show", "terms"), ("--help",)])
def test_a_full_standard_output_is_one_sentence(folder: Path, words: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        completed = command(folder, *words, stdout=full)
    sentence = "lampest: standard output cannot be written (No space left on device)\n"
    assert (completed.returncode, completed.stderr) == (2, sentence)


@pytest.mark.slow
def test_a_command_runs_without_docstrings(folder: Path) -> None:
    surroundings = environment() | {"PYTHONOPTIMIZE": "2"}
    for words in (("--help",), ("info", "small.h5")):
        completed = command(folder, *words, env=surroundings, stdout=subprocess.PIPE)
        assert completed.returncode == 0 and completed.stderr == "" and completed.stdout


@pytest.fixture(scope="module")
def imported(folder: Path) -> bytes:
    """The recording that the command makes of the table."""
    expected = command(folder, *TABLE, stdout=subprocess.DEVNULL)
    assert expected.returncode == 0, expected.stderr
    made = (folder / "new.h5").read_bytes()
    (folder / "new.h5").unlink()
    return made


@pytest.mark.slow
@pytest.mark.parametrize("closed", [(1,), (2,), (0, 1, 2)])
def test_closed_standard_streams_change_no_file(
    folder: Path, imported: bytes, closed: tuple[int, ...]
) -> None:
    """A file that took the number of a closed stream would get its text."""
    process = subprocess.Popen(
        [*SCRIPT, *TABLE],
        cwd=folder,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: [os.close(number) for number in closed],
    )
    assert process.wait(120) == 0
    assert (folder / "new.h5").read_bytes() == imported
    assert len(Recording.load(folder / "new.h5").time)
    (folder / "new.h5").unlink()


@pytest.mark.parametrize(
    "after",
    [0.05, *(pytest.param(after, marks=pytest.mark.slow) for after in (0.1, 0.2, 0.5)), 0.3],
)
def test_an_interrupt_while_a_command_loads_is_no_traceback(folder: Path, after: float) -> None:
    """Python itself may still print one before it runs the first line of the command."""
    begun = "import sys; sys.stdout.write('b'); sys.stdout.flush()\n"
    code = begun + INSTALLED.read_text(encoding="utf-8")
    words = [sys.executable, "-c", code, "info", "small.h5"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, cwd=folder, env=environment(), **pipes) as process:
        assert process.stdout is not None and process.stdout.read(1) == b"b"
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        error = process.communicate(timeout=120)[1].decode()
    assert "Traceback" not in error and process.returncode in (0, 130, -signal.SIGINT)
