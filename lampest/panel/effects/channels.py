"""Channels of multiplexers, which differ from line to line."""

import numpy as np

from lampest.panel.effects import SharedEffect
from lampest.panel.lines import MAX_OHM
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import channel_errors, scene_behind_channels
from lampest.panel.scene import Scene

# Resistance of a channel of a CD74HC4067 at 5 V, by its data sheet.
BEST_OHM = 40.0
TYPICAL_OHM = 70.0
WORST_OHM = 160.0


class ChannelSpread(SharedEffect):
    """An additional resistance in the channel of each line."""

    setting = "channel_spread_ohm"
    name = "channels"
    limits = (0.0, MAX_OHM)
    prior: float = 3.0  # CD74HC4067, data sheet: any two channels differ by 10 ohm

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return a column for each line, rows first."""
        return channel_errors(scene.circuit, network.cell_resistance, measured, scene, size)

    def sentence(self, size: float, deviation: float) -> str:
        return f"channels of the lines seem to differ by {size:.2g} +- {deviation:.1g} ohm"

    def with_errors(self, scene: Scene, errors: Array) -> Scene:
        of_lines = np.split(errors, [scene.panel.network.rows])
        corrected: Scene = scene_behind_channels(scene, *of_lines)
        return corrected

    def drawn(self, lines: int, size: float, random: np.random.Generator) -> Array:
        """Return drawn resistances of the channels beyond the scene's, (lines,) ohm."""
        return size * random.standard_normal(lines)


CHANNELS = ChannelSpread()
