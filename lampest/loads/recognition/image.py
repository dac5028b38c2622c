"""Recognition of loads on a panel of modules, in windows about changes.

Every module has a step test of its own. A step opens a window over the modules that the load may
reach. The window is watched as one panel, and closes after CALM_S without a load. No current
crosses a seam, so that the network of a window is block diagonal; loads may lie across seams. A
load in several windows is taken from the window whose middle is nearest.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from lampest.files.process import ONE_BLAS_THREAD
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.step_test import NEAR_PITCHES
from lampest.loads.recognition.watch import Level, Panelled, Watch
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.response import Response
from lampest.panel.scene import Scene

CALM_S = 60.0  # s, three time constants of the mean, `FOLLOWS_S`


class WindowNetwork(NamedTuple):
    """The solved networks of a window's modules.

    They have the interface that recognition needs of one network.
    """

    layout: Modules
    networks: tuple[Any, ...]

    def reading(self) -> Array:
        """Return the readings of the window, (rows, columns)."""
        return np.asarray(
            self.layout.joined(np.stack([network.reading() for network in self.networks]))
        )

    def sensitivity(self) -> Array:
        """Return the block diagonal Jacobian J, (readings, cells)."""
        numbers = self.layout.split(
            np.arange(np.prod(self.layout.shape)).reshape(self.layout.shape)
        )
        matrix = np.zeros((numbers.size, numbers.size))
        for network, index in zip(self.networks, numbers.reshape(len(numbers), -1), strict=True):
            matrix[np.ix_(index, index)] = network.sensitivity()
        return matrix


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

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Whether a crossing has no cell to be estimated, (rows, columns)."""
        return (
            self._joined(lambda scene, part: scene.broken.astype(float), np.zeros(self.panel.shape))
            > 0
        )

    def uniform_start(self, measured: Array) -> Array:
        """Return the uniform start of every module, as `Readout.uniform_start`."""
        return self._joined(lambda scene, part: scene.circuit.uniform_start(part), measured)

    def ties(self, cells: Array) -> Array:
        """Return an empty array, because every module has its own ties."""
        return np.zeros(0)

    def network(self, cells: Array, ties: Array, wiring: None) -> WindowNetwork:
        """Return the network of all modules."""
        layout = layout_of(self.panel)
        parts = zip(self.scenes, layout.split(cells), strict=True)
        solved = (
            module.circuit.network(part, module.circuit.ties(part), module.wiring)
            for module, part in parts
        )
        return WindowNetwork(layout, tuple(solved))

    def _joined(self, part: Callable[[Scene, Array], Array], image: Array) -> Array:
        layout = layout_of(self.panel)
        pairs = zip(self.scenes, layout.split(image), strict=True)
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
    def about(cls, scene: Scene, place: Array) -> "Window":
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


Opened: TypeAlias = tuple[Window, Watch, float]


@dataclass(frozen=True, eq=False)
class ImageWatch:
    """Watch of a panel of modules, as `Watch`.

    Attributes
    ----------
    panelled : Panelled
        Constants of the whole image.
    modules : dict of int to Watch
        Watch of each module with readings for step detection, by its number. Modules under a window
        keep the state in which it opened.
    opened : tuple of (Window, Watch, float)
        The open windows, and the time of the last touch of each, s.
    attachments : tuple of Attachment
        Attachments of all windows, each once.
    """

    panelled: Panelled
    modules: Mapping[int, Watch]
    opened: tuple[Opened, ...] = ()
    attachments: tuple[Attachment, ...] = ()

    @classmethod
    def begin(
        cls, panelled: Panelled, measured: Array, sigma: Array, unloaded: Array, time: float
    ) -> "ImageWatch":
        """Return the watch before the first frame, as `Watch.begin`."""
        modules = dict[int, Watch]()
        for number, module_scene in enumerate(panelled.scene.of_modules):
            cells = layout_of(panelled.scene.panel).cells(number)
            finite = np.isfinite(sigma[cells]) & np.isfinite(measured[cells])
            if not finite.any():
                continue
            part = replace(panelled, scene=module_scene, water=panelled.water[cells])
            at_rest = np.where(finite, measured[cells], np.median(measured[cells][finite]))
            modules[number] = Watch.begin(
                part, at_rest, sigma[cells], unloaded[(..., *cells)], time
            )
        return cls(panelled, modules)

    @ONE_BLAS_THREAD
    def push(self, measured: Array, sigma: Array, time: float) -> "ImageWatch":
        """Push a frame, as `Watch.push`."""
        # Step detection in modules without a window; a step opens one, and freezes the modules
        # under it.
        followed = dict[int, Watch]()
        opened = list(self.opened)
        for number, module in self.modules.items():
            if number not in under_windows(self.opened):
                cells = self._layout.cells(number)
                followed[number] = module.followed(measured[cells], sigma[cells], time)
        for number, module in followed.items():
            if module.present and number not in under_windows(opened):
                window = Window.about(self.panelled.scene, self._place(number, module))
                opened.append((window, self._begun(window, sigma), time))
        pushed = list[Opened]()
        for window, watch, touched_s in opened:
            watch = watch.push(measured[window.cells], sigma[window.cells], time)
            pushed.append((window, watch, time if watch.present else touched_s))
        under = {
            number: self.modules[number] for number in under_windows(opened) & self.modules.keys()
        }
        image = replace(self, modules={**followed, **under}, opened=tuple(pushed))
        return replace(image, attachments=image._merged())._closed(time) if pushed else image

    def ended(self) -> "ImageWatch":
        """Return the watch once it has ended, as `Watch.ended`."""
        ended = replace(
            self, opened=tuple((window, watch.ended(), at) for window, watch, at in self.opened)
        )
        return replace(ended, attachments=ended._merged())

    @property
    def doubt(self) -> str:
        """The first doubt of a window or module, as `Watch.doubt`; '' where there is none."""
        return next((watch.doubt for watch in self._watches if watch.doubt), "")

    @property
    def faults(self) -> tuple[tuple[str, float], ...]:
        """Open lines of all windows and modules, counted within each, as `Watch.faults`."""
        return tuple(dict.fromkeys(fault for watch in self._watches for fault in watch.faults))

    @property
    def brief(self) -> tuple[tuple[float, float], ...]:
        """Times of loads that left too soon to be recognised, of all windows, as `Watch.brief`."""
        return tuple(dict.fromkeys(times for _, watch, _ in self.opened for times in watch.brief))

    @property
    def stands_out(self) -> float:
        """Largest `Watch.stands_out` of all windows and modules."""
        return max(watch.stands_out for watch in self._watches)

    @cached_property
    def change(self) -> Array | None:
        """ln r/r0 (rows, columns) of the loads that the windows recognised last.

        0 elsewhere; None without any.
        """
        image = np.zeros(self.panelled.scene.panel.shape)
        for window, watch, _ in self.opened:
            if watch.change is not None:
                covered = image[window.cells]
                image[window.cells] = np.where(
                    np.abs(watch.change) > np.abs(covered), watch.change, covered
                )
        return image if image.any() else None

    @property
    def _layout(self) -> Modules:
        return layout_of(self.panelled.scene.panel)

    @property
    def _watches(self) -> list[Watch]:
        """Watches of the windows, and of the modules without a window."""
        covered = under_windows(self.opened)
        uncovered = (watch for number, watch in self.modules.items() if number not in covered)
        return [*(watch for _, watch, _ in self.opened), *uncovered]

    def _place(self, number: int, watch: Watch) -> Array:
        """Return the place (x, y) in the image, mm, where a module's readings changed most."""
        corner = self.panelled.scene.panel.places_mm[:, *self._layout.cells(number)][:, 0, 0]
        search = watch.panelled.detector.search(watch.panelled.scene.panel)
        strongest = int(np.argmax(watch.test.scores(watch.level.mean - watch.rest.mean)))
        return np.asarray(corner + search.places[strongest])

    def _begun(self, window: Window, sigma: Array) -> Watch:
        """Return the watch of a new window, with the joined states of its modules."""
        layout = layout_of(window.scene.panel)
        watched = [self.modules[number] for number in window.numbers if number in self.modules]
        # A module without readings has the median of the others.
        median = np.median([np.median(module.rest.mean) for module in watched])
        without_readings = np.full((4, *watched[0].rest.mean.shape), median)
        states = [
            _levels(self.modules[number]) if number in self.modules else without_readings
            for number in window.numbers
        ]
        images = layout.joined(
            np.swapaxes(states, 0, 1).reshape(4, -1, layout.each.rows, layout.each.columns)
        )
        _, mean, *recent = images.reshape(4, -1)
        panelled = replace(
            self.panelled, scene=cast(Scene, window.scene), water=self.panelled.water[window.cells]
        )
        start = Watch.begin(
            panelled,
            np.exp(images[0]),
            sigma[window.cells],
            np.zeros((0, *layout.shape)),
            max(module.rest.until_s for module in watched),
        )
        loudest = max(float(module.test.loud.mean()) for module in watched)
        begun = max(module.level.until_s for module in watched)
        return replace(
            start,
            test=replace(start.test, loud=np.full(len(start.test.loud), loudest)),
            rest=replace(start.rest, frames=min(module.rest.frames for module in watched)),
            level=Level(mean, 1.0, begun, begun),
            recent=tuple(recent),
            history="",
        )

    def _closed(self, time: float) -> "ImageWatch":
        """Return the watch without the windows that were calm for CALM_S.

        Their modules take over the states.
        """
        opened = tuple(opening for opening in self.opened if time - opening[2] < CALM_S)
        calm = tuple(opening for opening in self.opened if time - opening[2] >= CALM_S)
        covered = under_windows(opened)
        modules = dict(self.modules)
        for window, watch, _ in calm:
            layout = layout_of(window.scene.panel)
            images = np.reshape(_levels(watch), (4, *layout.shape))
            of_modules = np.swapaxes(layout.split(images), 0, 1)
            for number, levels in zip(window.numbers, of_modules, strict=True):
                if number in modules and number not in covered:
                    baseline, mean, *recent = levels.reshape(4, -1)
                    modules[number] = replace(
                        modules[number],
                        rest=replace(watch.rest, mean=baseline),
                        level=replace(watch.level, mean=mean),
                        recent=tuple(recent),
                        history=watch.history,
                    )
        return replace(self, modules=modules, opened=opened)

    def _merged(self) -> tuple[Attachment, ...]:
        """Return the attachments of all windows.

        A load in two windows is taken from the nearer middle.
        """
        loads = list[tuple[Window, Attachment]]()
        for window, watch, _ in self.opened:
            loads += [(window, window.in_image(load)) for load in watch.attachments]
        # nearest to its window's middle first; equal loads of other windows are dropped
        loads.sort(key=lambda pair: pair[1].distance((pair[0].middle[0], pair[0].middle[1])))
        merged = list[tuple[Window, Attachment]]()
        for window, load in loads:
            elsewhere = [nearer for neighbour, nearer in merged if neighbour is not window]
            if not any(_same_load(load, nearer) for nearer in elsewhere):
                merged.append((window, load))
        ended = [load for load in self.attachments if load.until_s is not None]
        past = [load for load in ended if not any(_same_load(load, late) for _, late in merged)]
        return tuple(sorted([*past, *(load for _, load in merged)], key=lambda load: load.since_s))


def under_windows(opened: Sequence[Opened]) -> set[int]:
    """Return the numbers of the modules under windows."""
    return {number for window, *_ in opened for number in window.numbers}


def _levels(watch: Watch) -> tuple[Array, Array, Array, Array]:
    """Return the unloaded level of a watch, its present level and the two last frames."""
    previous, last = watch.recent
    return watch.rest.mean, watch.level.mean, previous, last


def layout_of(panel: Panel) -> Modules:
    """Return the layout of a panel of modules."""
    assert panel.modules is not None
    return panel.modules


def _same_load(first: Attachment, second: Attachment) -> bool:
    """Return whether two attachments are one load.

    They are if their times overlap, and their distance is below their width.
    """
    ends = (inf if load.until_s is None else load.until_s for load in (second, first))
    simultaneous = all(load.since_s < end for load, end in zip((first, second), ends, strict=True))
    return simultaneous and first.distance(second.place) < max(first.width, second.width)
