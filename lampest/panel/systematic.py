"""What all frames of a recording share and nobody knows better: it moves all readings together, not apart.

The reference resistor (the loads, the feedback) is off by a fraction, every line's channel by some ohm, the same in
every frame; so are the hidden errors of `lampest.panel.hidden`. To first order the estimate moves by K·U·z with
independent standard normal z, U one column for the reference and one for each line: what each does to the readings.
Changes against the baseline move by the difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.hidden import Possible, hidden_columns, recorded_share, usual
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.wired import contact_responses
from lampest.panel.scene import Scene, Systematic


@dataclass(frozen=True)
class Shared:
    """systematic : how large such errors are, or None. scene : what they are errors of.

    contact_root : (lines, n) ohm, a root of the covariance of contacts, or None. hidden_root : (n, m) of what
    is possible of the hidden errors, in units of their sizes; None: of each on its own as much as its size.
    """

    systematic: Systematic | None
    scene: Scene
    contact_root: Array | None = None
    hidden_root: Array | None = None

    @classmethod
    def of(cls, scene: Scene, contact_root: Array | None = None, hidden: Possible | None = None) -> "Shared | None":
        """None where there is no such error.

        Contacts are known as the scene says unless a root is given; hidden errors as the scene says, or as usual where
        it says nothing, unless a recording has told more.
        """
        if contact_root is None and scene.contacts is not None:
            contact_root = np.diag(scene.contacts.deviation(scene.panel.shape))
        sizes = usual(scene) if hidden is None else hidden.sizes
        if sizes is None and contact_root is None:
            return None
        return cls(sizes, scene, contact_root, None if hidden is None else hidden.root)

    def beyond(self, told: "Shared | None") -> "Shared | None":
        """What is left where a method has unknowns for what is told; None where nothing is."""
        if self.systematic is None:
            return None
        if told is None or told.systematic is None:
            return replace(self, contact_root=None)
        own, known = (one.reading_error or 0.0 for one in (self.systematic, told.systematic))
        if own <= known:
            return None
        return Shared(Systematic(reading_error=float(np.sqrt(own**2 - known**2))), self.scene)

    def columns(self, cells: Array, measured: Array, networks: Sequence[Network]) -> Array:
        """U (frames · cells, n) in the readings' unit.

        cells, measured : (frames, rows, columns). networks : one a frame.
        """
        parts = [] if self.systematic is None else self._of_readings(cells, measured, self.systematic)
        if self.contact_root is not None:
            parts.append(contact_responses(networks) @ self.contact_root)
        return np.concatenate(parts, axis=1)

    def own_error(self, measured: Array) -> Array:
        """Standard deviation of what each reading is off by on its own, in their unit, (frames, rows, columns)."""
        size = None if self.systematic is None else self.systematic.reading_error
        if not size:
            return np.zeros(measured.shape)
        return np.asarray(size * np.abs(np.stack([recorded_share(frame, self.scene) for frame in measured])))

    def _of_readings(self, cells: Array, measured: Array, systematic: Systematic) -> list[Array]:
        """1 + rows + columns of them, and the hidden ones.

        A tolerance is the half width of a uniform distribution, σ = 1/√3 of it.
        """
        reference = systematic.reference_tolerance / np.sqrt(3)
        circuit, channel = self.scene.circuit, systematic.channel_spread_ohm
        frames = [
            circuit.shared_errors(*pair, self.scene, reference, channel) for pair in zip(cells, measured, strict=True)
        ]
        told = np.concatenate([errors.reshape(len(errors), -1).T for errors in frames])
        pairs = zip(cells, measured, strict=True)
        hidden = [hidden_columns(*pair, self.scene, systematic) for pair in pairs]
        if not len(hidden[0]):
            return [told]
        columns = np.concatenate([errors.reshape(len(errors), -1).T for errors in hidden])
        return [told, columns if self.hidden_root is None else columns @ self.hidden_root]
