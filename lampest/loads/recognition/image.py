"""Loads on a panel of modules: windows of up to 2 × 2 modules, each watched as one panel, and what they saw together.

No current crosses a seam, so that the window's circuit falls into blocks; loads lie over them. Windows overlap by one
module: what is smaller than a module lies whole in at least one, and counts where it stands nearest to the middle.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any, cast

import numpy as np

from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.watch import Panelled, Watch
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.response import Response
from lampest.panel.scene import Scene


def window_layout(layout: Modules) -> Modules:
    """Of one window."""
    return replace(layout, rows=min(2, layout.rows), columns=min(2, layout.columns))


@dataclass(frozen=True, eq=False)
class WindowNetwork:
    """The solved networks of a window's modules: what recognition asks of one network."""

    layout: Modules
    networks: tuple[Any, ...]

    def reading(self) -> Array:
        """(rows, columns) of the window."""
        return np.asarray(self.layout.joined(np.stack([network.reading() for network in self.networks])))

    def sensitivity(self, cells: Any = None) -> Array:
        """J (readings, cells), of some cells if these are given by their numbers."""
        numbers = self.layout.split(np.arange(np.prod(self.layout.shape)).reshape(self.layout.shape))
        whole = np.zeros((numbers.size, numbers.size))
        for network, own in zip(self.networks, numbers.reshape(len(numbers), -1), strict=True):
            whole[np.ix_(own, own)] = network.sensitivity()
        return whole if cells is None else whole[:, cells]


@dataclass(frozen=True, eq=False)
class WindowScene:
    """Neighbouring modules as a scene and as its circuit, as far as recognition asks; scenes : of each module."""

    panel: Panel
    response: Response | None
    scenes: tuple[Scene, ...]
    wiring: None = None

    @property
    def circuit(self) -> "WindowScene":
        """Of all modules."""
        return self

    @property
    def unit(self) -> str:
        """ohm or volt."""
        return self.scenes[0].circuit.unit

    @property
    def series_ohm(self) -> Array:
        """(rows, columns) ohm."""
        return self._joined(lambda scene, part: scene.series_ohm + part, np.zeros(self.panel.shape))

    def uniform_start(self, measured: Array) -> Array:
        """As `Readout.uniform_start`, module by module."""
        return self._joined(lambda scene, part: scene.circuit.uniform_start(part), measured)

    def ties(self, cells: Array) -> Array:
        """Every module has its own."""
        return np.zeros(0)

    def network(self, cells: Array, ties: Array, wiring: None) -> WindowNetwork:
        """Of all modules."""
        parts = zip(self.scenes, self._layout.split(cells), strict=True)
        solved = (own.circuit.network(part, own.circuit.ties(part), own.wiring) for own, part in parts)
        return WindowNetwork(self._layout, tuple(solved))

    @property
    def _layout(self) -> Modules:
        assert self.panel.modules is not None
        return self.panel.modules

    def _joined(self, part: Callable[[Scene, Array], Array], image: Array) -> Array:
        pairs = zip(self.scenes, self._layout.split(image), strict=True)
        return np.asarray(self._layout.joined(np.stack([part(*pair) for pair in pairs])))


@dataclass(frozen=True, eq=False)
class Window:
    """Where a window lies in the image. cells : of the image. x_mm, y_mm : of its first cell. middle : x, y in mm."""

    scene: WindowScene
    cells: tuple[slice, slice]
    x_mm: float
    y_mm: float
    middle: Array

    @classmethod
    def all_of(cls, scene: Scene) -> "tuple[Window, ...]":
        """All windows of an image in which a module is read."""
        layout, found = scene.panel.modules, list[Window]()
        assert layout is not None
        part = window_layout(layout)
        for row, column in np.ndindex(layout.rows - part.rows + 1, layout.columns - part.columns + 1):
            numbers = [(row + j) * layout.columns + column + k for j, k in np.ndindex(part.rows, part.columns)]
            (top, left), (bottom, right) = layout.cells(numbers[0]), layout.cells(numbers[-1])
            cells = slice(top.start, bottom.stop), slice(left.start, right.stop)
            if not set(numbers) <= set(scene.dead_modules):
                response, scenes = scene.response, tuple(scene.of_modules[number] for number in numbers)
                own = WindowScene(Panel(modules=part), response and response.of_cells(cells), scenes)
                places = scene.panel.places_mm[:, *cells]
                corner, middle = places[:, 0, 0], places.mean(axis=(1, 2))
                found.append(cls(own, cells, float(corner[0]), float(corner[1]), middle))
        return tuple(found)


@dataclass(frozen=True, eq=False)
class ImageWatch:
    """As `Watch`, of a panel of modules. watches : of the windows. began : s. attachments : those of all, each once."""

    windows: tuple[Window, ...]
    watches: tuple[Watch, ...]
    shape: tuple[int, int]
    began: float
    attachments: tuple[Attachment, ...] = ()

    @classmethod
    def begin(cls, panelled: Panelled, measured: Array, sigma: Array, unloaded: Array, time: float) -> "ImageWatch":
        """As `Watch.begin`. A load is recognised where it begins near a window's middle."""
        windows, watches, pitch = Window.all_of(panelled.scene), list[Watch](), panelled.scene.panel.pitch_mm
        read, middles = np.isfinite(sigma), np.stack([window.middle for window in windows])
        detector = Detector(windows[0].scene.panel, panelled.detector.patch_mm)
        for window in windows:
            cells, places = window.cells, detector.search.places + np.array([window.x_mm, window.y_mm])
            own = replace(panelled, scene=cast(Scene, window.scene), detector=detector, water=panelled.water[cells])
            rest = np.where(read[cells], measured[cells], np.median(measured[cells][read[cells]]))
            apart = np.linalg.norm(places[:, None] - middles, axis=2).min(axis=1) + pitch
            begun = Watch.begin(own, rest, sigma[cells], unloaded[(..., *cells)], time)
            watches.append(replace(begun, own=np.linalg.norm(places - window.middle, axis=1) <= apart))
        return cls(windows, tuple(watches), panelled.scene.panel.shape, time)

    def push(self, measured: Array, sigma: Array, time: float) -> "ImageWatch":
        """As `Watch.push`."""
        pairs = zip(self.windows, self.watches, strict=True)
        watches = tuple(watch.push(measured[own.cells], sigma[own.cells], time) for own, watch in pairs)
        here = replace(self, watches=watches)
        same = all(one.attachments is other.attachments for one, other in zip(watches, self.watches, strict=True))
        return here if same else replace(here, attachments=here._merged())

    def touched(self, unloaded: Array) -> bool:
        """As `Watch.touched`, in any window."""
        return any(
            watch.touched(unloaded[(..., *own.cells)]) for own, watch in zip(self.windows, self.watches, strict=True)
        )

    def ended(self) -> "ImageWatch":
        """As `Watch.ended`."""
        here = replace(self, watches=tuple(watch.ended() for watch in self.watches))
        return replace(here, attachments=here._merged())

    @property
    def doubt(self) -> str:
        """As `Watch.doubt`, of the first window that has one."""
        return next((watch.doubt for watch in self.watches if watch.doubt), "")

    @property
    def stands_out(self) -> float:
        """As `Watch.stands_out`, in the window where readings differ most."""
        return max(watch.stands_out for watch in self.watches)

    @cached_property
    def change(self) -> Array | None:
        """(rows, columns) ln r/r0 of what windows recognised last; 0 where nothing was; None: nowhere was anything."""
        whole = np.zeros(self.shape)
        for window, watch in zip(self.windows, self.watches, strict=True):
            if watch.change is not None:
                here = whole[window.cells]
                whole[window.cells] = np.where(np.abs(watch.change) > np.abs(here), watch.change, here)
        return whole if whole.any() else None

    def _merged(self) -> tuple[Attachment, ...]:
        """Those of all windows: of two that are one, the one that stands nearer to its window's middle."""
        every = list[tuple[Window, Attachment]]()
        for window, watch in zip(self.windows, self.watches, strict=True):
            for load in watch.attachments:
                x, y = (load.x_mm[0] + window.x_mm, load.x_mm[1]), (load.y_mm[0] + window.y_mm, load.y_mm[1])
                every.append((window, replace(load, x_mm=x, y_mm=y)))
        every.sort(key=lambda pair: pair[1].distance((pair[0].middle[0], pair[0].middle[1])))
        ended = [one for one in self.attachments if one.until_s is not None and one.until_s <= self.began]
        kept: list[tuple[Window, Attachment]] = []
        for window, load in every:
            if not any(window is not other and _one(load, seen) for other, seen in kept):
                kept.append((window, load))
        return tuple(sorted([*ended, *(load for _, load in kept)], key=lambda load: load.since_s))


def _one(load: Attachment, other: Attachment) -> bool:
    """Whether two windows saw one load: at one time, and nearer than the larger of them is wide."""
    ends = (inf if one.until_s is None else one.until_s for one in (other, load))
    together = all(one.since_s < end for one, end in zip((load, other), ends, strict=True))
    return together and load.distance(other.place) < max(load.width, other.width)
