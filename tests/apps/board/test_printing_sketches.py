"""Sketches that print numbers: their scenes, and the Arduino's on a simulated chip."""

from pathlib import Path

import numpy as np
import pytest
from apps.board.bench import FIRMWARE, bench, random_cells

from lampest import Recording, read_scene
from lampest.apps.board.record import record
from lampest.apps.board.sample import Listening

SKETCHES = sorted((FIRMWARE / "printing_boards").glob("*/*.ino"))
FRAMES = 4
CODE_ERROR = 3  # of noise and settling on the simulated board, in codes


@pytest.mark.parametrize("sketch", SKETCHES, ids=lambda path: path.stem)
def test_every_sketch_has_a_scene(sketch: Path) -> None:
    assert sketch.parent.name == sketch.stem
    scene = read_scene(sketch.with_name("scene.yaml"))
    text = sketch.read_text()
    for name, number in (("ROWS", scene.panel.rows), ("COLUMNS", scene.panel.columns)):
        assert f"{name} = {number};" in text or f"#define {name} {number}\n" in text
    assert scene.readout is not None and scene.readout.kind in (FIRMWARE / "README.md").read_text()


def test_the_arduino_prints_what_its_scene_says(tmp_path: Path) -> None:
    """Recorded from the simulated chip, the codes are those of the scene's circuit."""
    scene = read_scene(SKETCHES[0].with_name("scene.yaml"))
    cells = random_cells(np.random.default_rng(3), 1, *scene.panel.shape)
    with bench(tmp_path, cells, wiring="loaded_columns", sketch="arduino_rows") as board:
        summary = record(
            Listening((board.port,), scene=scene, lines=True, baud=115_200),
            tmp_path / "r.h5",
            frames=FRAMES,
        )
    recording = Recording.load(tmp_path / "r.h5")
    assert scene.readout is not None and "time: the board's" in summary.understood
    codes = scene.readout.steps_from_volt(recording.recorded)
    expected = scene.readout.steps_from_volt(scene.readout.exact_reading(cells[0]))
    np.testing.assert_allclose(codes, np.broadcast_to(expected, codes.shape), atol=CODE_ERROR)
