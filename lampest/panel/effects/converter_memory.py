"""Memory of a converter: its capacitor keeps a share of the channel that it read before."""

from lampest.panel.effects.sized_effect import SizedEffect
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout
from lampest.panel.readouts.scan_order import of_previous_channel
from lampest.panel.sizes import BELOW_ONE


class KeptShare(SizedEffect):
    """A share of the voltage of the channel before; readings are freed of it.

    What remains is the error of the share, the same in all frames.
    """

    limits = (0.0, BELOW_ONE)
    # Root mean square of converters whose capacitor is charged by some 10 kohm: 0 to 5 %. A real
    # board had 2.9 %.
    prior = 0.03
    averages = False

    def sentence(self, size: float, deviation: float) -> str:
        return (
            f"the converter keeps {100 * size:.2g} +- {100 * deviation:.1g} % "
            "of the channel before: so fewer cells have moved under the load"
        )

    def columns(self, circuit: Readout, values: Array, *sizes: float) -> Array:
        """Return the column of the share: each channel's difference from the one before."""
        (deviation,) = sizes
        return deviation * (values - of_previous_channel(circuit, values))[None]
