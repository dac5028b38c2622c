"""The long versions: pytest tests/board -m soak -s; each prints its figures."""

from pathlib import Path

import numpy as np
import pytest
from board.bench import bench, scene, some_cells
from board.test_faults import check_damaged_line

from lampest import Recording
from lampest.recording.board.record import record

pytestmark = pytest.mark.soak


def test_ten_thousand_frames_on_a_damaged_line(tmp_path: Path) -> None:
    whole, received, wrong = check_damaged_line(tmp_path, 10_000)
    print(f"\n10000 frames sent, 1 % of bytes hurt: {whole} arrived whole, {received} accepted, {wrong} of them wrong")
    assert wrong == 0


def test_ten_minutes_at_thirty_frames_a_second(tmp_path: Path) -> None:
    with bench(tmp_path, some_cells(np.random.default_rng(1), 1)) as board:
        done = record(board.port, tmp_path / "r.h5", frames=18_000, scene=scene(readings=2), period=1 / 30)
        figures = board.stop()
    found = Recording.load(tmp_path / "r.h5")
    assert found.acquisition is not None
    missed = int(found.acquisition.missed.sum())
    print(
        f"\n{done.frames} frames in {found.time[-1]:.1f} s of board time, {done.lost} lost, {missed} missed; {figures}"
    )
    assert (done.frames, done.lost, missed) == (18_000, 0, 0)


def test_ten_seconds_at_thirty_frames_a_second_in_real_time(tmp_path: Path) -> None:
    """In real time nothing waits for the host: what it does not take in time is lost."""
    with bench(tmp_path, some_cells(np.random.default_rng(1), 1), "--real-time") as board:
        done = record(board.port, tmp_path / "r.h5", frames=300, scene=scene(readings=2), period=1 / 30)
        figures = board.stop()
    print(f"\n{done.frames} frames in real time, {done.lost} lost; {figures}")
    assert done.lost == 0 and figures["overrun"] == 0
