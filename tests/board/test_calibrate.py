"""The simulated board with known resistors in place of the panel: recorded, calibrated, recorded again."""

from pathlib import Path

import numpy as np
import pytest
from board.bench import bench, scene

from lampest import Recording
from lampest.estimate.calibration.resistors import ResistorCalibration, calibrate_resistors
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
