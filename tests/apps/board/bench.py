"""The simulated board for the tests, and the real command.

The board is built by firmware/Makefile, driven by a truth.
"""

import fcntl
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lampest import Array, LoadedColumnsReadout, Panel, PublishedResponse, Scene, TwoPointReadout
from lampest.files.document import to_yaml
from tests.small_files import run_command

FIRMWARE = Path(__file__).parents[3] / "firmware"
MULTIPLEXER_OHM = 70.0
ESTIMATING = "lampest_board/examples/estimating_board/estimating_board.ino"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@cache
def built(wiring: str = "two_point") -> Path:
    """Build firmware/, one process at a time, and return its folder.

    A missing package fails the test by its name.
    """
    with (FIRMWARE / "Makefile").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        completed = subprocess.run(
            ["make", "-s", "-C", str(FIRMWARE), "all"], capture_output=True, text=True
        )
    if completed.returncode:
        pytest.fail(completed.stderr.strip(), pytrace=False)
    return FIRMWARE / "build" / ("" if wiring == "two_point" else wiring)


@dataclass
class Bench:
    """A running simulated board: the port to open, and its figures once it has stopped."""

    port: str
    process: "subprocess.Popen[str]"
    figures: dict[str, float] = field(default_factory=dict)

    def stop(self) -> dict[str, float]:
        if not self.figures:
            self.process.terminate()
            self.figures = json.loads(self.process.communicate(timeout=20)[1])
        return self.figures


@contextmanager
def bench(
    folder: Path,
    cells: Array,
    *options: object,
    period: float = 1.0,
    wiring: str = "two_point",
    sketch: str = "lampest_board",
) -> Iterator[Bench]:
    """Run a board whose panel shows the frames of `cells` (frames, rows, columns), in ohm.

    The panel changes every `period` s.
    """
    words = (built(wiring) / "simulated_board", "--firmware", built(wiring) / f"{sketch}.elf")
    with _running(folder, words, cells, options, period) as running:
        yield running


@contextmanager
def portable_bench(
    folder: Path,
    constants: Path,
    cells: Array,
    *options: object,
    period: float = 1.0,
    sketch: str = ESTIMATING,
) -> Iterator[Bench]:
    """Run a board with an estimating sketch, compiled for this computer.

    The sketch uses the constants of an exported folder.
    """
    build = constants / "build"
    path = FIRMWARE / sketch
    words = [
        "make",
        "-s",
        "-C",
        FIRMWARE,
        "portable",
        f"PANEL={constants}",
        f"BUILD={build}",
        f"PORTABLE={path}",
    ]
    subprocess.run([str(word) for word in words], check=True)
    with _running(folder, (build / "portable_board",), cells, options, period) as running:
        yield running


@contextmanager
def _running(
    folder: Path,
    program: tuple[object, ...],
    cells: Array,
    options: tuple[object, ...],
    period: float,
) -> Iterator[Bench]:
    sys.path.insert(0, str(FIRMWARE / "simulated_board"))
    from truth import truth_text

    (folder / "truth.txt").write_text(truth_text(np.arange(len(cells)) * period, cells))
    words = [*program, "--truth", folder / "truth.txt", "--link", folder / "port", *options]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([str(word) for word in words], **pipes) as process:
        if not process.stdout.readline().startswith("port "):
            pytest.fail(process.communicate()[1], pytrace=False)
        running = Bench(str(folder / "port"), process)
        try:
            yield running
        finally:
            running.stop()


def scene(rows: int = 10, columns: int = 10, readings: int = 20, **changes: Any) -> Scene:
    """Return the default scene of the simulated board: multiplexers of 70 ohm, noise of 0.7 LSB."""
    readout = TwoPointReadout(readings=readings, noise_lsb=0.7)
    return Scene(
        Panel(rows, columns), readout, changes.get("series_resistance_ohm", 2 * MULTIPLEXER_OHM)
    )


def loaded_scene(rows: int = 10, columns: int = 10, readings: int = 20, **changes: Any) -> Scene:
    """Return a scene with 10 kΩ at every column and a multiplexer of 70 Ω before the rows."""
    known = {
        "load_ohm": 10_000.0,
        "drive_ohm": MULTIPLEXER_OHM,
        "supply_volt": 5.0,
        "adc_bits": 10,
        "noise_lsb": 0.7,
    }
    return Scene(Panel(rows, columns), LoadedColumnsReadout(readings=readings, **(known | changes)))


def random_cells(rng: np.random.Generator, frames: int, rows: int = 10, columns: int = 10) -> Array:
    """Pressed and stretched cells around 3 kΩ, another set in every frame."""
    return np.exp(rng.normal(np.log(3050), 0.4, (frames, rows, columns)))


def lampest(*words: object, code: int = 0) -> tuple[str, str]:
    """Standard output and error of a command that ends with `code`."""
    completed = run_command(*words, stdin=subprocess.DEVNULL, env=os.environ | ONE_THREAD)
    assert completed.returncode == code, (
        f"{completed.returncode}: {completed.stdout}{completed.stderr}"
    )
    return completed.stdout, completed.stderr


def scene_file(
    folder: Path, rows: int = 10, columns: int = 10, readings: int = 20, **changes: float
) -> Path:
    """The simulated board's scene as YAML."""
    path = folder / "scene.yaml"
    written = scene(rows, columns, readings, **changes)
    path.write_text(to_yaml(replace(written, response=PublishedResponse())))
    return path
