"""The simulated board with known resistors in place of the panel: recorded, calibrated, recorded again."""

import re
from pathlib import Path

import numpy as np
import pytest
from board.bench import bench, lampest, loaded_scene, scene, some_cells

from lampest import Estimator, Misfit, Recording, Scene
from lampest.estimate.calibration.resistors import ResistorCalibration, calibrate_resistors
from lampest.estimate.sequence import reconstruct
from lampest.files.document import read_document, to_yaml, validated
from lampest.recording.board.record import record

OPEN = 1e15


def from_board(folder: Path, cells: np.ndarray, *options: object, frames: int = 5) -> Recording:
    rows, columns = cells.shape
    with bench(folder, np.where(np.isinf(cells), OPEN, cells)[None], *options) as board:
        known = scene(rows, columns, series_resistance_ohm=0)
        return Recording.load(record(board.port, folder / "r.h5", frames=frames, scene=known).path)


def series(estimate: ResistorCalibration) -> float:
    return estimate.numbers[0].value


def test_shorted_lines_and_some_known_resistors_give_the_two_multiplexers(tmp_path: Path) -> None:
    """Short circuits, 470 ohm at every crossing, where the divider sees best, or 220 ohm at a few."""
    few = np.full((6, 5), np.inf)
    few[np.arange(5), np.arange(5)] = 220.0
    for cells in (np.full((10, 10), 1e-6), np.full((10, 10), 470.0), few):
        estimate = calibrate_resistors([from_board(tmp_path, cells)], [cells])
        (tmp_path / "r.h5").unlink()
        rows, known = estimate.numbers[0].lines[0].off_ohm, np.isfinite(cells)
        assert series(estimate) == pytest.approx(140, abs=0.5 if cells is few else 0.3)
        assert estimate.readings == known.sum() and not estimate.numbers[0].differ
        np.testing.assert_array_equal(np.isfinite(rows), known.any(axis=1))


def test_channels_that_differ_are_found_and_written(tmp_path: Path) -> None:
    rows, columns = np.array([60, 70, 80, 65.0]), np.array([100, 70, 85.0])
    options = ("--row-ohm", ",".join(map(str, rows)), "--column-ohm", ",".join(map(str, columns)))
    found = calibrate_resistors([from_board(tmp_path, np.full((4, 3), 1e-6), *options, frames=10)])
    assert found.numbers[0].differ
    assert series(found) == pytest.approx(rows.mean() + columns.mean(), abs=0.5)
    for lines, true in zip(found.numbers[0].lines, (rows, columns), strict=True):
        np.testing.assert_allclose(lines.off_ohm, true - true.mean(), atol=5 * np.max(lines.sigma_ohm))
    np.testing.assert_allclose(found.scene.series_ohm, rows[:, None] + columns, atol=1)


@pytest.mark.slow
def test_three_resistors_on_the_loaded_board_make_the_scene_that_records_the_panel(tmp_path: Path) -> None:
    """Channels of 100 ohm and loads of 9.8 kΩ that nobody knew: calibrated by the commands, cells come back."""
    rng = np.random.default_rng(4)
    options = ("--row-ohm", 100, "--load-ohm", 9_800)
    cells, table = np.full((1, 8, 8), OPEN), np.full((8, 8), np.inf)
    cells[0, 0, :3] = table[0, :3] = [1000, 3300, 10_000]
    np.savetxt(tmp_path / "known.csv", table, delimiter=",")
    (tmp_path / "told.yaml").write_text(to_yaml(loaded_scene(8, 8)))
    with bench(tmp_path, cells, *options, wiring="loaded_columns") as board:
        words = ("--port", board.port, "--scene", tmp_path / "told.yaml", "--count", 20)
        lampest("record", *words, "--out", tmp_path / "known.h5")
    words = (tmp_path / "known.h5", "--known", tmp_path / "known.csv", "--tolerance", 0.001)
    said, _ = lampest("calibrate", *words, "--out", tmp_path / "scene.yaml")
    stated = re.findall(r"(\w+) resistance ([\d.]+) ± ([\d.]+) ohm", said)
    assert [name for name, *_ in stated] == ["drive", "load"]
    for (_, ohm, sigma), true in zip(stated, (100, 9_800), strict=True):
        assert abs(float(ohm) - true) < 3 * float(sigma)
    found: Scene = validated(read_document(tmp_path / "scene.yaml"), Scene)
    truth = some_cells(rng, 2, 8, 8)
    with bench(tmp_path, truth, *options, wiring="loaded_columns") as board:
        words = ("--port", board.port, "--scene", tmp_path / "scene.yaml", "--count", 2)
        lampest("record", *words, "--out", tmp_path / "panel.h5")
    recorded = Recording.load(tmp_path / "panel.h5")
    assert recorded.scene == found
    errors = []
    for known in (found, loaded_scene(8, 8)):
        changed = Recording(known, recorded.recorded, recorded.time, recorded.role)
        cells = reconstruct(changed, Estimator((Misfit(),), "reduced")).cell_resistance
        errors.append(float(np.median(np.abs(cells / truth - 1))))
    assert errors[0] < 0.02 and errors[0] < errors[1], (errors, said)
