"""What all frames of a recording share and nobody knows better: it moves all readings together, not apart.

A reading R = (f(r) + R_s)·(1 + δ) + δ_j + δ_k with the reference resistor's relative error δ and the channels' errors
δ_j, δ_k, one for each line, the same in every frame. To first order the estimate moves by K·U·z with independent
standard normal z, U one column for δ and one for each line. Changes against the baseline move by the difference.
"""

from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic


@dataclass(frozen=True)
class Shared:
    """systematic : how large such errors are. series_resistance_ohm : what was taken off every reading."""

    systematic: Systematic
    series_resistance_ohm: float

    @classmethod
    def of(cls, scene: Scene) -> "Shared | None":
        """None where the scene names no such error."""
        return None if scene.systematic is None else cls(scene.systematic, scene.series_resistance_ohm)

    def columns(self, measured: Array) -> Array:
        """U (frames · cells, 1 + rows + columns) in ohm, for readings (frames, rows, columns) ohm.

        A tolerance is the half width of a uniform distribution: its standard deviation is 1/√3 of it.
        """
        frames, rows, columns = measured.shape
        reference = (measured + self.series_resistance_ohm) * self.systematic.reference_tolerance / np.sqrt(3)
        row, column = np.indices((rows, columns))
        lines = np.concatenate([np.eye(rows)[row.ravel()], np.eye(columns)[column.ravel()]], axis=1)
        channels = np.tile(lines * self.systematic.channel_spread_ohm, (frames, 1))
        return np.concatenate([reference.reshape(-1, 1), channels], axis=1)
