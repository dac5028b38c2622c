"""Live skins of the package flexitac."""

import os
import termios
import threading
import time
import tty
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from support import block_of

import lampest

flexitac = pytest.importorskip("flexitac")

PAGE = Path(__file__).parents[3] / "docs" / "apps" / "board" / "flexitac.md"
UNLOADED = 30
OPEN_OHM = 20_000.0
PRESSED_OHM = 900.0
PRESSED = (slice(3, 7), slice(10, 16))
NEAR_RAIL = 0.5  # relative: an open cell reads a dozen codes of 8 bits
# Of a pressed cell, relative: codes of 8 bits; measured 0.21, and 0.58 where the scene does not say
# that the firmware cuts off two bits. The divider without the circuit errs by more than 1.
MAX_ERROR = 0.25
MAX_STEPS = 4  # Newton steps of a frame, of which a core takes fifty frames in a second


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The page's script, as a module beside its scene."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flexitac.yaml").write_text(block_of(PAGE, "yaml"), encoding="utf-8")
    module = ModuleType("live")
    exec(compile(block_of(PAGE, "python"), "live.py", "exec"), module.__dict__)
    return module


def codes(scene: lampest.Scene, cells: np.ndarray, seed: int) -> np.ndarray:
    """Return bytes of the firmware: analogRead() >> 2, with the converter's noise."""
    readout = scene.readout
    assert readout is not None
    volt = scene.circuit.exact_reading(cells)
    noise = np.random.default_rng(seed).normal(0, 2.0, volt.shape)
    read = np.clip(np.rint(volt / readout.full_scale_volt * 1024 + noise), 0, 1023)
    return (read.astype(np.int64) >> 2).astype(np.uint8)


@pytest.fixture
def board(page: Any) -> Iterator[tuple[str, threading.Event]]:
    """Return a port that sends frames as the firmware does, and an event that presses the skin."""
    scene: lampest.Scene = page.scene
    resting = np.full(scene.panel.shape, OPEN_OHM)
    loaded = resting.copy()
    loaded[PRESSED] = PRESSED_OHM
    frames = {
        state: [codes(scene, cells, seed) for seed in range(8)]
        for state, cells in ((False, resting), (True, loaded))
    }
    master, slave = os.openpty()
    tty.setraw(slave, termios.TCSANOW)
    press = threading.Event()
    stop = threading.Event()

    def send() -> None:
        number = 0
        os.write(master, b"\x17\xaa\x02")  # the reader joins in the middle of a frame
        while not stop.is_set():
            frame = frames[press.is_set()][number % 8]
            try:
                os.write(master, b"\xaa\x55" + frame.tobytes())
            except OSError:
                return
            number += 1
            time.sleep(0.02)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    yield os.ttyname(slave), press
    stop.set()
    os.set_blocking(master, False)
    thread.join(timeout=5)
    for end in (master, slave):
        os.close(end)


@pytest.mark.slow
def test_the_code_of_the_page_locates_the_pressed_cells(
    page: Any, board: tuple[str, threading.Event]
) -> None:
    port, press = board
    with flexitac.FlexiTacSensor(port, baseline=0.0) as sensor:
        frames = page.cells(sensor, UNLOADED)
        resting = list(islice(frames, 3))[-1]
        assert np.median(resting) == pytest.approx(OPEN_OHM, rel=NEAR_RAIL)
        press.set()
        # All noise of the board, whichever comes first.
        loaded = np.median(list(islice(frames, 25))[-8:], axis=0)
    error = np.abs(loaded[PRESSED] / PRESSED_OHM - 1)
    assert np.median(error) < MAX_ERROR
    raw = codes(
        page.scene,
        np.where(
            np.isin(np.arange(384).reshape(12, 32), np.arange(384).reshape(12, 32)[PRESSED]),
            PRESSED_OHM,
            OPEN_OHM,
        ),
        1,
    )
    divider = 1000 * (256 / np.maximum(raw[PRESSED], 1) - 1)
    assert np.median(np.abs(divider / PRESSED_OHM - 1)) > 1.0


def test_readings_of_an_open_skin_raise_no_doubt(page: Any) -> None:
    """Most of an unloaded skin conducts hardly, so that its median reading is near a rail."""
    scene = replace(page.scene, panel=lampest.Panel(6, 8, 2.0))
    cells = np.full((8, 6, 8), 60_000.0)
    cells[6:, 2:4, 3:5] = PRESSED_OHM
    recording = lampest.Recording.from_array(codes(scene, cells, 3), "code", 6, scene)
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0)]
    question = "are readings in volt"
    thousandth = replace(recording, recorded=recording.recorded / 1000)
    for values, doubted in ((recording, False), (thousandth, True)):
        doubts = lampest.reconstruct(values, terms).checks_without_circuit
        assert any(question in doubt for doubt in doubts) is doubted


def test_a_frame_takes_few_steps(page: Any) -> None:
    """The time of a frame is its number of steps; seconds are measured by the page's table."""
    cells = np.full(page.scene.panel.shape, OPEN_OHM)
    resting = page.readings([codes(page.scene, cells, seed) for seed in range(8)]).mean()
    cells[PRESSED] = PRESSED_OHM
    stream = lampest.Stream.begin(page.estimator, page.scene, 1.0, resting)
    steps = []
    for seed in range(6):
        stream, step = stream.push(page.readings([codes(page.scene, cells, seed)])[0])
        steps.append(step.solution.iterations)
    assert max(steps) <= MAX_STEPS, steps
