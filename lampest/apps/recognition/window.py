"""Windows over neighbouring modules, which are recognised as one panel.

No current crosses a seam, so that the network of a window is block diagonal.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.recognition_scene import RecognitionScene, WindowScene
from lampest.apps.recognition.step_test import NEAR_PITCHES
from lampest.panel.panel import Array, Panel


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
        layout = scene.panel.layout
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
