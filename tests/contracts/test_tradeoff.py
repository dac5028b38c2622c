"""The command `lampest study tradeoff`: what is written, what is refused. No time is asserted."""

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import pytest

from tests.small_files import TRADEOFF


def test_command_writes_table_samples_and_figure(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], disk: SimpleNamespace
) -> None:
    config = tmp_path / "one.yaml"
    config.write_text(
        "schema: 1\nrecordings: [small.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n"
        "formulations: [scaled, reduced]\nframes: 2\nrepeats: 1\nmemory: LSM\n"
    )
    done = lampest("study", "tradeoff", config, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    assert "reduced" in done.out
    with (tmp_path / "out" / "tradeoff.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["formulation"] for row in rows} == {"scaled", "reduced"}
    assert all(float(row["memory_mb"]) > 10 for row in rows)
    assert (tmp_path / "out" / "tradeoff.png").read_bytes().startswith(b"\x89PNG")
    with h5py.File(tmp_path / "out" / "tradeoff.h5") as file:
        group = file["entry/frames"]
        assert group.attrs["signal"] == b"seconds"
        for name in group:
            assert group[name].attrs["units"], name
            assert group[name].attrs["long_name"], name
        assert group["gap"].dims[0][0].name.endswith("/record")
        assert list(group["solver"]) == [b"scaled"] * 2 + [b"reduced"] * 2


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("region,", "regoin,", "9:", "formulations.4"),
        ("steps: 2", "steps: 0", "9:", "formulations.3"),
        (" reduced,", "", ":", "reduced"),
        ("scaled,", "naive,", ":", "twice"),
        ("frames: 3", "frames: 1", ":", "frames"),
        ("sizes: [8,", "sizes: [3,", "2:", "side"),
        ("repeats:", "repaets:", "11:1", "no such key"),
        ("misfit: {}}}\n", "misfitt: {}}}\n", "7:", "no such key"),
        ("  scenes: {clean: {}", "  scenes: {a/b: {}", "", "a/b"),
    ],
)
def test_faults_of_the_file_are_one_sentence(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], old: str, new: str, place: str, words: str
) -> None:
    config = tmp_path / "wrong.yaml"
    assert old in TRADEOFF
    config.write_text(TRADEOFF.replace(old, new, 1))
    done = lampest("study", "tradeoff", config, "--out", tmp_path / "out")
    assert done.code == 2
    assert place in done.err and words in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
