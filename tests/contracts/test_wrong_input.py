"""Impossible words of commands, and a full disk."""

import errno
import gc
import os
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from attack.attack import everything

Command = Callable[..., SimpleNamespace]
LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"


# The words of a command, and those of its complaint; other commands are in the golden table.
COMMANDS = (
    ("calibrate LAMPREY --tolerance 0.6", "--tolerance must lie between 0 and 0.5"),
    ("live --recording nowhere.h5", "nowhere.h5"),
    (
        "live --recording LAMPREY --port /dev/null",
        "--recording: --port, --scene, --period and --out are for a board",
    ),
    (
        "live --recording LAMPREY --publish mqtt://127.0.0.1:1/x",
        "mqtt://127.0.0.1:1/x: no broker answers",
    ),
    ("live --recording LAMPREY --publish mqtt://localhost/#", "is no topic to publish to"),
    ("live --recording LAMPREY --publish websocket://example.org", "'example.org' is no address"),
    (
        "live --recording LAMPREY --publish osc://nowhere.invalid",
        "osc://nowhere.invalid:9000/lampest: ",
    ),
)


@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")  # of paho's threads
@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_words_of_a_command_that_cannot_be_are_one_sentence(
    disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch, words: tuple[str, str]
) -> None:
    monkeypatch.chdir(disk.folder)
    command, complaint = words
    original = everything(disk.folder)
    completed = lampest(*command.replace("LAMPREY", str(LAMPREY)).split())
    assert (completed.code, completed.out) == (2, "") and complaint in completed.err
    assert re.fullmatch("lampest: .*\n", completed.err) and everything(disk.folder) == original
    gc.collect()


def full(monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    """Nothing more can be written to files of that name."""
    write = Path.write_bytes

    def failing(self: Path, data: bytes) -> int:
        if suffix in self.name:
            write(self, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(self, data)

    monkeypatch.setattr(Path, "write_bytes", failing)


@pytest.mark.slow
@pytest.mark.long
def test_a_full_disk_keeps_the_cases_that_fit(
    disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cases that do not fit have failed."""
    run = disk.folder / "run.yaml"
    out = disk.folder / "out"
    for suffix, codes in ((".h5", (2, 3)), ("results.h5", (2,))):
        with monkeypatch.context() as patch:
            full(patch, suffix)
            completed = lampest("run", run, "--out", out, "--jobs", "1")
        assert (
            completed.code in codes
            and "No space left" in completed.err
            and "Traceback" not in completed.err
        )
        assert not list(out.rglob(f"*{suffix}*"))
    assert (completed.out, completed.err.count("\n")) == ("", 1) and "results.h5" in completed.err
    completed = lampest("run", run, "--out", out, "--jobs", "1")
    assert (completed.code, completed.err) == (
        0,
        "",
    ) and "0 cases solved, 3 were done before" in completed.out
    assert (out / "results.h5").is_file()
