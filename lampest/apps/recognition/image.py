"""Recognition of loads on a panel of modules, in windows about changes.

Every module has a step test of its own. A step opens a window over the modules that the load may
reach. The window is watched as one panel, and closes after CALM_S without a load. No current
crosses a seam, so that the network of a window is block diagonal; loads may lie across seams. A
load in several windows is taken from the window whose middle is nearest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np

from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.disc_search import NEAR_PITCHES
from lampest.apps.recognition.leaks import Leaks
from lampest.apps.recognition.model_errors import RecognitionScene, WindowScene
from lampest.apps.recognition.watch import Watch
from lampest.apps.recognition.watch_parts import Level, WatchSetup
from lampest.files.process import ONE_BLAS_THREAD
from lampest.panel.panel import Array, Modules, Numbers, Panel

CALM_S = 60.0  # s, three time constants of the mean, `FOLLOWS_S`


class Window(NamedTuple):
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
        spans = list[Numbers]()
        sizes = layout.each.columns, layout.each.rows
        for at, axis, size in zip(place, scene.panel.centres_mm(), sizes, strict=True):
            first = axis[::size]
            last = axis[size - 1 :: size]
            reach = min(NEAR_PITCHES * scene.panel.pitch_mm, (last[0] - first[0]) / 2)
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
        x = load.x_mm[0] + self.x_mm, load.x_mm[1]
        y = load.y_mm[0] + self.y_mm, load.y_mm[1]
        return replace(load, x_mm=x, y_mm=y)


Opened = tuple[Window, Watch, float]


@dataclass(frozen=True, eq=False)
class ImageWatch:
    """Watch of a panel of modules, as `Watch`.

    Attributes
    ----------
    setup : WatchSetup
        Constants of the whole image.
    modules : dict of int to Watch
        Watch of each module with readings for step detection, by its number. Modules under a window
        keep the state in which it opened.
    opened : tuple of (Window, Watch, float)
        The open windows, and the time of the last touch of each, s.
    attachments : tuple of Attachment
        Attachments of all windows, each once.
    leaks, leaks_since_s
        As of `Watch`: between lines of modules no leaks are sought.
    """

    setup: WatchSetup
    modules: Mapping[int, Watch]
    opened: tuple[Opened, ...] = ()
    attachments: tuple[Attachment, ...] = ()
    leaks: Leaks = ()
    leaks_since_s: float = inf

    @classmethod
    def begin(
        cls, setup: WatchSetup, measured: Array, sigma: Array, unloaded: Array, time: float
    ) -> "ImageWatch":
        """Return the watch before the first frame, as `Watch.begin`."""
        modules = dict[int, Watch]()
        for number, module_scene in enumerate(setup.scene.of_modules):
            cells = setup.scene.panel.layout.cells(number)
            finite = np.isfinite(sigma[cells]) & np.isfinite(measured[cells])
            if not finite.any():
                continue
            part = replace(setup, scene=module_scene, water=setup.water[cells])
            at_rest = np.where(finite, measured[cells], np.median(measured[cells][finite]))
            modules[number] = Watch.begin(
                part, at_rest, sigma[cells], unloaded[(..., *cells)], time
            )
        return cls(setup, modules)

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
                # where the module's readings changed most
                corner = self.setup.scene.panel.places_mm[:, *self._layout.cells(number)][:, 0, 0]
                search = module.setup.detector.search(module.setup.scene.panel)
                scores = module.test.scores(module.level.mean - module.rest.mean)
                place = corner + search.places[np.argmax(scores)]
                window = Window.about(self.setup.scene, place)
                opened.append((window, self._begun(window, sigma), time))
        pushed = list[Opened]()
        for window, watch, touched_s in opened:
            watch = watch.push(measured[window.cells], sigma[window.cells], time)
            pushed.append((window, watch, time if watch.present else touched_s))
        under = under_windows(opened) & self.modules.keys()
        modules = followed | {number: self.modules[number] for number in under}
        image = replace(self, modules=modules, opened=tuple(pushed))
        return replace(image, attachments=image._merged())._closed(time) if pushed else image

    def ended(self) -> "ImageWatch":
        """Return the watch once it has ended, as `Watch.ended`."""
        opened = tuple((window, watch.ended(), at) for window, watch, at in self.opened)
        ended = replace(self, opened=opened)
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

        The value is 0 elsewhere; None without any.
        """
        image = np.zeros(self.setup.scene.panel.shape)
        for window, watch, _ in self.opened:
            if watch.change is not None:
                covered = image[window.cells]
                image[window.cells] = np.where(
                    np.abs(watch.change) > np.abs(covered), watch.change, covered
                )
        return image if image.any() else None

    @property
    def _layout(self) -> Modules:
        return self.setup.scene.panel.layout

    @property
    def _watches(self) -> list[Watch]:
        """Watches of the windows, and of the modules without a window."""
        covered = under_windows(self.opened)
        uncovered = (watch for number, watch in self.modules.items() if number not in covered)
        return [*(watch for _, watch, _ in self.opened), *uncovered]

    def _begun(self, window: Window, sigma: Array) -> Watch:
        """Return the watch of a new window, with the joined states of its modules.

        A module that is not read gets the median of the others.
        """
        layout = window.scene.panel.layout
        parts = {
            number: self.modules[number] for number in window.numbers if number in self.modules
        }
        typical = np.median([np.median(part.rest.mean) for part in parts.values()])
        unread = np.full((4, layout.each.rows * layout.each.columns), typical)
        levels = [
            levels_of(parts[number]) if number in parts else unread for number in window.numbers
        ]
        images = layout.of_parts(np.swapaxes(levels, 0, 1))
        mean, *recent = images[1:].reshape(3, -1)
        start = Watch.begin(
            replace(self.setup, scene=window.scene, water=self.setup.water[window.cells]),
            np.exp(images[0]),
            sigma[window.cells],
            np.zeros((0, *layout.shape)),
            max(part.rest.until_s for part in parts.values()),
        )
        loudest = max(part.test.loud.mean() for part in parts.values())
        begun_s = max(part.level.until_s for part in parts.values())
        return replace(
            start,
            test=replace(start.test, loud=np.full(len(start.test.loud), loudest)),
            rest=replace(start.rest, frames=min(part.rest.frames for part in parts.values())),
            level=Level(mean, 1.0, begun_s, begun_s),
            recent=tuple(recent),
            history="",
        )

    def _closed(self, time: float) -> "ImageWatch":
        """Return the watch without the windows that were calm for CALM_S.

        Their modules take over the states.
        """
        opened = tuple(opening for opening in self.opened if time - opening[2] < CALM_S)
        covered = under_windows(opened)
        modules = dict(self.modules)
        for window, watch, touched_s in self.opened:
            if time - touched_s < CALM_S:
                continue
            layout = window.scene.panel.layout
            images = layout.split(levels_of(watch).reshape(4, *layout.shape))
            for number, levels in zip(window.numbers, np.swapaxes(images, 0, 1), strict=True):
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
        loads = [
            (window, window.in_image(load))
            for window, watch, _ in self.opened
            for load in watch.attachments
        ]
        # nearest to its window's middle first, then those that have left; equal loads of others are
        # dropped
        loads.sort(key=lambda pair: pair[1].distance(pair[0].middle))
        past = ((None, load) for load in self.attachments if not load.present)
        merged = list[tuple[Window | None, Attachment]]()
        for window, load in (*loads, *past):
            if not any(
                _same_load(load, nearer) for neighbour, nearer in merged if neighbour is not window
            ):
                merged.append((window, load))
        return tuple(
            sorted(
                (load for _, load in merged),
                key=lambda load: (load.since_s, load.x_mm, load.y_mm),
            )
        )


def levels_of(watch: Watch) -> Array:
    """Return the panel at rest, the level and the last two frames of a watch, ln y (4, cells)."""
    return np.stack([watch.rest.mean, watch.level.mean, *watch.recent])


def under_windows(opened: Sequence[Opened]) -> set[int]:
    """Return the numbers of the modules under windows."""
    return {number for window, *_ in opened for number in window.numbers}


def _same_load(first: Attachment, second: Attachment) -> bool:
    """Return whether two attachments are one load.

    The times of one load overlap, and its places are less than its width apart.
    """
    ends = (inf if load.until_s is None else load.until_s for load in (second, first))
    simultaneous = all(load.since_s < end for load, end in zip((first, second), ends, strict=True))
    return simultaneous and first.adjoins(second)
