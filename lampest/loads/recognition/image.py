"""Loads on a panel of modules: windows of up to 2 × 2 modules, each watched as one panel, and what they saw together.

No current crosses a seam, so that the window's circuit falls into blocks; loads lie over them. Windows overlap by one
module: what is smaller than a module lies whole in at least one, and counts where it stands nearest to the middle.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.settings import ModelErrors
from lampest.loads.recognition.watch import FIRST_S, Panelled, Watch
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.response import Response
from lampest.panel.scene import Scene

ASIDE = 2  # modules on a side of a window


def most_cells(layout: Modules) -> int:
    """Of a window."""
    return min(ASIDE, layout.rows) * min(ASIDE, layout.columns) * layout.each.rows * layout.each.columns


@dataclass(frozen=True, eq=False)
class WindowNetwork:
    """The solved networks of an image's modules: what recognition asks of one network."""

    layout: Modules
    networks: tuple[Any, ...]

    def reading(self) -> Array:
        """(rows, columns) of the image."""
        return np.asarray(self.layout.joined(np.stack([network.reading() for network in self.networks])))

    def sensitivity(self, cells: Any = None) -> Array:
        """J (readings, cells), of some cells if these are given by their numbers."""
        numbers = self.layout.split(np.arange(np.prod(self.layout.shape)).reshape(self.layout.shape))
        whole = np.zeros((numbers.size, numbers.size))
        for network, own in zip(self.networks, numbers.reshape(len(numbers), -1), strict=True):
            whole[np.ix_(own, own)] = network.sensitivity()
        return whole if cells is None else whole[:, cells]


@dataclass(frozen=True)
class ImageCircuit:
    """The circuits of an image's modules as one; scenes : of each."""

    layout: Modules
    scenes: tuple[Scene, ...]

    @property
    def unit(self) -> str:
        """ohm or volt."""
        return self.scenes[0].circuit.unit

    def uniform_start(self, measured: Array) -> Array:
        """As `Readout.uniform_start`, module by module."""
        return self._joined(lambda scene, part: scene.circuit.uniform_start(part), measured)

    def ties(self, cells: Array) -> Array:
        """Every module has its own."""
        return np.zeros(0)

    def network(self, cells: Array, ties: Array, wiring: None) -> WindowNetwork:
        """Of all modules."""
        parts = zip(self.scenes, self.layout.split(cells), strict=True)
        solved = (own.circuit.network(part, own.circuit.ties(part), own.wiring) for own, part in parts)
        return WindowNetwork(self.layout, tuple(solved))

    def _joined(self, part: Callable[[Scene, Array], Array], image: Array) -> Array:
        pairs = zip(self.scenes, self.layout.split(image), strict=True)
        return np.asarray(self.layout.joined(np.stack([part(*pair) for pair in pairs])))


@dataclass(frozen=True, eq=False)
class WindowScene:
    """Neighbouring modules as a scene of one circuit, as far as recognition asks; scenes : of each."""

    panel: Panel
    response: Response | None
    scenes: tuple[Scene, ...]
    wiring: None = None

    @property
    def circuit(self) -> Any:
        """Of all modules."""
        assert self.panel.modules is not None
        return ImageCircuit(self.panel.modules, self.scenes)

    @property
    def series_ohm(self) -> Array:
        """(rows, columns) ohm."""
        assert self.panel.modules is not None
        each = self.panel.modules.each
        parts = [np.broadcast_to(own.series_ohm, (each.rows, each.columns)) for own in self.scenes]
        return np.asarray(self.panel.modules.joined(np.stack(parts)))


@dataclass(frozen=True, eq=False)
class Window:
    """Where a window lies in the image. cells : of the image. x_mm, y_mm : of its first cell."""

    scene: WindowScene
    cells: tuple[slice, slice]
    x_mm: float
    y_mm: float

    @classmethod
    def all_of(cls, scene: Scene) -> "tuple[Window, ...]":
        """All windows of an image in which a module is read."""
        layout, (across, down) = scene.panel.modules, scene.panel.centres_mm()
        assert layout is not None
        high, wide = min(ASIDE, layout.rows), min(ASIDE, layout.columns)
        found = []
        for row, column in np.ndindex(layout.rows - high + 1, layout.columns - wide + 1):
            numbers = [(row + j) * layout.columns + column + k for j in range(high) for k in range(wide)]
            first, last = layout.cells(numbers[0]), layout.cells(numbers[-1])
            cells = slice(first[0].start, last[0].stop), slice(first[1].start, last[1].stop)
            if set(numbers) <= set(scene.dead_modules):
                continue
            own = WindowScene(
                Panel(modules=replace(layout, rows=high, columns=wide)),
                scene.response and scene.response.of_cells(cells),
                tuple(scene.of_modules[number] for number in numbers),
            )
            found.append(cls(own, cells, float(across[cells[1].start]), float(down[cells[0].start])))
        return tuple(found)

    @property
    def middle(self) -> Array:
        """x, y in the image, mm."""
        across, down = self.scene.panel.centres_mm()
        return np.array([self.x_mm + across.mean(), self.y_mm + down.mean()])

    def placed(self, load: Attachment) -> Attachment:
        """A load of the window by its place in the image."""
        (x, x_sd), (y, y_sd) = load.x_mm, load.y_mm
        return replace(load, x_mm=(x + self.x_mm, x_sd), y_mm=(y + self.y_mm, y_sd))


@dataclass(frozen=True, eq=False)
class WindowWatch(Watch):
    """As `Watch`; own : (discs) which lie no farther from this window's middle than from another's, by a pitch or so.

    What begins elsewhere is recognised in the window in whose middle it stands.
    """

    own: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def _recognised(self, time: float) -> Watch:
        change = self.mean - self.rest
        scores = self.test.scores(change)
        peaks = (scores >= self.test.sizes(change)) & (scores >= self.test.least())
        if not self.known and not (peaks & self.own).any():
            return replace(self, next_s=time + max(time - self.begun, FIRST_S))
        return super()._recognised(time)


@dataclass(frozen=True, eq=False)
class ImageWatch:
    """As `Watch`, of a panel of modules. watches : of the windows. began : s. attachments : those of all, each once."""

    windows: tuple[Window, ...]
    watches: tuple[Watch, ...]
    shape: tuple[int, int]
    began: float
    attachments: tuple[Attachment, ...] = ()

    @classmethod
    def begin(
        cls,
        scene: Scene,
        patch_mm: float,
        water: Array,
        errors: ModelErrors,
        measured: Array,
        sigma: Array,
        unloaded: Array,
        time: float,
    ) -> "ImageWatch":
        """As `Watch.begin`, with what `Panelled` holds."""
        windows, watches = Window.all_of(scene), list[Watch]()
        read, middles = np.isfinite(sigma), np.stack([window.middle for window in windows])
        for window in windows:
            own = window.cells
            panelled = Panelled(cast(Scene, window.scene), patch_mm, water[own], errors)
            if watches:
                panelled.__dict__["detector"] = watches[0].panelled.detector  # it knows the windows' panel alone
            rest = np.where(read[own], measured[own], np.median(measured[own][read[own]]))
            search = panelled.detector.search
            places = search.places[search.faint] + (window.x_mm, window.y_mm)
            far = np.linalg.norm(places - window.middle, axis=1) - scene.panel.pitch_mm
            nearest = np.linalg.norm(places[:, None] - middles, axis=2).min(axis=1)
            begun = WindowWatch.begin(panelled, rest, sigma[own], unloaded[(..., *own)], time)
            watches.append(replace(begun, own=far <= nearest))
        return cls(windows, tuple(watches), scene.panel.shape, time)

    def push(self, measured: Array, sigma: Array, time: float) -> "ImageWatch":
        """As `Watch.push`."""
        pairs = zip(self.windows, self.watches, strict=True)
        watches = tuple(watch.push(measured[own.cells], sigma[own.cells], time) for own, watch in pairs)
        here = replace(self, watches=watches)
        same = all(one.attachments is other.attachments for one, other in zip(watches, self.watches, strict=True))
        return here if same else replace(here, attachments=here._merged())

    @property
    def stands_out(self) -> float:
        """As `Watch.stands_out`, in the window where readings differ most."""
        return max(watch.stands_out for watch in self.watches)

    @cached_property
    def change(self) -> Array | None:
        """(rows, columns) ln r/r0 of what windows recognised last; 0 where nothing was; None: nowhere was anything."""
        known = [
            (own, watch) for own, watch in zip(self.windows, self.watches, strict=True) if watch.change is not None
        ]
        whole = np.zeros(self.shape)
        for window, watch in known:
            here, change = whole[window.cells], np.asarray(watch.change)
            whole[window.cells] = np.where(np.abs(change) > np.abs(here), change, here)
        return whole if known else None

    def _merged(self) -> tuple[Attachment, ...]:
        """Those of all windows: of two that are one, the one that stands nearer to its window's middle."""
        pairs = zip(self.windows, self.watches, strict=True)
        placed = [(own, own.placed(load)) for own, watch in pairs for load in watch.attachments]
        every = [(load.distance((own.middle[0], own.middle[1])), load) for own, load in placed]
        kept = [one for one in self.attachments if one.until_s is not None and one.until_s <= self.began]
        for _, load in sorted(every, key=lambda pair: pair[0]):
            if not any(_one(load, other) for other in kept):
                kept.append(load)
        return tuple(sorted(kept, key=lambda load: load.since_s))


def _one(load: Attachment, other: Attachment) -> bool:
    """Whether two windows saw one load: at one time, and nearer than the larger of them is wide."""
    together = load.since_s < (inf if other.until_s is None else other.until_s) and other.since_s < (
        inf if load.until_s is None else load.until_s
    )
    return together and load.distance(other.place) < max(load.size, other.size)
