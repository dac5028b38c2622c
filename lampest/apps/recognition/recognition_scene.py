"""Interface of a scene for recognition.

`lampest.panel.scene.Scene` has it, and so has a window of several modules,
`lampest.apps.recognition.window.WindowScene`.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Network
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.response import Response


class RecognitionCircuit(Protocol):
    """Circuit that reads a panel; see `lampest.panel.readouts.readout.Readout`."""

    @property
    def unit(self) -> str:
        """Unit of the readings, ohm or volt."""

    def uniform_start(self, measured: Array, /) -> Array:
        """Return cells, ohm, exact where all are equal."""

    def ties(self, cell_resistance: Array, /) -> Array:
        """Return the conductances of the lines to ground, siemens."""

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None, /) -> Network:
        """Return the solved network of cells (rows, columns) ohm."""


class RecognitionScene(Protocol):
    """A panel, its circuit and the response of its film."""

    @property
    def panel(self) -> Panel:
        """Arrangement of the cells."""

    @property
    def circuit(self) -> RecognitionCircuit:
        """Circuit that reads the panel."""

    @property
    def wiring(self) -> Wiring | None:
        """Resistances between terminals and cells; None without any."""

    @property
    def response(self) -> Response | None:
        """Response of the film; None where the scene names none."""

    @property
    def series_ohm(self) -> Array:
        """Resistance in series with each reading, (rows, columns) ohm."""

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Whether a crossing has no cell to be estimated, (rows, columns)."""

    @property
    def open_cells(self) -> NDArray[np.bool_]:
        """Whether a crossing does not conduct, (rows, columns)."""

    @property
    def of_modules(self) -> "tuple[RecognitionScene, ...]":
        """Scenes of all modules, by their numbers."""
