"""Lost and doubled lines of files without marks between their frames, and cut frames."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import lampest
from lampest import InputError
from lampest.inference.readings.garbled import garbled_lines
from tests.fuzz import tables

ROWS = 8
COLUMNS = 7
FRAMES = 24
BASELINE = 3


def readings(seed: int, spread: float = 0.2) -> np.ndarray:
    """Frames of a film that differs from cell to cell, under a load that moves."""
    rng = np.random.default_rng(seed)
    cells = 3000 * np.exp(spread * rng.standard_normal((1, ROWS, COLUMNS))).repeat(FRAMES, axis=0)
    rows, columns = np.indices((ROWS, COLUMNS))
    for number, frame in enumerate(cells[BASELINE:]):
        distance = (rows - (1 + 0.25 * number)) ** 2 + (columns - 3) ** 2
        frame *= 1 - 0.4 * np.exp(-distance / 2)
    exact = np.array([lampest.two_point_resistance(frame) for frame in cells])
    return exact * (1 + 5e-4 * rng.standard_normal(exact.shape))


def lost(lines: np.ndarray, at: int) -> np.ndarray:
    return np.delete(lines, at, axis=0)


def doubled(lines: np.ndarray, at: int) -> np.ndarray:
    return np.insert(lines, at, lines[at], axis=0)


def imported(lines: np.ndarray, folder: Path) -> tuple[np.ndarray, str]:
    path = folder / "lines.csv"
    np.savetxt(path, lines, delimiter=",", fmt="%.2f")
    recording, notes = lampest.import_file(path, rows=ROWS, columns=COLUMNS, unit="ohm")
    return recording.recorded, " ".join(notes)


@pytest.mark.parametrize("damage", [lost, doubled])
@pytest.mark.parametrize("width", [COLUMNS, 1])
@pytest.mark.parametrize("seed", range(3))
def test_a_lost_or_doubled_line_is_found_and_named(
    tmp_path: Path, damage: Callable[..., np.ndarray], width: int, seed: int
) -> None:
    """All later frames were wrong, without a word."""
    meant = readings(seed)
    lines = meant.reshape(-1, width)
    at = int(np.random.default_rng(seed).integers(4 * len(lines) // FRAMES, 0.8 * len(lines)))
    imported_frames, notes = imported(damage(lines, at), tmp_path)
    assert "lines are lost or doubled between" in notes
    whole = np.isfinite(imported_frames).all(axis=(1, 2))
    assert whole.sum() >= FRAMES - 4
    for frame in imported_frames[whole]:
        assert np.abs(meant - frame).max(axis=(1, 2)).min() < 0.01, "no frame of the panel"


def test_a_whole_file_is_taken_as_it_is(tmp_path: Path) -> None:
    for seed, spread in ((1, 0.2), (2, 0.0)):
        meant = readings(seed, spread)
        imported_frames, notes = imported(meant.reshape(-1, COLUMNS), tmp_path)
        assert len(imported_frames) == FRAMES and "lost" not in notes
        np.testing.assert_allclose(imported_frames, meant, atol=0.01)


def test_a_loss_without_evidence_is_asked_for(tmp_path: Path) -> None:
    """All rows of a uniform film are equal but for the load."""
    lines = lost(readings(3, spread=0.0).reshape(-1, COLUMNS), 2 * ROWS + 2)
    with pytest.raises(InputError, match=r"191 lines are no whole number of frames of 8 lines"):
        imported(lines, tmp_path)


@pytest.mark.parametrize("first", [1, 5])
def test_a_capture_that_begins_within_a_frame_is_cut_or_asked_for(
    tmp_path: Path, first: int
) -> None:
    """Only rows that change steadily from the first to the last one show where a frame begins."""
    with pytest.raises(InputError, match="no whole number of frames"):
        imported(readings(4).reshape(-1, COLUMNS)[first:], tmp_path)
    steady = readings(4, spread=0.0) * np.linspace(1, 2, ROWS)[:, None]
    imported_frames, notes = imported(steady.reshape(-1, COLUMNS)[first:], tmp_path)
    np.testing.assert_allclose(imported_frames, steady[1:], atol=0.01)
    assert "are of a cut frame, and left out" in notes


@pytest.mark.long
@pytest.mark.parametrize("name", ["whole", "swapped"])
def test_readings_name_the_frames_that_are_none(tmp_path: Path, name: str) -> None:
    """Rows without names were swapped: the import names the frames."""
    silent = false = wrong_tables = 0
    for number in range(20):
        rng = np.random.default_rng([5, number])
        codes = tables.codes(rng, least=5, most=14)
        lines = list(tables.bare_rows(codes, rng))
        if name == "swapped":
            lines = tables.swapped_lines(lines, rng)
        path = tmp_path / "m.csv"
        path.write_text("\n".join([*(line.text for line in lines), ""]))
        rows, columns = codes.shape[1:]
        recording, notes = lampest.import_file(path, rows=rows, columns=columns, unit="ohm")
        distance = np.nanmax(np.abs(recording.recorded[:, None] - codes), axis=(2, 3), initial=0.0)
        wrong = np.flatnonzero(distance.min(axis=1) > 0)
        garbled = {lines.frame for lines in garbled_lines(recording)}
        told = any(note.startswith("garbled, or lost, doubled or swapped:") for note in notes)
        assert told == bool(garbled)
        wrong_tables += bool(len(wrong))
        silent += bool(len(wrong)) and not told
        false += told and not len(wrong)
    assert false == 0
    assert silent <= 3  # of lines of five readings, most of which a load moves
    assert (wrong_tables >= 15) == (name == "swapped")
