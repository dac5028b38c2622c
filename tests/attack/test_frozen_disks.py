"""A disk that accepts no data for seconds, as a network disk whose server is busy."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from wild_board import hundred_a_second, wild_board

from lampest import Recording
from lampest.apps.board.journal import Journal
from lampest.apps.board.record import record
from lampest.apps.board.sample import Listening

FRAMES = 300  # of three seconds
FROZEN_S = 2.0
FROZEN_CALL = 20  # the write to the disk that takes so long


@pytest.mark.slow
def test_a_disk_frozen_for_seconds_costs_no_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames wait in the port meanwhile."""
    append: Callable[..., None] = Journal.append
    calls = list[int]()

    def stalled(journal: Journal, *arguments: Any) -> None:
        calls.append(0)
        if len(calls) == FROZEN_CALL:
            time.sleep(FROZEN_S)
        append(journal, *arguments)

    monkeypatch.setattr(Journal, "append", stalled)
    with wild_board(hundred_a_second) as board:
        summary = record(Listening((board.port,), period=0.01), tmp_path / "r.h5", frames=FRAMES)
    recording = Recording.load(tmp_path / "r.h5")
    assert (summary.frames, summary.lost) == (FRAMES, 0) and len(calls) > FROZEN_CALL
    assert recording.acquisition is not None
    assert recording.acquisition.sequence.tolist() == list(range(FRAMES))
