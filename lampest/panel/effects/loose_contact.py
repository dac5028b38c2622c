"""Contacts of lines whose resistance differs from the scene's."""

from collections.abc import Iterator

import numpy as np

from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import simulated
from lampest.panel.scene import Scene


class LooseContact(LineEffect):
    """Additional resistance at the contact of a line, such as that of a loose one, in ohm."""

    key = "contacts"
    prior = 100.0
    unit = "ohm"

    @property
    def positive(self) -> bool:
        """Whether it is a contact that loosened; less resistance is a load on the whole line."""
        return self.since

    @classmethod
    def places(cls, rows: int, columns: int) -> Iterator[tuple[int, ...]]:
        yield from ((line,) for line in range(rows + columns))

    def sentence(self, rows: int) -> str:
        more = "more" if self.size > 0 else "less"
        return (
            f"{float(f'{abs(self.size):.2g}'):g} ohm {more} "
            f"at the contact of {self.where(rows)}{self._since}"
        )

    def added(self, scene: Scene, network: Network) -> Array:
        rows, columns = network.conductance.shape
        more = self.size * np.isin(np.arange(rows + columns), self.lines)
        circuit = scene.circuit
        recorded = simulated(circuit, network.cell_resistance, scene, more[:rows], more[rows:])
        return circuit.from_recorded(recorded, scene) - network.reading()
