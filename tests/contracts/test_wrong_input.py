"""Whatever is wrong with what a user gives: exit code 2, one sentence that names the place, nothing written."""

import errno
import gc
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from contracts.test_studies import BENCH, EXTREMES

from tests.small_files import RUN, SIMULATION, TRADEOFF

Command = Callable[..., SimpleNamespace]
LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
START = "2026-05-04T09:30:00+02:00"


def content(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def refused(lampest: Command) -> Callable[..., None]:
    """Whether a command is refused: code 2, one line on standard error that holds the words, files as they were."""

    def check(folder: Path, *arguments: Any, words: tuple[str, ...], begin: str = "") -> None:
        before = content(folder)
        ended = lampest(*arguments)
        assert (ended.code, ended.out) == (2, ""), ended.err
        assert ended.err.startswith(f"lampest: {begin}"), ended.err
        assert ended.err.count("\n") == 1 and ended.err.endswith("\n") and "Traceback" not in ended.err
        assert all(word in ended.err for word in words), ended.err
        assert content(folder) == before

    return check


# A command, its file in order, what is replaced by what, and line:column of the complaint with its words.
DOCUMENTS = (
    ("run", RUN, "weight: 1e-3", "wieght: 1e-3", "8:25: ", "wieght: no such key"),
    ("run", RUN, "small.h5", "smal*.hdf", " recordings: ", "no file matches"),
    ("simulate", SIMULATION, "mass_g: 50", "mass_g: -50", "10:5: ", "mass_g must be positive"),
    ("study bench", BENCH, "nodal: 3", "noddal: 3", "6:10: ", "limits.noddal: no such key"),
    ("study extremes", EXTREMES, "decades: [1]", "decades: [99]", "2:1: ", "decades must lie between 0 and 15"),
    ("study tradeoff", TRADEOFF, "frames: 3", "frames: 1", "1:1: ", "frames must lie between"),
)


@pytest.mark.parametrize(("command", "text", "old", "new", "place", "words"), DOCUMENTS)
def test_a_fault_in_a_file_is_one_sentence_at_its_place(
    disk: SimpleNamespace,
    refused: Callable[..., None],
    command: str,
    text: str,
    old: str,
    new: str,
    place: str,
    words: str,
) -> None:
    path = disk.run(text.replace(old, new, 1))
    refused(disk.folder, *command.split(), path, "--out", disk.folder / "out", words=(words,), begin=f"{path}:{place}")
    assert not (disk.folder / "out").exists()


# The words of a command in a folder with small.h5 and run.yaml, and those of its complaint.
COMMANDS = (
    ("run .", "directory"),
    *((f"run run.yaml --out {place}", "cannot be written") for place in ("small.h5", "small.h5/below", "/proc/none")),
    ("run run.yaml --out out --set solver.tolernace=1e-6", "tolernace"),
    ("compare small.h5", "small.h5", "no results file"),
    ("import m.csv --out m.h5", "m.csv"),
    ("live --recording nowhere.h5", "nowhere.h5"),
    ("live --recording LAMPREY --port /dev/null", "--recording: --port, --scene, --period and --out are for a board"),
    ("live --recording LAMPREY --publish carrier-pigeon", "begins with none of lsl, osc, mqtt, websocket"),
    ("live --recording LAMPREY --publish mqtt://localhost:port/x", "is no address"),
    ("live --recording LAMPREY --publish mqtt://127.0.0.1:1/x", "mqtt://127.0.0.1:1/x: no broker answers"),
    ("live --recording LAMPREY --publish mqtt://localhost/#", "is no topic to publish to"),
    ("live --recording LAMPREY --publish websocket://example.org", "'example.org' is no address"),
    ("live --recording LAMPREY --publish osc://nowhere.invalid", "osc://nowhere.invalid:9000/lampest: "),
)


@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")  # of paho's threads
@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_words_of_a_command_that_cannot_be_are_one_sentence(
    disk: SimpleNamespace, refused: Callable[..., None], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(disk.folder)
    command, *complaint = words
    refused(disk.folder, *command.replace("LAMPREY", str(LAMPREY)).split(), words=tuple(complaint))
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


def test_a_full_disk_keeps_what_fits(disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases that do not fit have failed. If only all of them together do not, they are collected once there is room."""
    run, out = disk.folder / "run.yaml", disk.folder / "out"
    for suffix, codes in ((".h5", (2, 3)), ("results.h5", (2,))):
        with monkeypatch.context() as patch:
            full(patch, suffix)
            ended = lampest("run", run, "--out", out, "--jobs", "1")
        assert ended.code in codes and "No space left" in ended.err and "Traceback" not in ended.err
        assert not list(out.rglob(f"*{suffix}*"))
    assert (ended.out, ended.err.count("\n")) == ("", 1) and "results.h5" in ended.err
    ended = lampest("run", run, "--out", out, "--jobs", "1")
    assert (ended.code, ended.err) == (0, "") and "0 cases solved, 3 were done before" in ended.out
    assert (out / "results.h5").is_file()
