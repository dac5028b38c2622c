"""Mats of the package matsense, live."""

import socket
import struct
import threading
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from support import block_of

import lampest

PAGE = Path(__file__).parents[3] / "docs" / "apps" / "board" / "matsense.md"
RESTING_OHM = 12_000.0
PRESSED_OHM = 700.0
UNLOADED = 10
PRESSED = (slice(3, 7), slice(9, 13))
NEAR_RAIL = 0.3  # of a cell at rest, relative
MAX_ERROR = 0.2  # of a pressed cell, relative
APART = 5  # cells outside over pressed ones; at rest 17
# matsense.cmd.CMD
CLOSE = 0
RAW = 2


@pytest.fixture
def scene(tmp_path: Path) -> lampest.Scene:
    (tmp_path / "mat.yaml").write_text(block_of(PAGE, "yaml"), encoding="utf-8")
    return lampest.read_scene(tmp_path / "mat.yaml")


@pytest.fixture
def server(tmp_path: Path, scene: lampest.Scene) -> Iterator[tuple[str, threading.Event]]:
    """The address of a server of raw frames, each sent twice, and an event that presses the mat."""
    address = str(tmp_path / "server")
    press = threading.Event()
    resting = np.full(scene.panel.shape, RESTING_OHM)
    pressed = resting.copy()
    pressed[PRESSED] = PRESSED_OHM
    volts = {
        state: scene.circuit.exact_reading(cells)
        for state, cells in ((False, resting), (True, pressed))
    }
    rng = np.random.default_rng(4)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(address)

    def serve() -> None:
        requests = 0
        codes = np.zeros(0)
        while True:
            command, client = listener.recvfrom(8192)
            if command[0] == CLOSE:
                return
            assert command[0] == RAW
            if requests % 2 == 0:
                volt = volts[press.is_set()]
                codes = np.clip(np.floor(volt / 5 * 256 + rng.normal(0, 0.5, volt.shape)), 0, 255)
            listener.sendto(struct.pack(f"={codes.size}di", *codes.ravel(), requests // 2), client)
            requests += 1

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield address, press
    listener_end = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener_end.sendto(bytes([CLOSE]), address)
    thread.join(timeout=5)
    listener_end.close()
    listener.close()


def test_the_code_of_the_page_locates_the_pressed_cells(
    scene: lampest.Scene, server: tuple[str, threading.Event]
) -> None:
    address, press = server
    page: Any = ModuleType("live")
    exec(compile(block_of(PAGE, "python"), "live.py", "exec"), page.__dict__)
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0)]
    estimator = lampest.Estimator(terms, formulation="truncated", error_bars=False)
    source = page.frames(scene, address)
    estimates = page.cells(scene, estimator, source, UNLOADED)
    resting = next(estimates)
    assert np.median(resting) == pytest.approx(RESTING_OHM, rel=NEAR_RAIL)
    press.set()
    loaded = list(islice(estimates, 12))[-1]
    assert np.median(np.abs(loaded[PRESSED] / PRESSED_OHM - 1)) < MAX_ERROR
    outside = np.ones(scene.panel.shape, dtype=bool)
    outside[PRESSED] = False
    assert np.median(loaded[outside]) > APART * PRESSED_OHM
    source.close()
