"""One recording of known resistors: what was read, and what stood in place of the cells."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.readouts.lines import Side
from lampest.recording.calibration.repeats import Repeats

SHORT_OHM, OPEN_OHM = 1e-3, 1e12  # a strip of copper tape, and the insulation between two lines


@dataclass(frozen=True, eq=False)
class Trial:
    """One recording of known resistors: means of its readings, and what stood in place of the cells.

    name : the recording's. known : (rows, columns) ohm, 0 shorted, NaN no resistor. everywhere : whether readings of
    lines without a resistor count too, because something of the channel before may be in them.
    """

    name: str
    readings: Repeats
    known: Array
    everywhere: bool = False

    @cached_property
    def cells(self) -> Array:
        """(rows, columns) ohm with shorts and gaps as resistances."""
        return np.nan_to_num(np.maximum(self.known, SHORT_OHM), nan=OPEN_OHM)

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """(rows, columns) where a reading says something: it is there, and both of its lines lead to a resistor."""
        rows, columns = self.led("rows")[:, None], self.led("columns")[None, :]
        return np.asarray((self.everywhere | (rows & columns)) & np.isfinite(self.readings.volt))

    def led(self, side: Side) -> NDArray[np.bool_]:
        """(lines) of a side that lead to a resistor."""
        return np.asarray(np.isfinite(self.known).any(axis=1 if side == "rows" else 0))

    @cached_property
    def resistors(self) -> dict[tuple[float, int], tuple[int, int]]:
        """Where each resistor stands, by its value and its number among those of that value.

        Resistors of one name in two recordings are taken for one that was moved.
        """
        count: dict[float, int] = {}
        found = {}
        for row, column in np.argwhere(np.isfinite(self.known) & (self.known > 0)):
            value = float(self.known[row, column])
            count[value] = count.get(value, -1) + 1
            found[value, count[value]] = (int(row), int(column))
        return found
