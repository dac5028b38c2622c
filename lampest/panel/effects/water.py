"""Moving water: its pressure changes all cells, alike or along the panel."""

from typing import Any

import numpy as np

from lampest.panel.conditions import motion_patterns
from lampest.panel.effects.sized_effect import SizedEffect
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout


class Water(SizedEffect):
    """A relative change of the readings in the patterns of `motion_patterns`.

    No scene names it: the scatter of the unloaded frames tells its sizes.
    """

    in_volt = False

    def columns(self, circuit: Readout, values: Array, *sizes: Any) -> Array:
        """Return the columns of the patterns."""
        (motion,) = sizes
        return np.asarray(motion[:, None, None] * motion_patterns(values.shape) * values)
