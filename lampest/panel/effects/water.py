"""Moving water: its pressure changes all cells, alike or along the panel."""

from typing import Any

from lampest.panel.conditions import moved_by_water
from lampest.panel.effects.sized_effect import SizedEffect
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout


class MovingWater(SizedEffect):
    """A relative change of the readings in the patterns of `motion_patterns`.

    No scene names it: the scatter of the unloaded frames shows its sizes.
    """

    in_volt = False

    def columns(self, circuit: Readout, values: Array, *sizes: Any) -> Array:
        """Return the columns of the patterns."""
        return moved_by_water(values, *sizes)
