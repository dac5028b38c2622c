"""Gain of a frame: a factor that its voltages share, of another size in every frame."""

import numpy as np

from lampest.panel.effects.sized_effect import SizedEffect
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout


class Gain(SizedEffect):
    """A factor on the voltages of a frame; the size is its relative standard deviation.

    It has no prior: the scatter of the unloaded frames shows its size.
    """

    limits = (0.0, 1.0)
    stream = "gain"

    def sentence(self, size: float, deviation: float) -> str:
        return f"the gain of a frame varies by {100 * size:.2g} +- {100 * deviation:.1g} %"

    def columns(self, circuit: Readout, values: Array, *sizes: float) -> Array:
        """Return the column of the factor."""
        (gain,) = sizes
        return gain * values[None]

    def disturbed(
        self,
        readout: Readout,
        volt: Array,
        random: np.random.Generator,
        period_s: float,
        *sizes: float,
    ) -> Array:
        """Return V·(1 + g), g normal in every frame."""
        (spread,) = sizes
        gain = spread * random.standard_normal(len(volt))
        return volt * (1 + gain[:, None, None])
