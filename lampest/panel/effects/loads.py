"""Load or feedback resistors that differ from line to line."""

import numpy as np

from lampest.panel.circuit import nominal_terminations
from lampest.panel.effects import E24_TOLERANCE, SharedEffect
from lampest.panel.lines import Side, along, opposite
from lampest.panel.network import Network
from lampest.panel.panel import Array, Shape
from lampest.panel.readouts import Readout
from lampest.panel.readouts.keys import entry
from lampest.panel.readouts.tolerances import off_by, reference_error
from lampest.panel.scene import Scene
from lampest.panel.sizes import BELOW_ONE


class LoadTolerance(SharedEffect):
    """Relative error of each line's resistor; `size` is the half width of a uniform distribution.

    The resistors are those of sensed lines, one for each line, or one for each multiplexer of
    `groups`. A readout with one resistor has no such error: `reference_tolerance` is that of all.
    """

    setting = "load_tolerance"
    name = "load resistors"
    limits = (0.0, BELOW_ONE)
    prior = E24_TOLERANCE
    is_advised = False
    if_undetermined = "changes of cells do not show it: measure the resistors with an ohmmeter"

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return a column for each resistor, (resistors, ..., rows, columns)."""
        circuit = scene.circuit
        cells = network.cell_resistance
        resistors = resistors_of(circuit, measured.shape[-2:])
        deviation = size / np.sqrt(3)
        if circuit.unit == "ohm":
            together = reference_error(circuit, cells, measured, scene, deviation)
            errors = [together * along(sensed_side(circuit), lines) for lines in resistors]
        else:
            unchanged = circuit.exact_reading(cells, scene.wiring)
            errors = [
                off_by(circuit, deviation * lines).exact_reading(cells, scene.wiring) - unchanged
                for lines in resistors
            ]
        return np.array(errors).reshape(-1, *measured.shape)


def sensed_side(circuit: Readout) -> Side:
    """Return the side whose lines a circuit reads."""
    return opposite(nominal_terminations(circuit).driven)


def resistors_of(circuit: Readout, shape: Shape) -> Array:
    """Return 1 for the lines of each resistor, (resistors, sensed).

    Lines that float while they are idle have their resistor behind a multiplexer. The result has no
    row where all lines share one resistor.

    Parameters
    ----------
    circuit : Readout
    shape : tuple of int
        Rows and columns of the panel.
    """
    driven, sensed = shape if sensed_side(circuit) == "columns" else shape[::-1]
    idle = ~np.eye(sensed, dtype=bool)
    groups = entry(circuit, "groups")
    if groups is not None:
        resistors = [np.isin(np.arange(sensed), group) for group in groups]
    elif np.isfinite(circuit.terminations(driven, sensed).sensing.ohm[idle]).any():
        resistors = list(np.eye(sensed, dtype=bool))
    else:
        resistors = []
    several = entry(circuit, circuit.of_sensed[0]) is not None and len(resistors) > 1
    return np.array(resistors if several else [], dtype=float).reshape(-1, sensed)
