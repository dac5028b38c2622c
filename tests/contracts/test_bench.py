"""The command `lampest study bench`: what is written, what is refused. No time is asserted."""

import csv
from collections.abc import Callable
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

Command = Callable[..., SimpleNamespace]


@pytest.mark.slow
def test_command_writes_table_and_samples(disk: SimpleNamespace, lampest: Command) -> None:
    text = "schema: 1\nsizes: [3]\nframes: 1\nrepeats: 1\nmemory: [3]\n"
    text += "limits: {nodal: 3}\n"
    text += "estimators: {mine: {terms: {misfit: {}, gradient: {weight: 2}}}}\n"
    ended = lampest("study", "bench", disk.run(text, "bench.yaml"), "--out", disk.folder / "out")
    assert (ended.code, ended.err) == (0, "")
    for words in ("3 × 3", "nodal", "verified", "bench.csv", "growth.csv", "bench.md", "bench.h5"):
        assert words in ended.out
    assert max(map(len, ended.out.splitlines())) <= 100 + len(str(disk.folder))
    with (disk.folder / "out" / "bench.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [(row["method"], row["solver"], row["frames"]) for row in table] == [
        (method, solver, frames)
        for method in ("all", "mine")
        for solver in ("reduced", "nodal")
        for frames in ("first", "later")
    ]
    assert all(20 < float(row["memory_mb"]) < 2000 for row in table)
    with h5py.File(disk.folder / "out" / "bench.h5") as file:
        group = file["entry/frames"]
        assert [*group["solver"][:2]] == [b"reduced", b"nodal"] and list(group["frame"]) == [0, 0, 1, 1]
        for name, dataset in group.items():
            assert dataset.attrs["units"] and dataset.attrs["long_name"] and dataset.shape == (4,), name
        assert np.all(group["memory_mb"][()] > 20) and np.all(group["inverse_s"][()] > 0)
        assert group["status"][0] == b"optimum verified"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("sizes: []", "must hold at least one"),
        ("sizes: [1]", "a panel's side must lie between 2 and 1000"),
        ("sizes: [3, [3, 3]]", "names a panel twice"),
        ("sizes: [3]\nframes: 0", "frames must lie between 1 and 1000"),
        ("sizes: [3]\nrecordings: 0", "recordings must lie between 1 and 1000"),
        ("sizes: [3]\nbudget_s: 0", "budget_s must lie between"),
        ("sizes: [3, [3, 30]]\nlimits: {reduced: 20}", "limits leave no solver for 3 × 30"),
        ("sizes: [3]\nlimits: {noddal: 3}", "bench.yaml:3:10: limits.noddal: no such key"),
        ("sizes: [3]\nestimators: {A: {terms: {}}}", "a method needs at least one term"),
        ("sizes: [3]\nestimators: {A: {terms: {misfit: {loss: {kind: absolute}}}}}", "only squared losses"),
    ],
)
def test_wrong_files_are_one_sentence(line: str, message: str, disk: SimpleNamespace, lampest: Command) -> None:
    ended = lampest("study", "bench", disk.run(f"schema: 1\n{line}\n", "bench.yaml"), "--out", disk.folder / "out")
    assert (ended.code, ended.out) == (2, "")
    assert message in ended.err
    assert not (disk.folder / "out").exists()
