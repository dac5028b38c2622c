"""The command `lampest study extremes`: what is written, what is refused."""

import csv
from collections.abc import Callable
from types import SimpleNamespace

import h5py
import pytest

Command = Callable[..., SimpleNamespace]


def test_command_writes_table_samples_and_figure(disk: SimpleNamespace, lampest: Command) -> None:
    text = "schema: 1\ngrid: {sizes: [[2, 3]], decades: [1], noise: [0]}\nstructured: {sizes: []}\n"
    text += "estimators: {mine: {terms: {misfit: {}}}}\n"
    ended = lampest("study", "extremes", disk.run(text, "edge.yaml"), "--out", disk.folder / "out")
    assert (ended.code, ended.err) == (0, "")
    for words in ("2 of 2 solves end with a verified optimum or a sentence (100.00 %)", "extremes.csv", "extremes.h5"):
        assert words in ended.out
    assert (disk.folder / "out" / "extremes.png").stat().st_size > 1000
    with (disk.folder / "out" / "extremes.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["case"], row["method"], row["solves"], row["verified"]) == ("log-uniform", "mine", "2", "2")
    with h5py.File(disk.folder / "out" / "extremes.h5") as file:
        group = file["entry/solves"]
        for dataset in group.values():
            assert dataset.attrs["units"] and dataset.attrs["long_name"]
            assert dataset.shape == (2,)
        assert list(group["part"]) == [b"baseline", b"frame"]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("grid: {sizes: []}\nstructured: {sizes: []}", "hold no scene"),
        ("grid: {sizes: [99]}\nstructured: {sizes: []}", "a panel's side must lie between 1 and 64"),
        ("grid: {sizes: [3], decades: [99]}\nstructured: {sizes: []}", "decades must lie between 0 and 15"),
        ("grid: {sizes: [3], noise: [-1]}\nstructured: {sizes: []}", "noise must lie between 0 and 100 percent"),
        ("grid: {sizes: [3], seeds: -1}\nstructured: {sizes: []}", "seeds must lie between 0 and 1000"),
        ("grid: {sizes: [3]}\nstructured: {sise: []}", "edge.yaml:3:14: structured.sise: no such key"),
        ("grid: {sizes: [3]}\nstructured: {sizes: []}\nestimators: {}", "estimators must hold at least one"),
    ],
)
def test_wrong_files_are_one_sentence(line: str, message: str, disk: SimpleNamespace, lampest: Command) -> None:
    ended = lampest("study", "extremes", disk.run(f"schema: 1\n{line}\n", "edge.yaml"), "--out", disk.folder / "out")
    assert (ended.code, ended.out) == (2, "")
    assert message in ended.err
    assert not (disk.folder / "out").exists()
