"""A readout of a notebook: keys and one function to ends, and all else follows."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.apps.microcontroller.constants import CircuitLines
from lampest.panel.circuit import Ends, Terminations, scanned
from lampest.panel.lines import PerLine, Side, per_line
from lampest.panel.readouts.keys import driven_ends, ends_in_words, idle_ends, load_ends
from lampest.panel.readouts.tolerances import behind_channels

SHAPE = (6, 5)


@dataclass(frozen=True, kw_only=True)
class BleederReadout(lampest.Readout):
    """Columns keep a pull-down, and the one that is read has a bleeder beside it."""

    of_driven: ClassVar[tuple[str, ...]] = ("drive_ohm", "rest_ohm")
    of_sensed: ClassVar[tuple[str, ...]] = ("load_ohm", "bleeder_ohm")
    channels: ClassVar[tuple[str, str]] = ("drive_ohm", "")
    kind: Literal["bleeder"] = "bleeder"
    driven: Side = "rows"
    polarity: Literal["up", "down"] = "up"
    drive_ohm: PerLine = 40.0
    rest_ohm: PerLine = 2000.0
    load_ohm: PerLine = 10_000.0
    bleeder_ohm: PerLine = 3000.0

    def description(self) -> str:
        return f"columns with pull-downs and a bleeder{ends_in_words(self)}"

    def terminations(self, driven: int, sensed: int) -> Terminations:
        load = load_ends(self, sensed)
        bleeder = Ends.of(per_line("bleeder_ohm", self.bleeder_ohm, sensed))
        rest = idle_ends(self, per_line("rest_ohm", self.rest_ohm, driven))
        return Terminations(
            self.driven,
            scanned(own=driven_ends(self, driven), idle=rest),
            scanned(own=load.beside(bleeder), idle=load),
            gain=np.ones(sensed),
        )


READOUT = BleederReadout(adc_bits=12, readings=1)


def test_the_c_library_has_the_readings_of_a_readout_of_a_notebook() -> None:
    cells = np.geomspace(500.0, 50_000.0, 30).reshape(SHAPE)
    lines = CircuitLines.of(READOUT, SHAPE)
    assert_allclose(lines.readings(cells, "rows"), READOUT.exact_reading(cells), rtol=1e-9)


def test_keys_of_usual_names_have_their_limits_in_a_readout_of_a_notebook() -> None:
    with pytest.raises(lampest.InputError, match="load_ohm must be positive and finite"):
        BleederReadout(load_ohm=0.0)
    with pytest.raises(lampest.InputError, match="bleeder_ohm must be positive and finite"):
        BleederReadout(bleeder_ohm=0.0)
    with pytest.raises(lampest.InputError, match="drive_ohm lists 2 numbers"):
        lampest.Scene(lampest.Panel(*SHAPE), BleederReadout(drive_ohm=(40.0, 41.0)))


def test_channels_of_a_readout_of_a_notebook_are_those_that_it_names() -> None:
    actual = behind_channels(READOUT, np.linspace(1.0, 6.0, 6), np.ones(5))
    assert actual.drive_ohm == (41.0, 42.0, 43.0, 44.0, 45.0, 46.0)
    assert actual.load_ohm == READOUT.load_ohm
