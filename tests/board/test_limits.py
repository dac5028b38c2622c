"""What the firmware costs and how fast it scans: measured on the simulated board, compared with firmware/README.md."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from board.bench import FIRMWARE, bench, built, scene, some_cells

from lampest import Recording
from lampest.recording.board.port import Board
from lampest.recording.board.record import record

README = (FIRMWARE / "README.md").read_text()
ROWS_OF_TABLE = [
    (int(rows), int(columns), int(readings), float(period_ms), float(rate))
    for rows, columns, readings, period_ms, rate in re.findall(
        r"^\| (\d+) × (\d+) \| (\d+) \| ([\d.]+) \| ([\d.]+) \|", README, re.MULTILINE
    )
]


def test_flash_and_memory_are_those_of_the_readme() -> None:
    assert len(ROWS_OF_TABLE) >= 8
    built()
    said = subprocess.run(
        ["make", "-s", "-C", str(FIRMWARE), "size"], capture_output=True, text=True, check=True
    ).stdout
    flash, memory = (int(number) for number in re.findall(r"(\d+) of", said))
    stated = [int(number) for number in re.findall(r"(\d+) of (?:253952|8192)", README)]
    # Another version of the compiler may differ a little; what must not happen is that nobody notices.
    assert stated == pytest.approx([flash, memory], rel=0.05)
    # Half of the memory stays for the stack.
    assert memory < 4096


@pytest.mark.parametrize(("rows", "columns", "readings", "period_ms", "rate"), ROWS_OF_TABLE)
def test_the_shortest_period_of_the_table_is_kept(
    tmp_path: Path, rows: int, columns: int, readings: int, period_ms: float, rate: float
) -> None:
    """At the shortest period that the board accepts no tick is missed and no frame lost; it is the table's."""
    frames = 40
    with bench(tmp_path, some_cells(np.random.default_rng(1), 1, rows, columns), "--no-reset-on-open") as board:
        with Board.open(board.port) as port:
            port.hello()
            shortest = port.start(rows, columns, readings, None).shortest_period_us
            port.stop()
        known = scene(rows, columns, readings)
        done = record(board.port, tmp_path / "r.h5", frames=frames, scene=known, period=shortest / 1e6)
        figures = board.stop()
    found = Recording.load(tmp_path / "r.h5")
    assert done.lost == 0 and not found.acquisition.missed.any()
    np.testing.assert_allclose(np.diff(found.time).mean(), shortest / 1e6, rtol=2e-2)
    assert figures["longest_scan_us"] < shortest
    assert shortest / 1000 == pytest.approx(period_ms, abs=0.051)
    assert rate == pytest.approx(1e6 / shortest, rel=0.01)
