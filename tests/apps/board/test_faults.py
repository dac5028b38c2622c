"""Faults of a board on a cable."""

import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from apps.board.bench import bench, random_cells, scene

from lampest import InputError, Recording
from lampest.apps.board.journal import repair
from lampest.apps.board.protocol import Frame, Receiver
from lampest.apps.board.record import Progress, record
from lampest.apps.board.sample import Listening
from tests.bodies import frame_body

NOISE_OF_CODES = 0.02  # relative, of readings of 10 bits


def logged_frames(log: bytes) -> Iterator[tuple[Frame, bool]]:
    """The frames of a bench's log, and whether all of their bytes arrived unharmed."""
    pairs = np.frombuffer(log[: len(log) // 2 * 2], np.uint8).reshape(-1, 2)
    for begin, end in pairwise(np.flatnonzero(pairs[:, 0] == 0)):
        sent, harm = pairs[begin : end + 1].T
        for item in Receiver().feed(sent.tobytes())[1]:
            if isinstance(item, Frame):
                yield item, not harm.any()


@pytest.mark.parametrize(
    "frames",
    [pytest.param(400, marks=pytest.mark.slow), pytest.param(10_000, marks=pytest.mark.soak)],
)
def test_one_damaged_byte_in_a_hundred_costs_only_the_frames_it_hits(
    tmp_path: Path, frames: int
) -> None:
    """Recorded until the board has sent so many frames."""
    cells = random_cells(np.random.default_rng(8), 40)
    hurt = (
        "--flip",
        0.004,
        "--drop",
        0.003,
        "--duplicate",
        0.003,
        "--loop",
        "--log",
        tmp_path / "log",
    )
    with bench(tmp_path, cells, *hurt) as board:
        record(
            Listening((board.port,), scene=scene(readings=20), period=0.25),
            tmp_path / "r.h5",
            seconds=0.25 * frames,
        )
    recording = Recording.load(tmp_path / "r.h5")
    last = recording.acquisition.sequence[-1]
    accepted = recording.acquisition.sequence.tolist()
    assert not recording.acquisition.session.any(), "damage must not look like a restart"
    log = (tmp_path / "log").read_bytes()
    sent = [(frame, unharmed) for frame, unharmed in logged_frames(log) if frame.sequence <= last]
    by_number = {frame.sequence: frame for frame, _ in sent}
    identity = sent[-1][0].identity
    wrong = sum(
        frame_body(by_number[number])
        != frame_body(Frame(20, number, device_ms, missed, sums, identity=identity))
        for number, device_ms, missed, sums in zip(
            accepted,
            recording.acquisition.device_ms,
            recording.acquisition.missed,
            recording.raw_sums,
            strict=True,
        )
    )
    undamaged = {frame.sequence for frame, unharmed in sent if unharmed}
    assert undamaged <= set(accepted), "a good frame was not kept"
    assert sum(recording.acquisition.lost) == last + 1 - len(accepted)
    print(
        f"\n{frames} frames sent with 1 % of bytes hurt: {len(undamaged)} whole, {len(accepted)} "
        "accepted, "
        f"{wrong} wrong"
    )
    assert wrong == 0
    assert 20 <= len(undamaged) <= len(accepted)


@pytest.mark.slow
def test_unplugging_marks_a_gap_in_the_same_file(tmp_path: Path) -> None:
    cells = random_cells(np.random.default_rng(9), 1)
    states: list[Progress] = []
    with bench(tmp_path, cells, "--unplug", "3:5", "--no-reset-on-open") as board:
        summary = record(
            Listening((board.port,), scene=scene(), period=0.25),
            tmp_path / "r.h5",
            frames=60,
            on_progress=states.append,
        )
    recording = Recording.load(tmp_path / "r.h5")
    assert summary.frames == 60 and summary.restarts == recording.acquisition.session[-1] >= 1
    assert any("waiting" in at.state for at in states)
    gap = int(np.argmax(recording.acquisition.session > 0))
    assert 0 < gap < summary.frames and recording.acquisition.sequence[gap] == 0
    assert np.all(np.diff(recording.time) > 0)
    assert np.all(np.abs(recording.resistance / recording.resistance[0] - 1) < NOISE_OF_CODES)


@pytest.mark.slow
def test_a_reset_board_is_configured_and_started_again(tmp_path: Path) -> None:
    with bench(
        tmp_path,
        random_cells(np.random.default_rng(9), 1, 5, 5),
        "--reset",
        "5",
        "--no-reset-on-open",
    ) as board:
        summary = record(
            Listening((board.port,), scene=scene(5, 5), period=0.25), tmp_path / "r.h5", frames=40
        )
    recording = Recording.load(tmp_path / "r.h5")
    assert (summary.frames, summary.restarts, recording.acquisition.session[-1]) == (40, 1, 1)
    assert recording.resistance.shape == (40, 5, 5)


@pytest.mark.slow
def test_a_running_recording_can_be_read_but_not_repaired(tmp_path: Path) -> None:
    frame_counts: list[int] = []
    out = tmp_path / "r.h5"

    def look(progress: Progress) -> None:
        if progress.frames == 5 and not frame_counts:
            reader = "import sys, lampest; print(len(lampest.Recording.load(sys.argv[1]).time))"
            completed = subprocess.run(
                [sys.executable, "-c", reader, str(out)], capture_output=True, text=True, check=True
            )
            frame_counts.append(int(completed.stdout))
            with pytest.raises(InputError, match="still being recorded"):
                repair(out)

    with bench(tmp_path, random_cells(np.random.default_rng(9), 1)) as board:
        record(Listening((board.port,)), out, frames=8, on_progress=look)
    assert frame_counts[0] >= 5
    assert len(Recording.load(out).time) == 8
