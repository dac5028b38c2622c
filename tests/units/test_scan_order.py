"""The order in which the readings of a frame are taken, and its consequences."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import GroundedReadout, Panel, Readings, Recording, Scene
from lampest.panel.readouts.channel_memory import with_memory
from lampest.panel.readouts.scan_order import by_columns, in_panel_order, in_scan_order

SHAPE = (3, 4)
MEMORY = 0.1
SNAKE = tuple(
    (row, column)
    for row in range(3)
    for column in (range(4) if row % 2 == 0 else reversed(range(4)))
)
PLACES = {
    "rows": np.arange(12),
    "columns": np.arange(12).reshape(SHAPE).T.ravel(),
    SNAKE: np.array([4 * row + column for row, column in SNAKE]),
}


@pytest.mark.parametrize("order", PLACES, ids=["rows", "columns", "snake"])
def test_readings_are_taken_in_the_stated_order(order: Any) -> None:
    for driven in ("rows", "columns"):
        readout = GroundedReadout(driven=driven, scan_order=order)
        values = np.random.default_rng(1).normal(size=(2, *SHAPE))
        channels = in_scan_order(readout, values)
        assert_allclose(channels, values.reshape(2, -1)[:, PLACES[order]])
        assert_allclose(in_panel_order(readout, channels, values.shape), values)


@pytest.mark.parametrize("order", PLACES, ids=["rows", "columns", "snake"])
def test_memory_is_taken_off_in_the_stated_order(order: Any) -> None:
    readout = GroundedReadout(scan_order=order, adc_bits=16)
    volt = np.random.default_rng(2).uniform(0.5, 4, (1, *SHAPE))
    channels = volt.reshape(-1)[PLACES[order]]
    held = np.empty_like(channels)
    before = channels[-1]
    for _ in range(9):  # frames: the first channel follows the last one of the frame before
        for number, channel in enumerate(channels):
            before = (1 - MEMORY) * channel + MEMORY * before
            held[number] = before
    recorded = np.empty(12)
    recorded[PLACES[order]] = held
    recorded = recorded.reshape(volt.shape)
    assert_allclose(with_memory(readout, MEMORY, volt), recorded, rtol=1e-9)
    scene = Scene(Panel(*SHAPE), readout, converter_memory=MEMORY)
    assert_allclose(Readings.of(scene, recorded).value, volt, rtol=1e-6)


def test_without_a_key_a_scan_goes_along_the_driven_lines() -> None:
    assert not by_columns(GroundedReadout(driven="rows"))
    assert by_columns(GroundedReadout(driven="columns"))
    assert not by_columns(GroundedReadout(driven="columns", scan_order="rows"))


def test_the_order_stays_in_the_file(tmp_path: Any) -> None:
    scene = Scene(Panel(*SHAPE), GroundedReadout(scan_order=SNAKE))
    path = tmp_path / "snake.h5"
    Recording.from_array(np.ones((1, *SHAPE)), unit="volt", scene=scene).save(path)
    assert Recording.load(path).scene.circuit.scan_order == SNAKE
