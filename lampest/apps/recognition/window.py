"""Windows over neighbouring modules, which are recognised as one panel.

No current crosses a seam, so that the network of a window is block diagonal.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.recognition_scene import RecognitionScene
from lampest.apps.recognition.step_test import NEAR_PITCHES
from lampest.panel.joined_network import JoinedNetwork
from lampest.panel.network import Network
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.response import Response


@dataclass(frozen=True, eq=False)
class WindowScene:
    """Neighbouring modules with the interface of a scene and of its circuit that recognition needs.

    Attributes
    ----------
    panel : Panel
        The window.
    response : Response or None
    of_modules : tuple of RecognitionScene
        Scene of each module.
    wiring : None
        Each module has its own.
    """

    panel: Panel
    response: Response | None
    of_modules: tuple[RecognitionScene, ...]
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
        return self._joined(lambda scene, part: scene.series_ohm + part, np.zeros(self.panel.shape))

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Whether a crossing has no cell to be estimated, (rows, columns)."""
        return self._joined(lambda scene, part: scene.broken + part, np.zeros(self.panel.shape)) > 0

    @property
    def open_cells(self) -> NDArray[np.bool_]:
        """Whether a crossing does not conduct, (rows, columns)."""
        return (
            self._joined(lambda scene, part: scene.open_cells + part, np.zeros(self.panel.shape))
            > 0
        )

    def uniform_start(self, measured: Array) -> Array:
        """Return the uniform start of every module, as `Readout.uniform_start`."""
        return self._joined(lambda scene, part: scene.circuit.uniform_start(part), measured)

    def ties(self, cells: Array) -> Array:
        """Return an empty array, because every module has its own ties."""
        return np.zeros(0)

    def network(self, cells: Array, ties: Array, wiring: Wiring | None) -> Network:
        """Return the network of all modules."""
        layout = layout_of(self.panel)
        parts = zip(self.of_modules, layout.split(cells), strict=True)
        solved = [
            module.circuit.network(part, module.circuit.ties(part), module.wiring)
            for module, part in parts
        ]
        return JoinedNetwork.of(cells, solved, layout)

    def _joined(self, part: Callable[[RecognitionScene, Array], Array], image: Array) -> Array:
        layout = layout_of(self.panel)
        pairs = zip(self.of_modules, layout.split(image), strict=True)
        return np.asarray(layout.joined(np.stack([part(*pair) for pair in pairs])))


@dataclass(frozen=True, eq=False)
class Window:
    """A rectangle of modules.

    Attributes
    ----------
    scene : WindowScene
    numbers : tuple of int
        Numbers of the modules, row by row.
    cells : pair of slice
        Rows and columns in the image.
    x_mm, y_mm : float
        Place of the first cell in the image.
    middle : array, shape (2,)
        Mean place of the cells, mm.
    """

    scene: WindowScene
    numbers: tuple[int, ...]
    cells: tuple[slice, slice]
    x_mm: float
    y_mm: float
    middle: Array

    @classmethod
    def about(cls, scene: RecognitionScene, place: Array) -> "Window":
        """Return the window over the modules that a load at a place (x, y) in mm may reach."""
        layout = layout_of(scene.panel)
        spans = list[NDArray[np.intp]]()
        sizes = layout.each.columns, layout.each.rows
        for at, axis, size in zip(place, scene.panel.centres_mm(), sizes, strict=True):
            first = axis[::size]
            last = axis[size - 1 :: size]
            reach = min(NEAR_PITCHES * scene.panel.pitch_mm, float(last[0] - first[0]) / 2)
            distance = np.maximum(first - at, at - last)
            spans.append(np.flatnonzero((distance <= reach) | (distance == distance.min())))
        columns, rows = spans
        numbers = tuple(int(j * layout.columns + k) for j in rows for k in columns)
        top, left = layout.cells(numbers[0])
        bottom, right = layout.cells(numbers[-1])
        cells = slice(top.start, bottom.stop), slice(left.start, right.stop)
        part = replace(layout, rows=len(rows), columns=len(columns))
        response = scene.response
        scenes = tuple(scene.of_modules[number] for number in numbers)
        window_scene = WindowScene(
            Panel(modules=part), response and response.of_cells(cells), scenes
        )
        places = scene.panel.places_mm[:, *cells]
        x, y = places[:, 0, 0]
        return cls(window_scene, numbers, cells, float(x), float(y), places.mean(axis=(1, 2)))

    def in_image(self, load: Attachment) -> Attachment:
        """Return an attachment with its place in the image instead of the window."""
        x, x_sd = load.x_mm
        y, y_sd = load.y_mm
        return replace(load, x_mm=(x + self.x_mm, x_sd), y_mm=(y + self.y_mm, y_sd))


def layout_of(panel: Panel) -> Modules:
    """Return the layout of a panel of modules."""
    assert panel.modules is not None
    return panel.modules
