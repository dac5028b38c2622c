"""The library's example prints lines that `lampest import` understands, and they are the panel's."""

from pathlib import Path

import numpy as np
import serial
from board.bench import bench, scene

from lampest import import_file, two_point_resistance


def test_lines_of_the_example_are_the_panel(tmp_path: Path) -> None:
    cells = np.full((10, 10), 3000.0)
    cells[2, 7] = 300.0
    with bench(tmp_path, cells[None], sketch="print_table") as board, serial.Serial(board.port, timeout=30) as port:
        lines = [port.readline() for _ in range(3)]
    log = tmp_path / "monitor.log"
    log.write_bytes(b"".join(lines))
    recording, _ = import_file(log, scene=scene(), unit="code")
    assert recording.recorded.shape == (3, 10, 10)
    expected = two_point_resistance(cells) + 140
    np.testing.assert_allclose(recording.recorded[-1], expected, rtol=0.02)
    assert np.unravel_index(np.argmin(recording.recorded[-1]), (10, 10)) == (2, 7)


def test_the_library_says_what_it_includes() -> None:
    folder = Path(__file__).parents[2] / "firmware" / "lampest_board"
    lines = (folder / "library.properties").read_text(encoding="utf-8").splitlines()
    said = dict(line.split("=", 1) for line in lines)
    assert {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url"} <= set(said)
    assert all((folder / header).is_file() for header in said["includes"].split(","))
