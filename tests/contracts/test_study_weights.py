"""The command `lampest study weights`: what is written, what is left out, what is refused."""

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

TUNE = """\
schema: 1
recordings: [small.h5]
estimators:
  g: {terms: {misfit: {}, gradient: {weight: auto}}}
  d: {terms: {misfit: {weighting: noise}, relative_change: {weight: 10}}}
  both: {terms: {misfit: {}, gradient: {weight: auto}, cell_resistance: {weight: auto}}}
"""
UNKNOWN = "panel: {rows: 3, columns: 4, pitch_mm: 10}\nseries_resistance_ohm: 140\n"


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "tune.csv").open() as stream:
        return list(csv.DictReader(stream))


def test_command_writes_table_curves_and_figures(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], disk: SimpleNamespace
) -> None:
    out = tmp_path / "out"
    done = lampest("study", "weights", disk.run(TUNE, "tune.yaml"), "--out", out)
    assert done.code == 0, done.err
    assert "best" in done.out and "Morozov" in done.out
    assert "small/both left out: it has 2 penalty terms, not one" in done.err
    table = {(row["estimator"], row["rule"]): row for row in rows(out)}
    assert {name for name, _ in table} == {"g", "d"}
    assert table["g", "risk"]["in_use"] == "1"
    assert table["d", "given"]["in_use"] == "1"
    assert float(table["d", "given"]["weight"]) == 10
    assert table["g", "risk"]["weight_unit"] == "ohm^2/(ohm per cell)^2"
    assert table["d", "risk"]["weight_unit"] == "1/percent^2"
    assert float(table["g", "best"]["over_best"]) == 1
    assert ("g", "given") not in table
    for name in ("g", "d"):
        assert (out / f"tune_small_{name}.png").read_bytes().startswith(b"\x89PNG")
    with h5py.File(out / "tune.h5") as file:
        group = file["entry/small/g"]
        assert group.attrs["signal"] == b"risk"
        for name in ("weight", "misfit", "penalty", "evidence", "risk", "error", "open_cells", "solved"):
            assert group[name].attrs["units"], name
            assert group[name].attrs["long_name"], name
            assert len(group[name]) >= 33
        assert group["misfit"].dims[0][0].name.endswith("/weight")
        chosen = dict(zip(group["choices/rule"][()], group["choices/weight"][()], strict=True))
        assert np.isclose(chosen[b"risk"], float(table["g", "risk"]["weight"]), rtol=1e-5)
        assert np.any(group["weight"][()] == chosen[b"risk"])


def test_without_noise_and_truth_there_is_press_alone(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], disk: SimpleNamespace
) -> None:
    path = disk.recording(tmp_path / "small.h5", scene=UNKNOWN)
    with h5py.File(path, "a") as file:
        del file["entry/truth"]
    text = TUNE.split("  d:")[0] + "bounds: {upper: none}\n"
    done = lampest("study", "weights", disk.run(text, "tune.yaml"), "--out", tmp_path / "out")
    assert done.code == 0, done.err
    found = {row["rule"]: row for row in rows(tmp_path / "out")}
    assert set(found) == {"risk", "Morozov", "L-curve"}
    assert found["risk"]["in_use"] == "1"
    assert found["Morozov"]["weight"] == ""
    assert {row["rms_log_error"] for row in found.values()} == {""}


def test_rule_that_needs_the_noise_is_refused_without_it(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], disk: SimpleNamespace
) -> None:
    disk.recording(tmp_path / "small.h5", scene=UNKNOWN)
    text = TUNE.split("  d:")[0] + "bounds: {upper: none}\nauto_weight: {rule: evidence}\n"
    done = lampest("study", "weights", disk.run(text, "tune.yaml"), "--out", tmp_path / "out")
    assert done.code == 2
    assert "auto_weight.rule: evidence needs the noise" in done.err
    assert not (tmp_path / "out").exists()


def test_settings_override_the_file(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], disk: SimpleNamespace
) -> None:
    text = TUNE.split("  d:")[0]
    setting = "estimators.g.terms.gradient.weight=0.002"
    done = lampest("study", "weights", disk.run(text, "tune.yaml"), "--out", tmp_path / "out", "--set", setting)
    assert done.code == 0, done.err
    (given,) = (row for row in rows(tmp_path / "out") if row["rule"] == "given")
    assert float(given["weight"]) == 0.002


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  g: {terms: {misfit: {}, gradient: {weight: auto}}}\n", "  g: {terms: {misfit: {}}}\n", "nothing to tune"),
        ("weight: auto", "wieght: auto", "no such key"),
        ("small.h5", "absent.h5", "no such file"),
        ("weight: auto", "weight: -1", "weight"),
    ],
)
def test_faults_are_one_sentence(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], disk: SimpleNamespace, old: str, new: str, words: str
) -> None:
    text = TUNE.split("  d:")[0]
    assert old in text
    done = lampest("study", "weights", disk.run(text.replace(old, new), "tune.yaml"), "--out", tmp_path / "out")
    assert done.code == 2
    assert words in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
