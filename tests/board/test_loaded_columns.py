"""One multiplexer and loaded columns: what the board says of its wiring, and scenes that say otherwise."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest
from board.bench import FIRMWARE, loaded_scene, scene
from board.test_same_on_both_sides import c

from lampest import InputError
from lampest.recording.board.protocol import Hello, Receiver, message
from lampest.recording.board.stream import declared_readout, scene_of
from tests.bodies import hello_body

WIRING = "loaded_columns"


def hello() -> Hello:
    """What the board of this wiring says, of its own C."""
    settings, room = c(WIRING).lampest_start_settings(), ctypes.create_string_buffer(64)
    size = c(WIRING).lampest_hello(ctypes.byref(settings), room)
    (greeting,) = Receiver().feed(message(room.raw[:size]))[1]
    assert isinstance(greeting, Hello) and hello_body(greeting) == room.raw[:size]
    return greeting


def test_what_scene_and_board_say_differently_is_named() -> None:
    """A calibrated scene fits the board that it was made with."""
    for changes, sentence in (
        ({"driven": "columns"}, "readout.driven is columns, but the board says rows"),
        ({"polarity": "down"}, "readout.polarity is down, but the board says up"),
        ({"supply_volt": 3.3}, "readout.supply_volt is 3.3, but the board says 5 "),
        ({"load_ohm": 1000.0}, "readout.load_ohm is 1000, but the board says 10000"),
        ({"load_ohm": (10_000.0,) * 9 + (12_000.0,)}, "readout.load_ohm is 12000, but the board says 10000"),
    ):
        with pytest.raises(InputError, match=sentence):
            scene_of(hello(), loaded_scene(**changes))
    with pytest.raises(InputError, match=r"readout\.kind is two_point, but the board .* wired as loaded_columns"):
        scene_of(hello(), scene(4, 4))
    known = loaded_scene(load_ohm=tuple(np.linspace(9_700, 10_300, 10)), drive_ohm=tuple(np.linspace(60, 90, 10)))
    assert scene_of(hello(), known) is known


def test_the_wiring_is_part_of_what_the_board_says() -> None:
    """Earlier firmware, whose HELLO has 29 bytes, has two multiplexers; a wiring never heard of is no board."""
    found = hello()
    assert (found.wiring, found.reference_milliohm, found.drive_milliohm) == (WIRING, 10_000_000, 70_000)
    assert declared_readout(found) == loaded_scene(noise_lsb=None).readout
    old = replace(found, wiring="two_point", drive_milliohm=0)
    assert len(hello_body(old)) == 29 and Receiver().feed(message(hello_body(old)))[1] == (old,)
    unknown = hello_body(found)[:29] + bytes([9, 0, 0, 0, 0])
    assert not any(isinstance(item, Hello) for item in Receiver().feed(message(unknown))[1])


def test_platformio_builds_both_wirings() -> None:
    assert "-DLAMPEST_WIRING=LAMPEST_LOADED_COLUMNS" in (FIRMWARE / "platformio.ini").read_text()
