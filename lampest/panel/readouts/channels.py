"""Effect of the channels of a driven circuit's lines on its readings."""

from typing import Protocol, Self

import numpy as np

from lampest.panel.lines import PerLine, Side, along, of_side
from lampest.panel.panel import Array
from lampest.panel.readouts.wiring import Wiring


class CircuitWithChannels(Protocol):
    """Circuit that drives lines through channels, of which the sensed lines may have none."""

    @property
    def driven(self) -> Side:
        """Side that is driven."""

    @property
    def sense_ohm(self) -> PerLine:
        """Channels of the sensed lines; 0: none."""

    def ties(self, measured: Array) -> Array:
        """Return the ties of the lines, see `Readout.ties`."""

    def with_channels(self, row_ohm: Array, column_ohm: Array) -> Self:
        """Return the circuit with additional channel resistances, ohm."""

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return the readings of cells (rows, columns) ohm."""


def errors_of_channels(
    circuit: CircuitWithChannels, cells: Array, wiring: Wiring | None, channel: float
) -> Array:
    """Return the change of the readings by an addition to each line's channel, rows first.

    Where idle driven lines are not connected through their channels, the channel of a driven line
    changes the readings of this line alone, so that one network shows all of them.

    Parameters
    ----------
    circuit : CircuitWithChannels
    cells : array, shape (rows, columns)
        Ohm.
    wiring : Wiring or None
    channel : float
        Addition to a channel, ohm.

    Returns
    -------
    array, shape (rows + columns, rows, columns)
    """
    rows = len(cells)
    lines = np.eye(sum(cells.shape))
    driven, sensed = of_side(circuit.driven, *np.split(np.arange(len(lines)), [rows]))
    errors = np.zeros((len(lines), *cells.shape))
    unchanged = circuit.exact_reading(cells, wiring)

    def with_additions(chosen: Array) -> CircuitWithChannels:
        return circuit.with_channels(*np.split(channel * chosen, [rows]))

    def error(chosen: Array) -> Array:
        return np.asarray(with_additions(chosen).exact_reading(cells, wiring) - unchanged)

    every = lines[driven].sum(axis=0)
    if np.array_equal(circuit.ties(cells), with_additions(every).ties(cells)):
        together = error(every)
        for line, own in zip(driven, np.eye(len(driven)), strict=True):
            errors[line] = together * along(circuit.driven, own)
    else:
        errors[driven] = [error(one) for one in lines[driven]]
    if circuit.sense_ohm:
        errors[sensed] = [error(one) for one in lines[sensed]]
    return errors
