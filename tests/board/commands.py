"""The real command `lampest`, and scenes on the disk for it."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from board.bench import scene

from lampest.files.document import to_yaml
from lampest.panel.response import PublishedResponse

COMMAND = Path(sys.executable).with_name("lampest")
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def lampest(*words: object, code: int = 0) -> tuple[str, str]:
    """Standard output and error of a command that ends with `code`."""
    done = subprocess.run(
        [str(COMMAND), *(str(word) for word in words)],
        capture_output=True,
        text=True,
        timeout=120,
        env=os.environ | ONE_THREAD,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == code, f"{done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout, done.stderr


def scene_file(folder: Path, rows: int = 10, columns: int = 10, readings: int = 20, **changes: float) -> Path:
    """The simulated board's scene as YAML."""
    path = folder / "scene.yaml"
    made = scene(rows, columns, readings, **changes)
    path.write_text(to_yaml(replace(made, response=PublishedResponse())))
    return path
