"""Long days at a frame a second: memory does not grow with their frames."""

from pathlib import Path

import numpy as np
import pytest
from attack.attack import command

from lampest import Panel, Recording, Scene, TwoPointReadout

# frames; a whole day of 86,400 frames of 6 × 6 cells took 253 MB and four minutes
SHORT = 200
LONG = 2000
MAX_GROWTH = 25e6  # bytes


@pytest.mark.slow
def test_a_replayed_day_takes_no_more_memory_than_an_hour(tmp_path: Path) -> None:
    scene = Scene(Panel(4, 4), TwoPointReadout(noise_lsb=0.7, readings=20))
    rng = np.random.default_rng(1)
    peaks = []
    for frames in (SHORT, LONG):
        cells = rng.uniform(900, 1000, (1, 4, 4)) * (1 + 1e-4 * rng.standard_normal((frames, 4, 4)))
        recorded = scene.circuit.to_recorded(scene.circuit.exact_reading(cells), scene)
        role = (np.arange(frames) >= 3).astype(np.uint8)
        Recording(scene, recorded, np.arange(float(frames)), role).save(tmp_path / "day.h5")
        source = ("--recording", "day.h5", "--speed", "100000", "--count", str(frames - 3))
        completed = command("live", *source, "--http", "127.0.0.1:0", folder=tmp_path)
        assert completed.code == 0, completed.err
        peaks.append(completed.peak)
    assert peaks[1] - peaks[0] < MAX_GROWTH
