"""The way from nothing to a live map, as the README has it, with a board that prints."""

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from printing_board import (
    frame_with_millis,
    json_frames,
    on_socket,
    on_terminal,
    printed,
    rows_and_a_blank_line,
)

from lampest import Array, Recording, Scene, read_scene

README = Path(__file__).parents[3] / "README.md"
FRAMES = 24
ESTIMATED_S = 0.25  # a frame, so that a slow machine estimates each
RECORDED_S = 0.05
PAGE = ("--http", "127.0.0.1:0")
PRESSED = (slice(4, 7), slice(8, 11))


def commands() -> list[list[str]]:
    """Return the words of the five lines."""
    (block,) = re.findall(r"is live in five lines[\s\S]*?\n\n((?:    .*\n)+)", README.read_text())
    return [line.split() for line in block.strip().splitlines()]


@pytest.fixture
def run(tmp_path: Path, lampest: Callable[..., SimpleNamespace]) -> Callable[[list[str]], str]:
    """Return a function that runs a command of the README in a folder, and returns its output."""

    def ran(words: list[str]) -> str:
        completed = lampest(*words[1:], folder=tmp_path)
        assert completed.code == 0, completed.err
        return completed.out

    return ran


def codes(scene: Scene, seed: int) -> Array:
    """Return what the mat's converter gives: unloaded, then pressed."""
    rng = np.random.default_rng(seed)
    cells = np.repeat(20e3 * np.exp(0.1 * rng.standard_normal((1, *scene.panel.shape))), FRAMES, 0)
    cells[FRAMES // 2 :, *PRESSED] = 2e3
    readout = scene.readout
    assert readout is not None
    steps = np.stack([readout.steps_from_volt(readout.exact_reading(frame)) for frame in cells])
    return np.rint(steps + rng.standard_normal(steps.shape)).clip(0, 1023).astype(int)


@pytest.mark.slow
def test_five_lines_lead_from_nothing_to_a_live_map(
    tmp_path: Path, run: Callable[[list[str]], str]
) -> None:
    init, listed, live, record, info = commands()
    run(init)
    run(listed)
    scene = read_scene(tmp_path / "mat" / "scene.yaml")
    for form, period, words, limits in (
        (frame_with_millis, ESTIMATED_S, live, [*PAGE, "--count", str(FRAMES - 3)]),
        (rows_and_a_blank_line, RECORDED_S, record, []),
    ):
        words = [*words, *limits]
        if "--out" in words:
            words[words.index("--count") + 1] = str(FRAMES - 2)
        with on_terminal(printed(form, codes(scene, 1)), period) as url:
            words[words.index("--port") + 1] = url
            output = run(words)
        assert "the board prints: one " in output
    recording = Recording.load(tmp_path / "mine.h5")
    change = recording.recorded[-1] / recording.recorded[0]
    assert np.all(np.abs(change[PRESSED] - 1) > 0.5)
    assert "model      no" not in run(info)


@pytest.mark.slow
def test_a_board_behind_a_socket_is_live(tmp_path: Path, run: Callable[[list[str]], str]) -> None:
    """Frames that an ESP32 sends over Wi-Fi are estimated as they come, and end with it."""
    init, _, live, *_ = commands()
    run(init)
    frames = printed(json_frames, codes(read_scene(tmp_path / "mat" / "scene.yaml"), 2))
    with on_socket(frames, ESTIMATED_S) as url:
        live[live.index("--port") + 1] = url
        output = run([*live, *PAGE, "--count", str(FRAMES - 4)])
    assert "the board prints: " in output and f"{FRAMES - 4} frames" in output
