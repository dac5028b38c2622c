"""What recognition compares frames with: a scene, and standard deviations of what is not measured.

The scene is that of a panel, or of a window of its modules. Films, circuits and drift are not
measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, log10

import numpy as np

from lampest.inference.assumptions import CREEP_AT_ONCE, CREEP_PER_DECADE
from lampest.panel.effects import CHANNELS, REFERENCE, systematic_of, usual_size
from lampest.panel.joined_network import JoinedNetwork
from lampest.panel.network import Network
from lampest.panel.panel import Array, Mask, Panel
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.response import RESPONSE_SD, Response
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic


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


RecognitionScene = Scene | WindowScene


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations of quantities that are not measured.

    Parameters
    ----------
    response : of ln(r/r0) at a pressure, as a fraction of ln f(p), because cells respond
        differently.
    common, near : parts of that variance that all cells share, and that neighbours within
        `near_pitches` share.
    bent : of the same, equal in all cells, because bent film responds less, by half where it is
        bent sharply.
    edge_mm : of the place of a patch's edge, at a relative deviation of 1: patches are glued by
        hand, rims are soft.
    patch : of the patches' edge, relative, equal in all cells: a round patch is like a square one
        of 0.89 its width.
    cell_spread : of the logarithm of the unloaded cells about their mean; only a prior where data
        are too noisy.
    drift, common_drift : of ln r at rest for each decade of minutes, of each cell and of all alike
        (temperature).
    settled : of ln r at rest, apart from drift. `lampest.inference` has both in one number, because
        it knows no time since the unloaded frames.
    channel_ohm : of the on-resistance of a multiplexer's channel about its mean, one for each line.
    reference : relative error of the reference resistor: 1 % at most, uniform.
    reading_error : of the logarithm of a factor on each reading, the same in all frames.
    swaying : of changes of ln r and of ln y that all cells and all readings share: temperature,
        waves, supply.
    residue : of the residue in the film after a load, relative to the load's ln r/r0.

    Source: CD74HC4067 (about 10 ohm between any two channels), ordinary 1 % resistors, films that
    creep by a few percent for each decade of time; the others are assumptions.
    """

    response: float = RESPONSE_SD
    common: float = 0.2
    near: float = 0.2
    near_pitches: float = 1.5
    bent: float = 0.15
    edge_mm: float = 3.0
    patch: float = 0.13
    cell_spread: float = 0.4
    drift: float = CREEP_PER_DECADE
    common_drift: float = 0.02
    settled: float = CREEP_AT_ONCE
    channel_ohm: float = usual_size(CHANNELS)
    reference: float = 0.006  # that of a resistor of 1 %: 0.01/√3, rounded
    reading_error: float = 0.0
    swaying: float = 0.1
    residue: float = 0.12

    def of_scene(self, scene: Scene, reading_error: float) -> "ModelErrors":
        """Return the errors that a scene specifies, with each reading's own error.

        The own error is as estimated from the frames.
        """
        errors = replace(self, reading_error=reading_error)
        if scene.systematic is None:
            return errors
        sizes = systematic_of(scene) or Systematic()
        # Of a uniform distribution of that half width. E δ is of first order: a larger error, such
        # as that of a pin's pull-ups, scales all cells and hardly their changes, but E δ would
        # explain a light contact by it.
        tolerance = min(sizes.size(REFERENCE), usual_size(REFERENCE))
        reference = tolerance / np.sqrt(3)
        return replace(errors, channel_ohm=sizes.size(CHANNELS), reference=reference)

    def in_motion(self, motion: Array) -> "ModelErrors":
        """Return the errors in water that moves cells by fractions `motion`, (n,).

        Each cell has a part of its own, because cells respond differently.
        """
        own = self.response * np.hypot.reduce(motion, initial=0.0)
        return replace(self, settled=hypot(self.settled, own))

    def resting_sd(self, seconds: float) -> float:
        """Return the standard deviation of each cell's drift, seconds after the baseline."""
        return hypot(self.drift * log10(1 + seconds / 60), self.settled)

    def offsets(self, measured: Array, scene: RecognitionScene) -> Array:
        """Return the effect of every offset on the readings, E·sd (cells, offsets).

        Each column is the effect of one standard deviation of an offset. Offsets are those of the
        channels of rows and columns of every module and of the reference (for two-point
        resistances), and of each reading if `reading_error` is nonzero. Voltages depend on the
        cells over the reference, so that an error of the reference is one of ln r0, common to all
        cells and frames.

        Parameters
        ----------
        measured : array, shape (rows, columns)
            Readings without the resistance in series, in the readout's unit, as predicted.
        scene : RecognitionScene
        """
        in_ohm = scene.circuit.unit == "ohm"
        total = (measured + scene.series_ohm if in_ohm else measured).reshape(-1, 1)
        effects = list[Array]()
        if in_ohm:
            # Modules have channels of their own.
            each = scene.panel.layout.each
            rows, columns = measured.shape
            row, column = np.indices(measured.shape).reshape(2, -1, 1)
            of_rows = row + rows * (column // each.columns)
            of_columns = column + columns * (row // each.rows)
            channels = np.hstack([each == np.unique(each) for each in (of_rows, of_columns)])
            effects += [self.channel_ohm * channels, self.reference * total]
        if self.reading_error:
            effects.append(np.diag(self.reading_error * total[:, 0]))
        return np.hstack([np.zeros((total.size, 0)), *effects])

    def gain(self, shifts: Array, scene: RecognitionScene) -> Array:
        """Return the derivative of f + E δ by f, (cells,): E depends linearly on the readings f.

        Parameters
        ----------
        shifts : array, shape (offsets,)
            δ.
        scene : RecognitionScene
        """
        shape = scene.panel.shape
        none, one = (self.offsets(end, scene) for end in (np.zeros(shape), np.ones(shape)))
        return 1 + (one - none) @ shifts
