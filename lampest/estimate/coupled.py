"""A panel of modules as one problem, where its scene asks for terms that go over the seams."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.estimator import Estimator
from lampest.estimate.state import Step
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.panel.faults import Faults
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.blocks import ModulesReadout
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings


def coupled_scene(scene: Scene) -> Scene:
    """The image as one panel whose network falls into modules; neighbours over a seam are so much farther apart.

    Raises InputError where a module is wired, or has no two-point readout.
    """
    layout = scene.panel.modules
    assert layout is not None
    for number, own in enumerate(scene.of_modules):
        if not isinstance(own.circuit, TwoPointReadout) or own.wiring is not None:
            where = list(layout.place(number))
            raise InputError(f"panel.modules.coupled: module {where} is wired, or its readout is not two_point")
    places, (x, y) = None, scene.panel.places_mm
    if layout.seam_mm:
        places = tuple((j, k, float(x[j, k]), float(y[j, k])) for j, k in np.ndindex(scene.panel.shape))
    known = scene.open_cells, scene.shorted_cells & ~scene.open_cells  # a dead module is both
    broken = [tuple((int(j), int(k)) for j, k in np.argwhere(cells)) for cells in known]
    faults = Faults(open=broken[0], shorted=broken[1]) if any(broken) else None
    panel = Panel(*scene.panel.shape, scene.panel.pitch_mm, places)
    return Scene(panel, ModulesReadout(layout=layout), faults=faults)


def without_bars(estimator: Estimator) -> Estimator:
    """The estimator as coupled modules can have it. Raises InputError where it asks for error bars."""
    if estimator.error_bars is True or estimator.weighs_previous:
        raise InputError("error_bars: estimates with terms over the seams of modules (panel.modules.coupled) have none")
    return replace(estimator, error_bars=False)


@dataclass(frozen=True, eq=False)
class CoupledStream(Stream):
    """Of a coupled image. A module of which nothing was read is NaN, whatever terms say of it."""

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline is not solved, and of modules that were not read."""
        return np.where(self._unread(self.resting), np.nan, super().baseline_resistance)

    def push(self, readings: Readings) -> tuple[Stream, Step]:
        """As `Stream.push`."""
        stream, step = super().push(readings)
        unread = self._unread(readings)
        if not (unread.any() and step.solution.solved):
            return stream, step
        cells, reading = (
            np.where(unread, np.nan, part) for part in (step.solution.cell_resistance, step.solution.reading)
        )
        return stream, replace(step, solution=replace(step.solution, cell_resistance=cells, reading=reading))

    def _unread(self, readings: Readings) -> NDArray[np.bool_]:
        """(rows, columns) of modules without any value."""
        readout = self.scene.readout
        assert isinstance(readout, ModulesReadout)
        layout: Modules = readout.layout
        parts = layout.split(readings.plain)
        unread = np.logical_not(parts.any(axis=(-2, -1), keepdims=True))
        return np.asarray(layout.joined(np.broadcast_to(unread, parts.shape)))
