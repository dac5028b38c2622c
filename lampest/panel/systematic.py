"""What all frames of a recording share and nobody knows better: it moves all readings together, not apart.

The reference resistor (the loads, the feedback) is off by a fraction, every line's channel by some ohm, the same in
every frame. To first order the estimate moves by K·U·z with independent standard normal z, U one column for the
reference and one for each line: what each does to the readings. Changes against the baseline move by the difference.
"""

from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic


@dataclass(frozen=True)
class Shared:
    """systematic : how large such errors are. scene : what they are errors of."""

    systematic: Systematic
    scene: Scene

    @classmethod
    def of(cls, scene: Scene) -> "Shared | None":
        """None where the scene names no such error."""
        return None if scene.systematic is None else cls(scene.systematic, scene)

    def columns(self, cells: Array, measured: Array) -> Array:
        """U (frames · cells, 1 + rows + columns) in the readings' unit; cells, measured : (frames, rows, columns).

        A tolerance is the half width of a uniform distribution: its standard deviation is 1/√3 of it.
        """
        reference = self.systematic.reference_tolerance / np.sqrt(3)
        circuit, channel = self.scene.circuit, self.systematic.channel_spread_ohm
        frames = [
            circuit.shared_errors(*pair, self.scene, reference, channel) for pair in zip(cells, measured, strict=True)
        ]
        return np.concatenate([errors.reshape(len(errors), -1).T for errors in frames])
