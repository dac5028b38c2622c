"""Advice: suggestions beyond the scene that a recording supports."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from promises import promise
from ruamel.yaml import YAML

import lampest
from lampest import Recording, read_scene

PASTE = "write into the scene, in place of its entries of these names:"
Command = Callable[..., SimpleNamespace]

SHAPE = (8, 8)
RIGHT = lampest.LoadedColumnsReadout(
    polarity="up", drive_ohm=150.0, load_ohm=10_000.0, adc_bits=10, readings=1, noise_lsb=1.0
)
WRONG_READOUT = lampest.GroundedReadout(
    sense="all", drive_ohm=150.0, load_ohm=10_000.0, adc_bits=10, readings=1, noise_lsb=1.0
)


def written(path: Path, dead_row: int | None = None, readout: lampest.Readout = RIGHT) -> Path:
    """Write a recording of three pressed corners of a square, made by loaded columns."""
    rng = np.random.default_rng(5)
    cells = np.repeat(8000 * np.exp(0.1 * rng.standard_normal((1, *SHAPE))), 12, axis=0)
    for row, column in ((1, 1), (1, 2), (2, 1)):
        cells[6:, row, column] = 800.0
    if dead_row is not None:
        cells[:, dead_row] = 1e10
    volts = np.stack([RIGHT.exact_reading(frame) for frame in cells])
    codes = np.rint(volts / 5 * 1024 + rng.standard_normal(volts.shape))
    scene = lampest.Scene(lampest.Panel(*SHAPE), readout)
    lampest.Recording.from_array(
        np.clip(codes, 0, 1023).astype(int), unit="code", baseline=6, scene=scene
    ).save(path)
    return path


@pytest.mark.slow
def test_a_clean_recording_has_no_advice(tmp_path: Path, lampest: Command) -> None:
    output = lampest("info", written(tmp_path / "clean.h5")).out
    assert "model      yes" in output and "advice" not in output
    assert (
        lampest("info", tmp_path / "clean.h5", "--apply")
        .out.strip()
        .endswith("no advice has a line to write")
    )


@pytest.mark.slow
@promise(
    "theory/model_check: `lampest info FILE --apply` writes the lines into the recording's scene"
)
@pytest.mark.parametrize(
    ("readout", "dead_row", "words"),
    [
        pytest.param(WRONG_READOUT, None, "kind: loaded_columns", marks=pytest.mark.slow),
        (RIGHT, 5, "dead_rows"),
    ],
    ids=["another circuit", "a dead row"],
)
def test_apply_writes_the_lines_into_the_scene(
    readout: lampest.Readout, dead_row: int | None, words: str, tmp_path: Path, lampest: Command
) -> None:
    path = written(tmp_path / "mine.h5", dead_row, readout)
    assert "advice" in lampest("info", path).out
    original = path.read_bytes()
    applied = lampest("info", path, "--apply").out
    assert words in applied and applied.startswith("written to the scene")
    assert path.with_suffix(".before.h5").read_bytes() == original
    completed = lampest("info", path)
    assert completed.code == 0, completed.err
    output = completed.out
    advised = output.split("advice")[1].split("readings")[0] if "advice" in output else ""
    assert "model      yes" in output and words not in advised


@pytest.mark.slow
@promise("theory/model_check: `lampest info` prints the entries as they stand in the scene")
@pytest.mark.parametrize(
    ("readout", "dead_row"),
    [pytest.param(WRONG_READOUT, None, marks=pytest.mark.slow), (RIGHT, 5)],
    ids=["another circuit", "a dead row"],
)
def test_printed_entries_replace_those_of_the_scene(
    readout: lampest.Readout, dead_row: int | None, tmp_path: Path, lampest: Command
) -> None:
    """Pasted over the entries of the same names they make the scene that --apply writes."""
    path = written(tmp_path / "mine.h5", dead_row, readout)
    original = path.read_bytes()
    earlier = tmp_path / "mine.before.h5"
    earlier.write_bytes(b"kept by an earlier call")
    output = lampest("info", path).out
    if dead_row is not None:
        assert "row is dead: 5" in output and "faults: {dead_rows: [5]}" in output
        assert "model      doubtful" in output
    entries = YAML(typ="safe").load(output.partition(f"{PASTE}\n")[2])
    with h5py.File(path) as file:
        before = YAML(typ="safe").load(file["/entry/scene"][()].decode())
    pasted = tmp_path / "scene.yaml"
    YAML(typ="safe").dump(before | entries, pasted)
    applied = lampest("info", path, "--apply")
    assert applied.code == 0 and f"the file before: {tmp_path / 'mine.before2.h5'}" in applied.out
    assert earlier.read_bytes() == b"kept by an earlier call"
    assert (tmp_path / "mine.before2.h5").read_bytes() == original
    scene = Recording.load(path).scene
    assert entries and read_scene(pasted) == replace(scene, assumed=read_scene(pasted).assumed)


@pytest.mark.slow
def test_apply_refuses_results_and_leaves_them(tmp_path: Path, lampest: Command) -> None:
    results = tmp_path / "results.h5"
    _reconstructed(written(tmp_path / "clean.h5")).save(results)
    original = results.read_bytes()
    refused = lampest("info", results, "--apply")
    assert (
        refused.code == 2
        and "name the recording" in refused.err
        and results.read_bytes() == original
    )


@pytest.mark.slow
def test_python_and_runs_give_the_same_advice(tmp_path: Path, lampest: Command) -> None:
    path = written(tmp_path / "dead.h5", dead_row=5)
    estimate = _reconstructed(path)
    [line] = [text for text in estimate.advice if text.startswith("row is dead")]
    assert (
        estimate.model_check.mark == "doubtful"
        and "row is dead: 5" in estimate.model_check.sentence
    )
    (tmp_path / "run.yaml").write_text(
        "schema: 1\nrecordings: [dead.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n"
    )
    output = lampest("run", tmp_path / "run.yaml", "--out", tmp_path / "results").out
    assert f"advice: dead: {line}" in " ".join(output.split())
    assert line in lampest("info", tmp_path / "results" / "results.h5").out


def _reconstructed(path: Path) -> lampest.Reconstruction:
    return lampest.reconstruct(lampest.Recording.load(path), [lampest.Misfit()], error_bars=False)
