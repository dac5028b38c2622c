"""The chain through the real commands: ports, record, repair, calibrate, run."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from apps.board.bench import bench, lampest, loaded_scene, random_cells, scene

from lampest import UNLOADED, Recording, Scene, read_results
from lampest.files.document import read_document, to_yaml, validated

LAMPREY = Path(__file__).parents[3] / "data" / "lamprey_35mm.h5"
MIN_GAIN = 5  # error of apparent resistances over that of estimates
SERIES_ERROR_OHM = 0.5  # a code of 10 bits is 1.3 ohm there


@pytest.mark.slow
@pytest.mark.parametrize("wiring", ["two_point", "loaded_columns"])
def test_recorded_board_frames_give_the_cells(tmp_path: Path, wiring: str) -> None:
    """The shipped lamprey: record → a file in ohm or volt → run → the truth."""
    shipped = Recording.load(LAMPREY)
    truth = shipped.truth_cell_resistance
    baseline = int(np.sum(shipped.role == UNLOADED))
    out = tmp_path / "r.h5"
    known = scene() if wiring == "two_point" else loaded_scene()
    (tmp_path / "scene.yaml").write_text(to_yaml(known))
    with bench(tmp_path, truth, wiring=wiring) as board:
        words = (
            "--port",
            board.port,
            "--out",
            out,
            "--scene",
            tmp_path / "scene.yaml",
            "--baseline",
            baseline,
        )
        output, complained = lampest("record", *words, "--count", len(truth))
    assert output.startswith(
        f"{len(truth)} frames, 0 lost, 0 restarts of the board, noise of one reading 0."
    )
    assert complained == "" and "frames     24: 3 unloaded, 21 measured" in lampest("info", out)[0]
    group, signal, unit = (
        ("two_point", "resistance", "ohm")
        if wiring == "two_point"
        else ("readings", "volt", "volt")
    )
    with h5py.File(out) as file:
        assert file["entry"].attrs["default"].decode() == group
        assert file[f"entry/{group}"].attrs["signal"].decode() == signal
        assert file[f"entry/{group}/{signal}"].attrs["units"].decode() == unit
    recording = Recording.load(out)
    assert recording.scene == known
    (tmp_path / "run.yaml").write_text(
        "schema: 1\nrecordings: [r.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n"
    )
    lampest(
        "run", tmp_path / "run.yaml", "--out", tmp_path / "results", "--set", "formulation=reduced"
    )
    (case,) = read_results(tmp_path / "results" / "results.h5").cases
    error = np.median(np.abs(case.cell_resistance / truth[baseline:] - 1))
    assert case.solved.all() and error <= (0.01 if wiring == "two_point" else 0.02)
    naive = known.circuit.apparent_resistance(recording.recorded[baseline:])
    assert np.median(np.abs(naive / truth[baseline:] - 1)) > MIN_GAIN * error


@pytest.mark.slow
def test_shorted_lines_calibrate_the_next_recording(tmp_path: Path) -> None:
    shorted = tmp_path / "shorted.h5"
    scene = tmp_path / "scene.yaml"
    with bench(tmp_path, np.full((1, 10, 10), 1e-3)) as board:
        _, complained = lampest("record", "--port", board.port, "--out", shorted, "--seconds", 10)
    assert (
        complained.startswith("lampest: no series resistance is assumed")
        and complained.count("\n") == 1
    )
    output, _ = lampest("calibrate", shorted, "--out", scene)
    assert output.startswith("series resistance 1") and str(scene) in output
    calibrated: Scene = validated(read_document(scene), Scene)
    assert calibrated.series_resistance_ohm == pytest.approx(140, abs=SERIES_ERROR_OHM)
    printed, _ = lampest("calibrate", shorted)
    assert printed == scene.read_text()
    with bench(tmp_path, random_cells(np.random.default_rng(1), 1)) as board:
        words = ("--port", board.port, "--out", tmp_path / "r.h5", "--scene", scene, "--count", 1)
        assert lampest("record", *words)[1] == ""
    assert Recording.load(tmp_path / "r.h5").scene == calibrated


@pytest.mark.slow
def test_record_lists_ports_or_says_that_there_are_none() -> None:
    output, complained = lampest("record", "--list")
    assert bool(output) != ("there is no serial port" in complained)
    assert os.linesep not in complained.rstrip()
