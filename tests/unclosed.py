"""Files of a killed recorder."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lampest.apps.board.journal import Journal
from lampest.apps.board.sample import Sample
from lampest.panel.scene import Scene
from lampest.recording.acquisition import Rows

READINGS = 20


def unclosed_recording(
    path: Path, scene: Scene, frames: int, unloaded: int, seed: int = 8, *, estimates: bool = False
) -> Path:
    """Write frames at 10 Hz, two events and an incomplete frame, as kill -9 leaves them.

    `path` is a copy of the journal `growing.h5` beside it. With `estimates` every second frame has
    an estimate whose cells equal the frame's number.
    """
    rng = np.random.default_rng(seed)
    hello = SimpleNamespace(readings=READINGS)
    with Journal.create(
        path.with_name("growing.h5"), scene, READINGS, estimates=estimates
    ) as journal:
        for number in range(frames):
            sums = rng.integers(8000, 8010, scene.panel.shape, dtype=np.uint16)
            frame: Any = SimpleNamespace(
                readings=READINGS, device_ms=100 * number, sequence=number, missed=0
            )
            frame.sums = sums
            frame.log_change = np.full(scene.panel.shape, number) if number % 2 else None
            sample: Any = Sample(frame, hello, scene, 0.1 * number, 1.7e9 + 0.1 * number, 0, 0)
            journal.append((sample,), int(number < unloaded))
        journal.mark(0.3, "touch")
        journal.mark(0.5, "leave")
        journal.file[f"entry/{Rows.of_frames(scene.circuit).datasets[0][0]}"].resize(
            frames + 1, axis=0
        )
        journal.file.flush()
        path.write_bytes(path.with_name("growing.h5").read_bytes())
    return path
