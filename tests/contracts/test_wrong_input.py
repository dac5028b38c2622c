"""Whatever is wrong with what a user gives: exit code 2, one sentence that names the place, nothing written."""

import errno
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

Command = Callable[..., SimpleNamespace]


def refused(ended: SimpleNamespace, *words: str) -> None:
    """Exit code 2, nothing on standard output, and one line on standard error that holds the words."""
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.startswith("lampest: ")
    assert ended.err.count("\n") == 1
    assert ended.err.endswith("\n")
    assert "Traceback" not in ended.err
    for word in words:
        assert word in ended.err


def truncated(disk: SimpleNamespace) -> None:
    path = disk.folder / "small.h5"
    os.truncate(path, path.stat().st_size // 2)


def without(disk: SimpleNamespace, dataset: str) -> None:
    with h5py.File(disk.folder / "small.h5", "a") as file:
        del file[dataset]


RECORDINGS: dict[str, tuple[Callable[[SimpleNamespace], Any], tuple[str, ...]]] = {
    "no such file": (lambda disk: (disk.folder / "small.h5").unlink(), ("no such file",)),
    "a folder": (
        lambda disk: ((disk.folder / "small.h5").unlink(), (disk.folder / "small.h5").mkdir()),
        ("no such file",),
    ),
    "not HDF5": (lambda disk: (disk.folder / "small.h5").write_text("12, 13\n"), ("not a readable HDF5 file",)),
    "an empty file": (lambda disk: (disk.folder / "small.h5").write_bytes(b""), ("not a readable HDF5 file",)),
    "truncated": (truncated, ("small.h5",)),
    "no frames": (
        lambda disk: disk.recording(
            disk.folder / "small.h5", resistance=np.empty((0, 3, 4)), time=np.empty(0), role=np.empty(0, np.uint8)
        ),
        ("/entry/two_point/resistance", "at least one frame"),
    ),
    "no measured frame": (
        lambda disk: disk.recording(disk.folder / "small.h5", role=np.zeros(3, np.uint8)),
        ("small", "measured"),
    ),
    "another panel": (
        lambda disk: disk.recording(disk.folder / "small.h5", resistance=np.full((3, 4, 3), 1500.0)),
        ("/entry/two_point/resistance is 3 × 4 × 3", "3 × 4"),
    ),
    "two dimensions": (
        lambda disk: disk.recording(disk.folder / "small.h5", resistance=np.full((3, 4), 1500.0)),
        ("/entry/two_point/resistance",),
    ),
    "text for numbers": (
        lambda disk: disk.recording(disk.folder / "small.h5", resistance=np.full((3, 3, 4), b"many")),
        ("/entry/two_point/resistance",),
    ),
    "times of other length": (
        lambda disk: disk.recording(disk.folder / "small.h5", time=np.arange(4.0)),
        ("/entry/two_point/time",),
    ),
    "roles beyond 0 and 1": (
        lambda disk: disk.recording(disk.folder / "small.h5", role=np.array([0, 1, 2], np.uint8)),
        ("/entry/two_point/role",),
    ),
    "sigma of another shape": (
        lambda disk: disk.recording(disk.folder / "small.h5", sigma=np.ones((4, 3))),
        ("/entry/two_point/sigma",),
    ),
    "sigma of zero": (
        lambda disk: disk.recording(disk.folder / "small.h5", sigma=np.zeros((3, 4))),
        ("/entry/two_point/sigma[0, 0]", "positive"),
    ),
    "no scene": (lambda disk: without(disk, "/entry/scene"), ("/entry/scene",)),
    "no resistance": (lambda disk: without(disk, "/entry/two_point/resistance"), ("/entry/two_point/resistance",)),
    "misspelt scene": (
        lambda disk: disk.recording(disk.folder / "small.h5", scene=disk.scene.replace("pitch_mm", "pich_mm")),
        ("/entry/scene:1:", "pich_mm", "no such key"),
    ),
    "impossible scene": (
        lambda disk: disk.recording(disk.folder / "small.h5", scene=disk.scene.replace("140", "-140")),
        ("/entry/scene:", "series_resistance_ohm must be"),
    ),
}


@pytest.mark.parametrize(("spoil", "words"), RECORDINGS.values(), ids=RECORDINGS)
def test_a_fault_in_a_recording_is_one_sentence(
    disk: SimpleNamespace, lampest: Command, spoil: Callable[[SimpleNamespace], Any], words: tuple[str, ...]
) -> None:
    spoil(disk)
    out = disk.folder / "out"
    refused(lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1"), *words)
    assert not out.exists()


# name: what is replaced in the run's file, by what, 'line:column' of the complaint, words of it
FILES = {
    "misspelt": ("recordings: [", "recordigns: [", "2:1", "recordigns: no such key"),
    "misspelt estimator": ("LSM: {terms:", "LSM: {term:", "4:9", "term: no such key"),
    "misspelt term": ("misfit: {}, rel", "misfitt: {}, rel", "9:21", "misfitt: no such key"),
    "misspelt option": ("weight: 1e-3", "wieght: 1e-3", "8:25", "wieght: no such key"),
    "duplicate": ("  LSR-dCR", "  LSM", "9:3", "duplicate key"),
    "duplicate option": ("weight: 1e-3", "weight: 1e-3, weight: 2", "8:39", "duplicate key"),
    "text for a number": ("weight: 1e-3", "weight: much", "8:25", "number"),
    "text in quotes for a number": ("weight: 1e-3", "weight: '1e-3'", "8:25", "number"),
    "truth for a number": ("weight: 1e-3", "weight: yes", "8:25", "number"),
    "list for a number": ("weight: 1e-3", "weight: [1]", "8:25", "number"),
    "text for a list": ("[small.h5]", "small.h5", "2:1", "array"),
    "number for a name": ("[small.h5]", "[5]", "2:14", "string"),
    "negative weight": ("weight: 1e-3", "weight: -1e-3", "8:7", "weight must be zero or positive"),
    "infinite weight": ("weight: 1e-3", "weight: .inf", "8:", "weight"),
    "NaN weight": ("weight: 1e-3", "weight: .nan", "8:", "weight"),
    "another schema": ("schema: 1", "schema: 2", "1:1", "1"),
    "no schema": ("schema: 1\n", "", "1:1", "schema"),
    "no recordings": ("[small.h5]", "[]", "1:1", "at least one file"),
    "unknown key": ("estimators:\n", "other:\n", "3:1", "other: no such key"),
    "no terms": ("{terms: {misfit: {}}}", "{terms: {}}", "4:3", "at least one term"),
    "unknown formulation": ("schema: 1", "schema: 1\nformulation: nodel", "2:1", "nodal"),
    "tolerance": ("schema: 1", "schema: 1\nsolver: {tolerance: 0}", "2:1", "tolerance must lie"),
    "iterations": ("schema: 1", "schema: 1\nsolver: {max_iterations: 2.5}", "2:10", "integer"),
    "bounds": ("schema: 1", "schema: 1\nbounds: {lower: -5}", "2:1", "lower must be"),
    "unknown bound": ("schema: 1", "schema: 1\nbounds: {upper: resolved}", "2:10", "upper"),
    "unknown loss": ("weight: 1e-3", "loss: {kind: hubert, corner: 1}", "8:", "loss"),
    "loss without corner": ("weight: 1e-3", "loss: {kind: huber}", "8:", "corner"),
    "no mapping": ("schema: 1", "- schema: 1", "", ""),
    "no YAML": ("recordings: [", "recordings: [[", "", ""),
    "tab": ("recordings: [", "\trecordings: [", "2:1", "tab"),
    "a tag": ("[small.h5]", "!!python/object:os.system [small.h5]", "", ""),
    "sweep of nothing": ("schema: 1", "schema: 1\nsweep: {solver.tolernace: [1e-8]}", "2:9", "tolernace"),
    "sweep of a number": ("schema: 1", "schema: 1\nsweep: {solver.tolerance: 1e-8}", "2:9", "list"),
    "sweep to a wrong value": ("schema: 1", "schema: 1\nsweep: {solver.tolerance: [1e-8, 2]}", "2:", "tolerance"),
    "no room between bounds": ("schema: 1", "schema: 1\nbounds: {upper: 10}", "", "no room"),
    "unknown recording": ("small.h5", "smal*.hdf", "", "no file matches"),
    "an estimator's name": ("LSM:", "a/b:", "4:3", "'a/b'"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "place", "words"), FILES.values(), ids=FILES)
def test_a_fault_in_the_file_of_a_run_is_one_sentence(
    disk: SimpleNamespace, lampest: Command, old: str, new: str, place: str, words: str
) -> None:
    assert old in disk.text
    path, out = disk.run(disk.text.replace(old, new, 1)), disk.folder / "out"
    ended = lampest("run", path, "--out", out, "--jobs", "1")
    refused(ended, words)
    if place:
        assert ended.err.startswith(f"lampest: {path}:{place}")
    assert not out.exists()


def test_a_run_that_does_not_exist_is_refused(disk: SimpleNamespace, lampest: Command) -> None:
    refused(lampest("run", disk.folder / "none.yaml"), "none.yaml", "no such file")
    refused(lampest("run", disk.folder), "directory")
    (disk.folder / "latin.yaml").write_bytes("schema: 1 # Größe".encode("latin-1"))
    refused(lampest("run", disk.folder / "latin.yaml"), "UTF-8")
    (disk.folder / "empty.yaml").write_text("")
    refused(lampest("run", disk.folder / "empty.yaml"), "empty.yaml")
    assert not list(disk.folder.rglob("results.h5"))


def test_recordings_of_one_name_are_refused(disk: SimpleNamespace, lampest: Command) -> None:
    (disk.folder / "other").mkdir()
    disk.recording(disk.folder / "other" / "small.h5")
    path = disk.run(disk.text.replace("[small.h5]", "[small.h5, other/small.h5]"))
    refused(lampest("run", path, "--out", disk.folder / "out"), "two files are called small")
    assert not (disk.folder / "out").exists()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("solver.tolerance", "PATH=VALUE"),
        ("=3", "PATH=VALUE"),
        ("solver.tolernace=1e-6", "tolernace"),
        ("solver.tolerance=tight", "tolerance"),
        ("estimators.LSM.terms.misfit.weight=-1", "weight must be"),
        ("recordings.0.x=1", "recordings.0.x"),
        ("solver.tolerance=[1", "'[1'"),
    ],
)
def test_a_fault_in_a_setting_is_one_sentence(
    disk: SimpleNamespace, lampest: Command, setting: str, words: str
) -> None:
    out = disk.folder / "out"
    refused(lampest("run", disk.folder / "run.yaml", "--out", out, "--set", setting), words)
    assert not out.exists()


@pytest.mark.parametrize("place", ["small.h5", "small.h5/below", "/proc/none"])
def test_folder_that_cannot_be_written(disk: SimpleNamespace, lampest: Command, place: str) -> None:
    before = (disk.folder / "small.h5").read_bytes()
    refused(lampest("run", disk.folder / "run.yaml", "--out", disk.folder / place), "cannot be written")
    assert (disk.folder / "small.h5").read_bytes() == before


def full(monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    """Nothing more can be written to files of that name."""
    write = Path.write_bytes

    def failing(self: Path, data: bytes) -> int:
        if suffix in self.name:
            write(self, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(self, data)

    monkeypatch.setattr(Path, "write_bytes", failing)


def test_full_disk_at_the_end(disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cases fitted on the disk, all of them together do not: they are kept, and collected once there is room."""
    out = disk.folder / "out"
    with monkeypatch.context() as patch:
        full(patch, "results.h5")
        refused(lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1"), "No space left", "results.h5")
    assert not list(out.rglob("*results.h5*"))
    ended = lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    assert (ended.code, ended.err) == (0, "")
    assert "0 cases solved, 3 were done before" in ended.out
    assert (out / "results.h5").is_file()


def test_full_disk_at_every_case(disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases that could not be kept have failed; no half file is left."""
    out = disk.folder / "out"
    full(monkeypatch, ".h5")
    ended = lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    assert ended.code in (2, 3)
    assert "No space left" in ended.err
    assert "Traceback" not in ended.err
    assert not list(out.rglob("*.h5*"))


def test_full_disk_in_the_library(disk: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    import lampest

    recording = lampest.Recording.load(disk.folder / "small.h5")
    full(monkeypatch, "copy")
    with pytest.raises(lampest.InputError, match="No space left"):
        recording.save(disk.folder / "copy.h5")
    assert not list(disk.folder.glob("*copy*"))


@pytest.mark.parametrize("command", ["info", "compare", "plot"])
def test_other_commands_on_no_results(disk: SimpleNamespace, lampest: Command, command: str) -> None:
    before = sorted(disk.folder.rglob("*"))
    refused(lampest(command, disk.folder / "none.h5"), "none.h5", "no such file")
    refused(lampest(command, disk.folder / "run.yaml"), "run.yaml", "not a readable HDF5 file")
    if command != "info":
        refused(lampest(command, disk.folder / "small.h5"), "small.h5", "no results file")
    assert sorted(disk.folder.rglob("*")) == before
