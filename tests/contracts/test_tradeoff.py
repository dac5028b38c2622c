"""The trade-off on tiny panels: what is written, what is judged, what is refused. No timing is asserted."""

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from lampest.studies.tradeoff.report import front, on_front, summary_rows
from lampest.studies.tradeoff.run import Tradeoff, run_tradeoff
from lampest.studies.tradeoff.settings import label, read_plan

TINY = """\
schema: 1
simulated:
  sizes: [8, [8, 9]]
  noise: {10bit: {}}
  scenes: {clean: {}, realistic: {channel_spread_ohm: 3, drift_per_minute: 0.01}}
estimators:
  LSM: {terms: {misfit: {}}}
  LSR-dCR: {terms: {misfit: {}, relative_change: {weight: 10}}}
efforts: [two_point, scaled, linearised, {kind: truncated, steps: 2}, region, reduced, nodal]
frames: 3
repeats: 2
limits: {nodal: 8}
"""
RUNGS = ["two_point", "scaled", "linearised", "truncated 2", "region", "reduced", "nodal"]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Tradeoff:
    path = tmp_path_factory.mktemp("tradeoff") / "tiny.yaml"
    path.write_text(TINY)
    return run_tradeoff(read_plan(path))


def test_every_rung_is_measured_with_every_method_on_every_recording(found: Tradeoff) -> None:
    names = {(one.subject.recording.name, one.method, one.effort) for one in found.measured}
    assert len(names) == len(found.measured) == 2 * 2 * (7 + 6)
    assert {one.effort for one in found.measured} == set(RUNGS)
    for one in found.measured:
        # A rung that takes long is not repeated.
        assert one.wall.shape == one.cpu.shape
        assert one.wall.shape[0] == 3
        assert one.wall.shape[1] in (1, 2)
        assert one.cell_error.shape == one.gap.shape == one.iterations.shape == (3,)
        assert one.solved.all()


def test_gap_is_judged_by_one_cost_and_is_zero_for_the_best(found: Tradeoff) -> None:
    least = {}
    for one in found.measured:
        key = (one.subject.recording.name, one.method)
        least[key] = np.minimum(least.get(key, np.inf), one.objective)
    for one in found.measured:
        assert np.all(one.gap >= 0)
        assert np.all((one.gap == 0) == (one.objective == least[one.subject.recording.name, one.method]))
        if one.effort == "nodal":
            assert np.all(one.gap < 1e-3)
        if one.effort == "two_point":
            assert np.all(one.gap > 1)


def test_no_reconstruction_errs_by_what_it_ignores(found: Tradeoff) -> None:
    rows = {row.effort: row for row in summary_rows(found) if (row.rows, row.columns) == (8, 8)}
    assert rows["two_point"].cell_error > 60
    assert rows["reduced"].reached > 0.9
    assert rows["reduced"].memory_mb is None


def test_front_holds_what_nothing_beats() -> None:
    assert front([(3, 1), (1, 5), (2, 5), (2, 2), (4, 1), (5, 0)]) == [1, 3, 0, 5]
    assert front([]) == []


def test_fastest_rung_is_on_the_front(found: Tradeoff) -> None:
    rows = [row for row in summary_rows(found) if (row.rows, row.columns) == (8, 8)]
    assert min(rows, key=lambda row: row.frame_ms).effort in on_front(rows)


def test_command_writes_table_samples_and_figure(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace], disk: SimpleNamespace
) -> None:
    config = tmp_path / "one.yaml"
    config.write_text(
        "schema: 1\nrecordings: [small.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n"
        "efforts: [scaled, reduced]\nframes: 2\nrepeats: 1\nmemory: LSM\n"
    )
    done = lampest("tradeoff", config, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    assert "reduced" in done.out
    with (tmp_path / "out" / "tradeoff.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["effort"] for row in rows} == {"scaled", "reduced"}
    assert all(float(row["memory_mb"]) > 10 for row in rows)
    assert (tmp_path / "out" / "tradeoff.png").read_bytes().startswith(b"\x89PNG")
    with h5py.File(tmp_path / "out" / "tradeoff.h5") as file:
        group = file["entry/small/LSM/reduced"]
        assert group.attrs["signal"] == b"wall_time"
        for name in group:
            assert group[name].attrs["units"], name
            assert group[name].attrs["long_name"], name
        assert group["gap"].dims[0][0].name.endswith("/frame")
        assert group["wall_time"].shape == (2, 1)


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("region,", "regoin,", "9:", "efforts.4"),
        ("steps: 2", "steps: 0", "9:", "efforts.3"),
        (" reduced,", "", ":", "reduced"),
        ("scaled,", "two_point,", ":", "twice"),
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
    assert old in TINY
    config.write_text(TINY.replace(old, new, 1))
    done = lampest("tradeoff", config, "--out", tmp_path / "out")
    assert done.code == 2
    assert place in done.err and words in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_shipped_file_is_valid() -> None:
    plan = read_plan(Path(__file__).parents[2] / "configs" / "tradeoff.yaml")
    assert {label(effort) for effort in plan.settings.ladder} >= set(RUNGS)
    assert {subject.shape for subject in plan.subjects} == {(10, 10), (16, 16), (32, 32), (100, 100)}
