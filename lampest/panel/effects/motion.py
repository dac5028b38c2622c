"""Motion: loads that move, and jitter, while the readings of a frame are taken."""

import numpy as np

from lampest.panel.effects.sized_effect import SizedEffect
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout

# Least and largest jitter of a load within a scan, as shares of its change. The prior of the
# logarithm is uniform between them, and no jitter is as probable as all others together.
JITTERS = 0.015, 0.25


class LoadMotion(SizedEffect):
    """A displacement of each reading along the load's motion.

    The size is the share of the time between frames that a scan takes. Readings are interpolated to
    the middle of their scan; what remains is the jitter of the load, a share of the change that
    it makes.
    """

    unit = "of the time between frames"
    limits = (0.0, 1.0)
    in_volt = False

    def sentence(self, size: float, deviation: float) -> str:
        return (
            "still cells seem to move with the load; a scan "
            f"takes {size:.2g} +- {deviation:.1g} of the time between frames"
        )

    def jitter_sentence(self, size: float, deviation: float, jitter: float) -> str:
        """Return the sentence on a load that jitters, by a share of the change that it makes."""
        return (
            f"{self.sentence(size, deviation)}, within which the load jitters "
            f"by {100 * jitter:.2g} % of its change"
        )

    def columns(self, circuit: Readout, values: Array, *sizes: float) -> Array:
        """Return the column of the jitter; none where the unloaded panel was not read."""
        jitter, resting = sizes
        if resting is None:
            return np.zeros((0, *values.shape))
        return (jitter * (values - resting))[None]
