"""Recognition of loads on a panel of modules, in windows about changes.

Every module has a step test of its own. A step opens a window over the modules that the load may reach. The window is
watched as one panel, and closes after CALM_S without a load. No current crosses a seam, so that the network of a window
is block diagonal; loads may lie across seams. A load in several windows is taken from the window whose middle is
nearest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from lampest.files.process import ONE_BLAS_THREAD
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.watch import NEAR_PITCHES, Panelled, Watch
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.response import Response
from lampest.panel.scene import Scene

CALM_S = 60.0  # s, three time constants of the mean, `FOLLOWS_S`


@dataclass(frozen=True, eq=False)
class WindowNetwork:
    """The solved networks of a window's modules, with the interface that recognition needs of one network."""

    layout: Modules
    networks: tuple[Any, ...]

    def reading(self) -> Array:
        """Return the readings of the window, (rows, columns)."""
        return np.asarray(self.layout.joined(np.stack([network.reading() for network in self.networks])))

    def sensitivity(self, cells: Any = None) -> Array:
        """Return the block diagonal Jacobian J (readings, cells), or its columns of some cells by number."""
        numbers = self.layout.split(np.arange(np.prod(self.layout.shape)).reshape(self.layout.shape))
        whole = np.zeros((numbers.size, numbers.size))
        for network, own in zip(self.networks, numbers.reshape(len(numbers), -1), strict=True):
            whole[np.ix_(own, own)] = network.sensitivity()
        return whole if cells is None else whole[:, cells]


@dataclass(frozen=True, eq=False)
class WindowScene:
    """Neighbouring modules with the interface of a scene and of its circuit that recognition needs.

    Attributes
    ----------
    panel : Panel
        The window.
    response : Response or None
    scenes : tuple of Scene
        Scene of each module.
    """

    panel: Panel
    response: Response | None
    scenes: tuple[Scene, ...]
    wiring: None = None

    @property
    def circuit(self) -> "WindowScene":
        """The circuit of all modules."""
        return self

    @property
    def unit(self) -> str:
        """Unit of the readings, ohm or volt."""
        return self.scenes[0].circuit.unit

    @property
    def series_ohm(self) -> Array:
        """Resistance in series, (rows, columns) ohm."""
        return self._joined(lambda scene, part: scene.series_ohm + part, np.zeros(self.panel.shape))

    def uniform_start(self, measured: Array) -> Array:
        """Return the uniform start of every module, as `Readout.uniform_start`."""
        return self._joined(lambda scene, part: scene.circuit.uniform_start(part), measured)

    def ties(self, cells: Array) -> Array:
        """Return an empty array, because every module has its own ties."""
        return np.zeros(0)

    def network(self, cells: Array, ties: Array, wiring: None) -> WindowNetwork:
        """Return the network of all modules."""
        parts = zip(self.scenes, self.layout.split(cells), strict=True)
        solved = (own.circuit.network(part, own.circuit.ties(part), own.wiring) for own, part in parts)
        return WindowNetwork(self.layout, tuple(solved))

    @property
    def layout(self) -> Modules:
        """Layout of the modules."""
        assert self.panel.modules is not None
        return self.panel.modules

    def _joined(self, part: Callable[[Scene, Array], Array], image: Array) -> Array:
        pairs = zip(self.scenes, self.layout.split(image), strict=True)
        return np.asarray(self.layout.joined(np.stack([part(*pair) for pair in pairs])))


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
    def about(cls, scene: Scene, place: Array) -> "Window":
        """Return the window over the modules that a load at a place (x, y) in mm may reach."""
        layout, spans = scene.panel.modules, list[NDArray[np.intp]]()
        assert layout is not None
        sizes = layout.each.columns, layout.each.rows
        for at, axis, size in zip(place, scene.panel.centres_mm(), sizes, strict=True):
            first, last = axis[::size], axis[size - 1 :: size]
            reach = min(NEAR_PITCHES * scene.panel.pitch_mm, float(last[0] - first[0]) / 2)
            away = np.maximum(first - at, at - last)
            spans.append(np.flatnonzero((away <= reach) | (away == away.min())))
        columns, rows = spans
        numbers = tuple(int(j * layout.columns + k) for j in rows for k in columns)
        (top, left), (bottom, right) = layout.cells(numbers[0]), layout.cells(numbers[-1])
        cells = slice(top.start, bottom.stop), slice(left.start, right.stop)
        part, response = replace(layout, rows=len(rows), columns=len(columns)), scene.response
        scenes = tuple(scene.of_modules[number] for number in numbers)
        own = WindowScene(Panel(modules=part), response and response.of_cells(cells), scenes)
        places = scene.panel.places_mm[:, *cells]
        x, y = places[:, 0, 0]
        return cls(own, numbers, cells, float(x), float(y), places.mean(axis=(1, 2)))


Opened: TypeAlias = tuple[Window, Watch, float]


@dataclass(frozen=True, eq=False)
class ImageWatch:
    """Watch of a panel of modules, as `Watch`.

    Attributes
    ----------
    panelled : Panelled
        Constants of the whole image.
    modules : tuple of Watch or None
        Watch of each module for step detection, None for one without readings. Modules under a window keep the state
        in which it opened.
    opened : tuple of (Window, Watch, float)
        The open windows, and the time of the last touch of each, s.
    attachments : tuple of Attachment
        Attachments of all windows, each once.
    """

    panelled: Panelled
    modules: tuple[Watch | None, ...]
    opened: tuple[Opened, ...] = ()
    attachments: tuple[Attachment, ...] = ()

    @classmethod
    def begin(cls, panelled: Panelled, measured: Array, sigma: Array, unloaded: Array, time: float) -> "ImageWatch":
        """Return the watch before the first frame, as `Watch.begin`."""
        scene, modules = panelled.scene, list[Watch | None]()
        for number, own in enumerate(scene.of_modules):
            cells = _layout(scene).cells(number)
            read = np.isfinite(sigma[cells]) & np.isfinite(measured[cells])
            part = replace(panelled, scene=own, water=panelled.water[cells])
            at_rest = np.where(read, measured[cells], np.median(measured[cells][read])) if read.any() else None
            given = sigma[cells], unloaded[(..., *cells)], time
            modules.append(None if at_rest is None else Watch.begin(part, at_rest, *given))
        return cls(panelled, tuple(modules))

    @ONE_BLAS_THREAD
    def push(self, measured: Array, sigma: Array, time: float) -> "ImageWatch":
        """Push a frame, as `Watch.push`."""
        modules, opened, stepped = list(self.modules), list(self.opened), list[int]()
        # Step detection in modules without a window; a step opens one, and freezes the modules under it.
        for number in set(range(len(modules))) - under_windows(opened):
            if (module := modules[number]) is not None:
                cells = self._layout.cells(number)
                modules[number] = module = module.followed(measured[cells], sigma[cells], time)
                if module.present:
                    stepped.append(number)
        for number in stepped:
            if number not in under_windows(opened):
                window = Window.about(self.panelled.scene, self._place(number, modules[number]))
                opened.append((window, self._begun(window, sigma), time))
        for number in under_windows(opened):
            modules[number] = self.modules[number]
        pushed = list[Opened]()
        for window, watch, touched_s in opened:
            watch = watch.push(measured[window.cells], sigma[window.cells], time)
            pushed.append((window, watch, time if watch.present else touched_s))
        image = replace(self, modules=tuple(modules), opened=tuple(pushed))
        return replace(image, attachments=image._merged())._closed(time) if pushed else image

    def touched(self, unloaded: Array) -> bool:
        """Return whether any module is touched, as `Watch.touched`."""
        each = self._layout.split(unloaded)
        return any(watch is not None and watch.touched(each[:, n]) for n, watch in enumerate(self.modules))

    def ended(self) -> "ImageWatch":
        """Return the watch once it has ended, as `Watch.ended`."""
        ended = replace(self, opened=tuple((window, watch.ended(), at) for window, watch, at in self.opened))
        return replace(ended, attachments=ended._merged())

    @property
    def doubt(self) -> str:
        """The first doubt of a window or module, as `Watch.doubt`; '' where there is none."""
        return next((watch.doubt for watch in self._watches if watch.doubt), "")

    @property
    def stands_out(self) -> float:
        """Largest `Watch.stands_out` of all windows and modules."""
        return max(watch.stands_out for watch in self._watches)

    @cached_property
    def change(self) -> Array | None:
        """ln r/r0 (rows, columns) of the loads that the windows recognised last, 0 elsewhere; None without any."""
        whole = np.zeros(self.panelled.scene.panel.shape)
        for window, watch, _ in self.opened:
            if watch.change is not None:
                known = whole[window.cells]
                whole[window.cells] = np.where(np.abs(watch.change) > np.abs(known), watch.change, known)
        return whole if whole.any() else None

    @property
    def _layout(self) -> Modules:
        return _layout(self.panelled.scene)

    @property
    def _watches(self) -> list[Watch]:
        """Watches of the windows, and of the modules without a window."""
        covered = under_windows(self.opened)
        alone = (watch for number, watch in enumerate(self.modules) if watch is not None and number not in covered)
        return [*(watch for _, watch, _ in self.opened), *alone]

    def _place(self, number: int, watch: Watch | None) -> Array:
        """Return the place (x, y) in the image, mm, where a module's readings changed most."""
        assert watch is not None
        corner = self.panelled.scene.panel.places_mm[:, *self._layout.cells(number)][:, 0, 0]
        scores = watch.test.scores(watch.mean - watch.resting)
        return np.asarray(
            corner + watch.panelled.detector.search(watch.panelled.scene.panel).places[int(np.argmax(scores))]
        )

    def _begun(self, window: Window, sigma: Array) -> Watch:
        """Return the watch of a new window, with the joined states of its modules."""
        panelled, layout = self.panelled, window.scene.layout
        parts = [self.modules[number] for number in window.numbers]
        known = [part for part in parts if part is not None]
        begun_s = max(part.window[-1][0] if part.window else part.begun for part in known)
        blank = known[0].resting * 0 + np.median([np.median(part.resting) for part in known])

        def whole(of: Callable[[Watch], Array]) -> Array:
            each = [blank if part is None else of(part) for part in parts]
            return np.asarray(layout.joined(np.reshape(each, (len(each), layout.each.rows, layout.each.columns))))

        shape, baseline = window.scene.panel.shape, whole(lambda part: part.resting)
        own = replace(panelled, scene=cast(Scene, window.scene), water=panelled.water[window.cells])
        start = Watch.begin(own, np.exp(baseline), sigma[window.cells], np.zeros((0, *shape)), known[0].rest_s)
        loud = np.full(len(start.test.loud), max(float(part.test.loud.mean()) for part in known))
        return replace(
            start,
            test=replace(start.test, loud=loud),
            rested=min(part.rested for part in known),
            rest_s=max(part.rest_s for part in known),
            mean=whole(lambda part: part.mean).ravel(),
            begun=begun_s,
            recent=tuple(whole(lambda part, n=n: part.recent[n]).ravel() for n in (0, 1)),  # type: ignore[misc]
            window=((begun_s, baseline.ravel()),),
            uneven=False,
        )

    def _closed(self, time: float) -> "ImageWatch":
        """Return the watch without the windows that were calm for CALM_S; their modules take over the states."""
        opened = tuple(opening for opening in self.opened if time - opening[2] < CALM_S)
        modules, covered = list(self.modules), under_windows(opened)
        for window, watch, _ in set(self.opened) - set(opened):
            shape, layout = window.scene.panel.shape, window.scene.layout
            images = np.reshape([watch.resting, watch.mean, *watch.recent], (4, *shape))
            for place, number in enumerate(window.numbers):
                module = modules[number]
                if module is not None and number not in covered:
                    baseline, mean, *recent = layout.split(images)[:, place].reshape(4, -1)
                    at_rest = replace(module, resting=baseline, rest_s=watch.rest_s, rested=watch.rested, mean=mean)
                    again = replace(at_rest, recent=tuple(recent), begun=watch.begun, window=watch.window)
                    modules[number] = replace(again, uncovered_s=watch.uncovered_s)
        return replace(self, modules=tuple(modules), opened=opened)

    def _merged(self) -> tuple[Attachment, ...]:
        """Return the attachments of all windows; a load in two windows is taken from the nearer middle."""
        every = list[tuple[Window, Attachment]]()
        for window, watch, _ in self.opened:
            for load in watch.attachments:
                x, y = (load.x_mm[0] + window.x_mm, load.x_mm[1]), (load.y_mm[0] + window.y_mm, load.y_mm[1])
                every.append((window, replace(load, x_mm=x, y_mm=y)))
        every.sort(key=lambda pair: pair[1].distance((pair[0].middle[0], pair[0].middle[1])))
        # nearest to its window's middle first; equal loads of other windows are dropped
        merged: list[tuple[Window, Attachment]] = []
        for window, load in every:
            if not any(window is not neighbour and _same_load(load, seen) for neighbour, seen in merged):
                merged.append((window, load))
        ended = [load for load in self.attachments if load.until_s is not None]
        past = [load for load in ended if not any(_same_load(load, seen) for _, seen in merged)]
        return tuple(sorted([*past, *(load for _, load in merged)], key=lambda load: load.since_s))


def under_windows(opened: Sequence[Opened]) -> set[int]:
    """Return the numbers of the modules under windows."""
    return {number for window, *_ in opened for number in window.numbers}


def _layout(scene: Scene) -> Modules:
    assert scene.panel.modules is not None
    return scene.panel.modules


def _same_load(first: Attachment, second: Attachment) -> bool:
    """Return whether two attachments are one load: their times overlap, and their distance is below their width."""
    ends = (inf if load.until_s is None else load.until_s for load in (second, first))
    together = all(load.since_s < end for load, end in zip((first, second), ends, strict=True))
    return together and first.distance(second.place) < max(first.width, second.width)
