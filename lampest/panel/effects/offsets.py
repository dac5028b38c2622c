"""Offsets of the amplifiers of sensed lines."""

from dataclasses import replace
from typing import Any

import numpy as np

from lampest.panel.circuit import nominal_terminations
from lampest.panel.effects import SharedEffect
from lampest.panel.lines import of_side, per_line
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.keys import MAX_OFFSET_VOLT
from lampest.panel.scene import Scene


class AmplifierOffsets(SharedEffect):
    """An offset of each sensed line's amplifier, beside the scene's `offset_volt`."""

    setting = "offset_spread_volt"
    name = "offsets of amplifiers"
    limits = (0.0, MAX_OFFSET_VOLT)
    prior = 0.002  # LM324, LM358: 2 mV typically, 7 mV at most (data sheets)
    is_advised = False
    if_undetermined = "changes of cells do not show them: short the inputs and read the codes"

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return a column for each sensed line; none where the circuit has no amplifiers."""
        circuit: Any = scene.circuit
        if not hasattr(circuit, "offset_volt"):
            return np.zeros((0, *measured.shape))
        cells = network.cell_resistance
        _, count = of_side(nominal_terminations(circuit).driven, *cells.shape)
        offset = per_line("offset_volt", circuit.offset_volt or 0.0, count)
        unchanged = circuit.exact_reading(cells, scene.wiring)
        columns = []
        for own in np.eye(count):
            actual = replace(circuit, offset_volt=tuple((offset + size * own).tolist()))
            recorded = actual.to_recorded(actual.exact_reading(cells, scene.wiring), scene)
            columns.append(circuit.from_recorded(recorded, scene) - unchanged)
        return np.array(columns)
