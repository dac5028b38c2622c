"""Detection where readings are bounds: presses at a rail, panels that are open at rest."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lampest import Array, GroundedReadout, Panel, Recording, Scene, VirtualGroundReadout
from lampest.apps.recognition.detect.detection import detect_recording, with_bounds_counted

SHAPE = (8, 8)
CONVERTER: dict[str, Any] = {"readings": 1, "adc_bits": 12}
AMPLIFIERS = VirtualGroundReadout(
    drive_ohm=70.0,
    sense_ohm=70.0,
    feedback_ohm=10_000.0,
    drive_volt=0.5,
    converter_volt=2.5,
    **CONVERTER,
)
LOADS = GroundedReadout(driven="columns", load_ohm=10_000.0, **CONVERTER)


def recording(path: Path, readout: Any, resting: Array, loaded: Array) -> Path:
    rng = np.random.default_rng(2)
    volt = np.stack([readout.exact_reading(cells) for cells in [resting] * 5 + [loaded] * 6])
    volt = volt + readout.lsb_volt * rng.standard_normal(volt.shape)
    codes = readout.code_from_volt(volt).astype(float)
    scene = Scene(Panel(*SHAPE), readout, purpose="mat", baseline="raw")
    frames = Recording.from_array(codes, unit="code", scene=scene, baseline=5)
    frames.save(path)
    return path


def test_a_bound_beyond_rest_counts_as_a_change_of_that_much() -> None:
    resting = np.array([[1.0, 1.0, 1.0, 0.1]])
    value = np.array([[2.0, 2.0, 1.0, 0.1]])
    sides = np.array([[0.0, 1.0, 1.0, -1.0]])
    sigma = np.full((1, 4), 0.01)
    shown, spread = with_bounds_counted(
        value, sigma, sides, resting, np.array([[0.0, 0.0, 0.0, -1.0]])
    )
    assert shown.tolist() == value.tolist()
    assert spread.tolist() == [[0.01, pytest.approx(0.1), np.inf, 0.01]]


@pytest.mark.slow
def test_a_press_at_the_rail_is_recognised_next_to_a_weaker_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    resting = 40_000 * np.exp(0.2 * rng.standard_normal(SHAPE))
    loaded = resting.copy()
    loaded[1:3, 1:3] = 4000.0
    loaded[5:7, 5:7] = 800.0
    answer = detect_recording(recording(tmp_path / "rail.h5", AMPLIFIERS, resting, loaded))
    centres = sorted((load.x_mm[0], load.y_mm[0]) for load in answer.attachments)
    assert np.allclose(centres, [(15, 15), (55, 55)], atol=3)


def test_a_panel_that_is_open_at_rest_shows_its_contact(tmp_path: Path) -> None:
    resting = np.full(SHAPE, 30e6)
    loaded = resting.copy()
    loaded[2:6, 3:6] = 4000.0
    answer = detect_recording(recording(tmp_path / "open.h5", LOADS, resting, loaded))
    [contact] = answer.attachments
    assert np.allclose((contact.x_mm[0], contact.y_mm[0]), (40, 35), atol=3)
