"""What runs for weeks: memory stays, and no file is left open. The long version: python -m docs.studies.long_lives."""

import pytest

from docs.studies.long_lives import live_figures, stream_figures

# A leak of one float a frame would be 8 bytes; interpreters keep some pools of their own.
FRAMES, LEAK_BYTES_PER_FRAME = 1000, 60.0


@pytest.mark.slow
def test_a_stream_keeps_nothing_of_the_frames_that_went() -> None:
    before, after = stream_figures((FRAMES // 4, FRAMES))
    assert after.allocated - before.allocated < LEAK_BYTES_PER_FRAME * (after.frames - before.frames)
    assert after.open_files <= before.open_files


@pytest.mark.slow
def test_the_live_page_keeps_its_history_and_nothing_else() -> None:
    """Its history is full after 1,800 frames."""
    before, after = live_figures((2 * FRAMES, 3 * FRAMES))
    assert after.allocated - before.allocated < LEAK_BYTES_PER_FRAME * (after.frames - before.frames)
    assert after.open_files <= before.open_files and after.threads == before.threads
