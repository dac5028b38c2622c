"""The contract of every study: a table, samples with units and pictures; one sentence for a mistake in its file."""

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

Command = Callable[..., SimpleNamespace]
Row = dict[str, str]

BENCH = "schema: 1\nsizes: [3]\nframes: 1\nrepeats: 1\nmemory: [3]\nlimits: {nodal: 3}\n"
EXTREMES = "schema: 1\ngrid: {sizes: [[2, 3]], decades: [1], noise: [0]}\nstructured: {sizes: []}\n"
WEIGHTS = (
    "schema: 1\nrecordings: [small.h5]\nestimators:\n  g: {terms: {misfit: {}, gradient: {weight: auto}}}\n"
    "  d: {terms: {misfit: {weighting: noise}, relative_change: {weight: 10}}}\n"
)
GRADIENT_ALONE = WEIGHTS.split("  d:")[0]
SETTINGS = {
    "bench": BENCH + "estimators: {mine: {terms: {misfit: {}, gradient: {weight: 2}}}}\n",
    "extremes": EXTREMES + "estimators: {mine: {terms: {misfit: {}}}}\n",
    "tradeoff": "schema: 1\nrecordings: [small.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n"
    "formulations: [scaled, reduced]\nframes: 2\nrepeats: 1\nmemory: LSM\n",
    "weights": WEIGHTS + "  both: {terms: {misfit: {}, gradient: {weight: auto}, cell_resistance: {weight: auto}}}\n",
}
UNKNOWN_NOISE = "panel: {rows: 3, columns: 4, pitch_mm: 10}\nseries_resistance_ohm: 140\n"


def check_bench(rows: list[Row], group: h5py.Group, out: str) -> None:
    assert [(row["method"], row["solver"], row["frames"]) for row in rows] == [
        (method, solver, frames)
        for method in ("all", "mine")
        for solver in ("reduced", "nodal")
        for frames in ("first", "later")
    ]
    assert all(20 < float(row["memory_mb"]) < 2000 for row in rows)
    assert [*group["solver"][:2]] == [b"reduced", b"nodal"] and list(group["frame"]) == [0, 0, 1, 1]
    assert np.all(group["memory_mb"][()] > 20) and np.all(group["inverse_s"][()] > 0)
    assert group["status"][0] == b"optimum verified"
    assert "verified" in out


def check_extremes(rows: list[Row], group: h5py.Group, out: str) -> None:
    (row,) = rows
    assert (row["case"], row["method"], row["solves"], row["verified"]) == ("log-uniform", "mine", "2", "2")
    assert list(group["part"]) == [b"baseline", b"frame"]
    assert "2 of 2 solves end with a verified optimum or a sentence (100.00 %)" in out


def check_tradeoff(rows: list[Row], group: h5py.Group, out: str) -> None:
    assert {row["formulation"] for row in rows} == {"scaled", "reduced"}
    assert all(float(row["memory_mb"]) > 10 for row in rows)
    assert group.attrs["signal"] == b"seconds" and group["gap"].dims[0][0].name.endswith("/record")
    assert list(group["solver"]) == [b"scaled"] * 2 + [b"reduced"] * 2


def check_weights(rows: list[Row], group: h5py.Group, out: str) -> None:
    table = {(row["estimator"], row["rule"]): row for row in rows}
    assert {name for name, _ in table} == {"g", "d"} and ("g", "given") not in table
    assert table["g", "risk"]["in_use"] == table["d", "given"]["in_use"] == "1"
    assert float(table["d", "given"]["weight"]) == 10 and float(table["g", "best"]["over_best"]) == 1
    assert table["g", "risk"]["weight_unit"] == "ohm^2/(ohm per cell)^2"
    assert table["d", "risk"]["weight_unit"] == "1/percent^2"
    assert group.attrs["signal"] == b"risk" and group["misfit"].dims[0][0].name.endswith("/weight")
    assert len(group["error"]) >= 33
    chosen = dict(zip(group["choices/rule"][()], group["choices/weight"][()], strict=True))
    assert np.isclose(chosen[b"risk"], float(table["g", "risk"]["weight"]), rtol=1e-5)
    assert np.any(group["weight"][()] == chosen[b"risk"])
    assert "best" in out and "Morozov" in out


CHECKS = {
    "bench": ("frames", check_bench),
    "extremes": ("solves", check_extremes),
    "tradeoff": ("frames", check_tradeoff),
    "weights": ("small/g", check_weights),
}
STEMS = {"weights": "tune"}  # of the files, where it is not the study's name
PICTURED = ("tradeoff", "weights")
SLOW = {"bench": pytest.mark.slow}


def studied(
    lampest: Command, disk: SimpleNamespace, study: str, text: str, *words: str
) -> tuple[SimpleNamespace, Path]:
    """Run a study on a file of that text; return how it ended, and its folder."""
    out = disk.folder / "out"
    return lampest("study", study, disk.run(text, f"{study}.yaml"), "--out", out, *words), out


def table_of(out: Path, study: str) -> list[Row]:
    with (out / f"{STEMS.get(study, study)}.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
@pytest.mark.parametrize("study", [pytest.param(name, marks=SLOW.get(name, ())) for name in SETTINGS])
def test_a_study_writes_its_table_its_samples_with_units_and_its_pictures(
    study: str, disk: SimpleNamespace, lampest: Command
) -> None:
    done, out = studied(lampest, disk, study, SETTINGS[study])
    left_out = "small/both left out: it has 2 penalty terms, not one" if study == "weights" else ""
    assert done.code == 0 and left_out in done.err and bool(done.err) == bool(left_out), done.err
    assert max(map(len, done.out.splitlines())) <= 100 + len(str(disk.folder))
    place, check = CHECKS[study]
    with h5py.File(out / f"{STEMS.get(study, study)}.h5") as file:
        group = file[f"entry/{place}"]
        for name, values in group.items():
            if isinstance(values, h5py.Dataset):
                assert (
                    values.attrs["units"]
                    and values.attrs["long_name"]
                    and len(values) == len(next(iter(group.values())))
                ), name
        check(table_of(out, study), group, done.out)
    pictures = [*out.glob("*.png")]
    assert bool(pictures) == (study in PICTURED)
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)


def test_weights_without_noise_and_truth_are_chosen_by_risk_alone(disk: SimpleNamespace, lampest: Command) -> None:
    path = disk.recording(disk.folder / "small.h5", scene=UNKNOWN_NOISE)
    with h5py.File(path, "a") as file:
        del file["entry/truth"]
    done, out = studied(lampest, disk, "weights", GRADIENT_ALONE + "bounds: {upper: none}\n")
    assert done.code == 0, done.err
    rules = {row["rule"]: row for row in table_of(out, "weights")}
    assert set(rules) == {"risk", "Morozov", "L-curve"}
    assert rules["risk"]["in_use"] == "1" and rules["Morozov"]["weight"] == ""
    assert {row["rms_log_error"] for row in rules.values()} == {""}


def test_a_rule_that_needs_the_noise_is_refused_without_it(disk: SimpleNamespace, lampest: Command) -> None:
    disk.recording(disk.folder / "small.h5", scene=UNKNOWN_NOISE)
    text = GRADIENT_ALONE + "bounds: {upper: none}\nauto_weight: {rule: evidence}\n"
    done, out = studied(lampest, disk, "weights", text)
    assert done.code == 2 and "auto_weight.rule: evidence needs the noise" in done.err
    assert not out.exists()


@pytest.mark.slow
def test_settings_of_the_command_override_the_file_of_a_study(disk: SimpleNamespace, lampest: Command) -> None:
    setting = ("--set", "estimators.g.terms.gradient.weight=0.002")
    done, out = studied(lampest, disk, "weights", GRADIENT_ALONE, *setting)
    assert done.code == 0, done.err
    (given,) = (row for row in table_of(out, "weights") if row["rule"] == "given")
    assert float(given["weight"]) == 0.002
