"""The relative error of the reference resistor, or of all loads or feedback resistors together."""

import numpy as np

from lampest.panel.effects import SharedEffect
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.tolerances import off_by, reference_error
from lampest.panel.scene import Scene
from lampest.panel.sizes import BELOW_ONE


class ReferenceTolerance(SharedEffect):
    """Relative error of the reference; `size` is the half width of a uniform distribution."""

    setting = "reference_tolerance"
    name = "reference"
    limits = (0.0, BELOW_ONE)
    # Resistors of the series E24 lie within E24_TOLERANCE; intervals of 95 % cover these and
    # resistances in series at once.
    prior: float = 0.06
    is_typical = True
    is_advised = False
    if_undetermined = "no frame shows it; `lampest calibrate` measures it"

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return its column."""
        cells, deviation = network.cell_resistance, size / np.sqrt(3)
        return reference_error(scene.circuit, cells, measured, scene, deviation)[None]

    def drawn(self, circuit: Readout, size: float, random: np.random.Generator) -> Readout:
        """Return a circuit whose reference is off by a drawn error of at most `size`."""
        return off_by(circuit, size * random.uniform(-1, 1))


REFERENCE = ReferenceTolerance()
