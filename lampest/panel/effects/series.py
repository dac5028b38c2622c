"""A resistance in series with all driven lines, in addition to the scene's."""

import numpy as np

from lampest.panel.effects import SharedEffect
from lampest.panel.lines import MAX_OHM, of_side
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import channel_errors, scene_behind_channels
from lampest.panel.scene import Scene


class SeriesTolerance(SharedEffect):
    """An additional resistance in series with all driven lines."""

    setting = "series_tolerance_ohm"
    name = "series"
    limits = (0.0, MAX_OHM)
    # Two channels of TYPICAL_OHM to WORST_OHM lie within 50 ohm of the typical value; intervals of
    # 95 % cover these and the reference at once.
    prior = 35.0
    is_typical = True
    is_advised = False

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return its column."""
        circuit = scene.circuit
        errors = channel_errors(circuit, network.cell_resistance, measured, scene, 1.0)
        driven, _ = of_side(circuit.noisy_side, *np.split(errors, [measured.shape[-2]]))
        return np.asarray(size * driven.sum(axis=0)[None])

    def with_errors(self, scene: Scene, errors: Array) -> Scene:
        driven = scene.circuit.noisy_side
        of_lines = (
            np.full(count, errors[0] if side == driven else 0.0)
            for side, count in zip(("rows", "columns"), scene.panel.network.shape, strict=True)
        )
        corrected: Scene = scene_behind_channels(scene, *of_lines)
        return corrected


SERIES = SeriesTolerance()
