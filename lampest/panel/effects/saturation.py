"""A stage before the converter that saturates: it passes no voltage above a share of the range."""

import numpy as np

from lampest.panel.effects.sized_effect import SizedEffect
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout


class Saturation(SizedEffect):
    """Clipping of voltages; the size is the share of the full scale at which a stage clips.

    A scene states the range in volt, `readout.passes_volt`. The voltage at which channels end
    determines it without a prior.
    """

    unit = "volt"

    def disturbed(
        self,
        readout: Readout,
        volt: Array,
        random: np.random.Generator,
        period_s: float,
        *sizes: float,
    ) -> Array:
        """Return V, and the end of the range above it."""
        (share,) = sizes
        return np.minimum(volt, share * readout.full_scale_volt)
