"""What all frames of a recording share and nobody knows better: it moves all readings together, not apart.

A reading R = (f(r) + R_s)·(1 + δ) + δ_j + δ_k with the reference resistor's relative error δ and the channels' errors
δ_j, δ_k, one for each line, the same in every frame. To first order the estimate moves by K·U·z with independent
standard normal z, U one column for δ and one for each line. Changes against the baseline move by the difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.wired import contact_responses
from lampest.panel.scene import Scene, Systematic


@dataclass(frozen=True)
class Shared:
    """systematic : how large such errors are, or None. series_resistance_ohm : what was taken off every reading.

    contact_root : (lines, n) ohm, a root of the covariance of the lines' contacts, or None.
    """

    systematic: Systematic | None
    series_resistance_ohm: float
    contact_root: Array | None = None

    @classmethod
    def of(cls, scene: Scene, contact_root: Array | None = None) -> "Shared | None":
        """None where the scene names no such error. Contacts are known as the scene says unless a root is given."""
        if contact_root is None and scene.contacts is not None:
            contact_root = np.diag(scene.contacts.deviation(scene.panel.shape))
        if scene.systematic is None and contact_root is None:
            return None
        return cls(scene.systematic, scene.series_resistance_ohm, contact_root)

    def columns(self, measured: Array, networks: Sequence[Network]) -> Array:
        """U (frames · cells, n) in the readings' unit; measured : (frames, rows, columns), networks : one a frame."""
        parts = [] if self.systematic is None else [self._of_readings(measured, self.systematic)]
        if self.contact_root is not None:
            parts.append(contact_responses(networks) @ self.contact_root)
        return np.concatenate(parts, axis=1)

    def _of_readings(self, measured: Array, systematic: Systematic) -> Array:
        """1 + rows + columns of them, in ohm.

        A tolerance is the half width of a uniform distribution: its standard deviation is 1/√3 of it.
        """
        frames, rows, columns = measured.shape
        reference = (measured + self.series_resistance_ohm) * systematic.reference_tolerance / np.sqrt(3)
        row, column = np.indices((rows, columns))
        lines = np.concatenate([np.eye(rows)[row.ravel()], np.eye(columns)[column.ravel()]], axis=1)
        channels = np.tile(lines * systematic.channel_spread_ohm, (frames, 1))
        return np.concatenate([reference.reshape(-1, 1), channels], axis=1)
