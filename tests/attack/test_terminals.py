"""A terminal that takes nothing holds up no recording: Ctrl-S, or a connection that hangs."""

import os
import pty
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from attack.attack import environment
from support import until
from wild_board import hundred_a_second, wild_board

from lampest import Recording

FRAMES = 300  # of three seconds; a bar is drawn ten times a second


@pytest.mark.slow
def test_a_recording_continues_while_its_terminal_is_blocked(tmp_path: Path) -> None:
    out = tmp_path / "r.h5"
    words = ["record", "--out", str(out), "--period", "0.01", "--count", str(FRAMES), "--port"]
    script = [sys.executable, "-c", "from lampest.cli import main; main()", *words]
    reading, terminal = pty.openpty()
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), terminal)
    with (
        wild_board(hundred_a_second) as board,
        subprocess.Popen(
            [*script, board.port], env=environment(), start_new_session=True, **pipes
        ) as process,
    ):
        try:
            until(out.exists, 60)
            termios.tcflow(terminal, termios.TCOOFF)
            until(lambda: _finished(out), 30)
        finally:
            process.kill()
            termios.tcflow(terminal, termios.TCOON)
            for descriptor in (reading, terminal):
                os.close(descriptor)
    assert len(Recording.load(out).time) == FRAMES


def _finished(out: Path) -> bool:
    """Whether the journal has become a recording."""
    import h5py

    try:
        with h5py.File(out, "r", locking=False) as file:
            return "lampest_unfinished" not in file.attrs
    except OSError:  # it is being replaced
        return False
