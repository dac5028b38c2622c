"""Series resistance from shorted lines and from known resistors, alone and from the simulated board."""

from pathlib import Path

import numpy as np
import pytest
from board.bench import bench, scene, some_cells

from lampest import InputError, Recording, Scene
from lampest.files.document import parse_document, validated
from lampest.recording.board.calibrate import calibrate, calibrated_scene, calibrated_scene_text
from lampest.recording.board.record import record


def from_board(folder: Path, cells: np.ndarray, *options: object, frames: int = 5) -> Recording:
    rows, columns = cells.shape
    with bench(folder, cells[None], *options) as board:
        known = scene(rows, columns, series_resistance_ohm=0)
        return Recording.load(record(board.port, folder / "r.h5", frames=frames, scene=known).path)


def test_shorted_lines_give_the_two_multiplexers(tmp_path: Path) -> None:
    found = calibrate(from_board(tmp_path, np.full((10, 10), 1e-6)))
    assert found.series_ohm == pytest.approx(140, abs=0.3)
    assert abs(found.series_ohm - 140) < 4 * found.sigma_ohm + 0.05
    assert not found.lines_differ and found.cells == 100


def test_known_resistors_give_the_same(tmp_path: Path) -> None:
    """470 ohm at every crossing: the network stays below the reference resistor, where the divider sees best."""
    found = calibrate(from_board(tmp_path, np.full((10, 10), 470.0)), 470.0)
    assert found.series_ohm == pytest.approx(140, abs=0.3)


def test_some_known_resistors_and_open_crossings_will_do(tmp_path: Path) -> None:
    cells = np.full((6, 5), np.inf)
    cells[np.arange(5), np.arange(5)] = 220.0
    found = calibrate(from_board(tmp_path, np.where(np.isinf(cells), 1e15, cells)), cells)
    assert found.series_ohm == pytest.approx(140, abs=0.5)
    assert found.cells == 5
    assert np.isnan(found.row_ohm[5]) and np.isfinite(found.row_ohm[:5]).all()


def test_channels_that_differ_are_found_and_reported(tmp_path: Path) -> None:
    rows, columns = np.array([60, 70, 80, 65.0]), np.array([100, 70, 85.0])
    options = ("--row-ohm", ",".join(map(str, rows)), "--column-ohm", ",".join(map(str, columns)))
    recording = from_board(tmp_path, np.full((4, 3), 1e-6), *options, frames=10)
    found = calibrate(recording)
    assert found.lines_differ
    assert found.series_ohm == pytest.approx(rows.mean() + columns.mean(), abs=0.5)
    np.testing.assert_allclose(found.row_ohm, rows - rows.mean(), atol=5 * found.line_sigma_ohm)
    np.testing.assert_allclose(found.column_ohm, columns - columns.mean(), atol=5 * found.line_sigma_ohm)
    assert "row lines differ" in calibrated_scene_text(recording.scene, found)


def test_the_stated_uncertainty_is_that_of_repeated_calibrations() -> None:
    """40 invented recordings: the results scatter as sigma_ohm says."""
    from lampest.recording.simulation.measure import measured
    from lampest.recording.simulation.unmodelled import Unmodelled

    known, cells = scene(), np.repeat(some_cells(np.random.default_rng(1), 1), 4, axis=0)
    found = []
    for seed in range(40):
        resistance, _ = measured(known, cells, Unmodelled(), seed)
        recording = Recording(known, resistance, np.arange(4.0), np.ones(4, dtype=np.uint8))
        found.append(calibrate(recording, cells[0]))
    error = np.array([one.series_ohm - 140 for one in found]) / np.array([one.sigma_ohm for one in found])
    assert abs(error.mean()) < 0.6
    assert 0.7 < error.std() < 1.4
    assert sum(one.lines_differ for one in found) == 0


def test_the_scene_that_is_written_can_be_read_and_says_how_sure_it_is(tmp_path: Path) -> None:
    recording = from_board(tmp_path, np.full((3, 3), 1e-6))
    found = calibrate(recording)
    text = calibrated_scene_text(recording.scene, found)
    assert text.startswith(f"# series_resistance_ohm: {found.series_ohm:.3f} +- {found.sigma_ohm:.3f} ohm")
    read = validated(parse_document(text, "scene.yaml"), Scene)
    assert read == calibrated_scene(recording.scene, found)
    assert read.series_resistance_ohm == pytest.approx(found.series_ohm, abs=5e-4)


@pytest.mark.parametrize(("known", "sentence"), [(np.inf, "no row line is joined"), (-5.0, "positive"), (1e5, "below")])
def test_impossible_resistors_are_refused(known: float, sentence: str) -> None:
    recording = Recording(scene(2, 2), np.full((1, 2, 2), 300.0), np.zeros(1), np.ones(1, dtype=np.uint8))
    with pytest.raises(InputError, match=sentence):
        calibrate(recording, known)
