"""What recognition compares frames with: the scene of a panel, or of a window of its modules."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from lampest.panel.joined_network import JoinedNetwork
from lampest.panel.network import Network
from lampest.panel.panel import Array, Mask, Panel
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.response import Response
from lampest.panel.scene import Scene


@dataclass(frozen=True, eq=False)
class WindowScene:
    """Neighbouring modules with the interface of a scene and of its circuit that recognition needs.

    Attributes
    ----------
    panel : Panel
        The window.
    response : Response or None
    of_modules : tuple of Scene
        Scene of each module.
    wiring : None
        Each module has its own.
    """

    panel: Panel
    response: Response | None
    of_modules: tuple[Scene, ...]
    wiring: None = None

    @property
    def circuit(self) -> "WindowScene":
        """The circuit of all modules."""
        return self

    @property
    def unit(self) -> str:
        """Unit of the readings, ohm or volt."""
        return self.of_modules[0].circuit.unit

    @property
    def series_ohm(self) -> Array:
        """Resistance in series, (rows, columns) ohm."""
        return self._joined([module.series_ohm for module in self.of_modules])

    @property
    def broken(self) -> Mask:
        """Whether a crossing has no cell to be estimated, (rows, columns)."""
        return self._joined([module.broken for module in self.of_modules]) > 0

    @property
    def open_cells(self) -> Mask:
        """Whether a crossing does not conduct, (rows, columns)."""
        return self._joined([module.open_cells for module in self.of_modules]) > 0

    def uniform_start(self, measured: Array) -> Array:
        """Return the uniform start of every module, as `Readout.uniform_start`."""
        parts = zip(self.of_modules, self.panel.layout.split(measured), strict=True)
        return self._joined([module.circuit.uniform_start(part) for module, part in parts])

    def ties(self, cells: Array) -> Array:
        """Return an empty array, because every module has its own ties."""
        return np.zeros(0)

    def network(self, cells: Array, ties: Array, wiring: Wiring | None) -> Network:
        """Return the network of all modules."""
        parts = zip(self.of_modules, self.panel.layout.split(cells), strict=True)
        solved = [
            module.circuit.network(part, module.circuit.ties(part), module.wiring)
            for module, part in parts
        ]
        return JoinedNetwork.of(cells, solved, self.panel.layout)

    def _joined(self, parts: Sequence[Array | Mask]) -> Array:
        """Return the image of values of each module, to be broadcast to (rows, columns)."""
        shape = self.panel.network.shape
        return self.panel.layout.joined(np.stack([np.broadcast_to(part, shape) for part in parts]))


RecognitionScene: TypeAlias = Scene | WindowScene
