"""What goes wrong with a board on a cable: damaged bytes, unplugging, resets, silence, a killed recorder, Ctrl-C."""

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from board.bench import bench, scene, some_cells

from lampest import InputError, Recording
from lampest.recording.board.protocol import Frame, Receiver
from lampest.recording.board.record import Progress, record, repair
from tests.bodies import frame_body


@pytest.mark.parametrize(
    "frames", [pytest.param(400, marks=pytest.mark.slow), pytest.param(10_000, marks=pytest.mark.soak)]
)
def test_one_damaged_byte_in_a_hundred_costs_only_the_frames_it_hits(tmp_path: Path, frames: int) -> None:
    """Recorded until the board has sent so many frames; the log holds each byte sent, and whether it was hurt."""
    cells = some_cells(np.random.default_rng(8), 40)
    hurt = ("--flip", 0.004, "--drop", 0.003, "--duplicate", 0.003, "--loop", "--log", tmp_path / "log")
    with bench(tmp_path, cells, *hurt) as board:
        record(board.port, tmp_path / "r.h5", scene=scene(readings=20), period=0.25, seconds=0.25 * frames)
    found = Recording.load(tmp_path / "r.h5")
    last = found.acquisition.sequence[-1]
    got = found.acquisition.sequence.tolist()
    assert not found.acquisition.session.any(), "damage must not look like a restart"
    log = (tmp_path / "log").read_bytes()
    sent = []
    pairs = np.frombuffer(log[: len(log) // 2 * 2], np.uint8).reshape(-1, 2)
    for begin, end in pairwise(np.flatnonzero(pairs[:, 0] == 0)):
        for item in Receiver().feed(pairs[begin : end + 1, 0].tobytes())[1]:
            if isinstance(item, Frame) and item.sequence <= last:
                sent.append((item, not pairs[begin : end + 1, 1].any()))
    by_number = {frame.sequence: frame for frame, _ in sent}
    wrong = sum(
        frame_body(by_number[number]) != frame_body(Frame(20, number, device_ms, missed, sums))
        for number, device_ms, missed, sums in zip(
            got, found.acquisition.device_ms, found.acquisition.missed, found.raw_sums, strict=True
        )
    )
    whole = {frame.sequence for frame, unharmed in sent if unharmed}
    assert whole <= set(got), "a good frame was not kept"
    assert sum(found.acquisition.lost) == last + 1 - len(got)
    print(f"\n{frames} frames sent with 1 % of bytes hurt: {len(whole)} whole, {len(got)} accepted, {wrong} wrong")
    assert wrong == 0
    assert 20 <= len(whole) <= len(got)


def test_unplugging_marks_a_gap_and_goes_on_in_the_same_file(tmp_path: Path) -> None:
    cells = some_cells(np.random.default_rng(9), 1)
    states: list[Progress] = []
    with bench(tmp_path, cells, "--unplug", "3:5", "--no-reset-on-open") as board:
        done = record(board.port, tmp_path / "r.h5", frames=60, scene=scene(), period=0.25, on_progress=states.append)
    found = Recording.load(tmp_path / "r.h5")
    assert done.frames == 60 and done.restarts == found.acquisition.session[-1] >= 1
    assert any("waiting" in at.state for at in states)
    gap = int(np.argmax(found.acquisition.session > 0))
    assert 0 < gap < 60 and found.acquisition.sequence[gap] == 0
    assert np.all(np.diff(found.time) > 0)
    assert np.all(np.abs(found.resistance / found.resistance[0] - 1) < 0.02)


def test_a_board_that_resets_is_set_and_started_again(tmp_path: Path) -> None:
    with bench(tmp_path, some_cells(np.random.default_rng(9), 1, 5, 5), "--reset", "5", "--no-reset-on-open") as board:
        done = record(board.port, tmp_path / "r.h5", frames=40, scene=scene(5, 5), period=0.25)
    found = Recording.load(tmp_path / "r.h5")
    assert (done.frames, done.restarts, found.acquisition.session[-1]) == (40, 1, 1)
    assert found.resistance.shape == (40, 5, 5)


def test_while_it_runs_others_can_read_along_but_not_repair(tmp_path: Path) -> None:
    seen: list[int] = []
    out = tmp_path / "r.h5"

    def look(progress: Progress) -> None:
        if progress.frames == 5 and not seen:
            reader = "import sys, lampest; print(len(lampest.Recording.load(sys.argv[1]).time))"
            done = subprocess.run([sys.executable, "-c", reader, str(out)], capture_output=True, text=True, check=True)
            seen.append(int(done.stdout))
            with pytest.raises(InputError, match="still being recorded"):
                repair(out)

    with bench(tmp_path, some_cells(np.random.default_rng(9), 1)) as board:
        record(board.port, out, frames=8, on_progress=look)
    assert seen[0] >= 5
    assert len(Recording.load(out).time) == 8
