"""Assumptions of recognition on errors beside the noise of the readings, and on the film."""

from dataclasses import dataclass, replace
from math import hypot, log10

import numpy as np

from lampest.panel.panel import Array, Panel
from lampest.panel.response import RESPONSE_SD
from lampest.panel.scene import Scene, Systematic

PATCH_SHARE = 0.6  # edge of a cell's film over the pitch, as on the panel of the paper: 6 mm at 10 mm


def patch_of(panel: Panel, patch_mm: float | None = None) -> float:
    """Edge of the film in mm, 6/10 of the pitch where nobody says; never more than the pitch."""
    return min(PATCH_SHARE * panel.pitch_mm if patch_mm is None else patch_mm, panel.pitch_mm)


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations of quantities that are not measured.

    Parameters
    ----------
    response : of ln(r/r0) at a pressure, as a fraction of ln f(p): cells answer differently.
    common, near : parts of that variance that all cells share, and neighbours within `near_pitches`.
    bent : of the same, alike in all cells: bent film answers less, by half where it is bent sharply.
    edge_mm : of the place of a patch's edge, at a relative deviation of 1: patches are glued by hand, rims are soft.
    patch : of the patches' edge, relative, alike in all cells: a round one is as a square one of 0.89 its width.
    cell_spread : of the logarithm of the unloaded cells about their mean; only a prior where data are too noisy.
    drift, common_drift : of ln r at rest for each decade of minutes, of each cell and of all alike (temperature).
    settled : of ln r at rest, apart from drift.
    channel_ohm : of the on-resistance of a multiplexer's channel about its mean, one for each line.
    reference : relative error of the reference resistor: 1 % at most, uniform.
    reading_error : of the logarithm of a factor on each reading, the same in all frames.

    Source: CD74HC4067 (about 10 ohm between any two channels), ordinary 1 % resistors, films that creep by a few
    percent for each decade of time; the others are assumptions.
    """

    response: float = RESPONSE_SD
    common: float = 0.2
    near: float = 0.2
    near_pitches: float = 1.5
    bent: float = 0.15
    edge_mm: float = 3.0
    patch: float = 0.13
    cell_spread: float = 0.4
    drift: float = 0.01
    common_drift: float = 0.02
    settled: float = 0.002
    channel_ohm: float = 3.0
    reference: float = 0.006
    reading_error: float = 0.0

    def of_scene(self, scene: Scene, reading_error: float) -> "ModelErrors":
        """With the errors that a scene specifies, and with one of each reading as estimated from the frames."""
        errors = replace(self, reading_error=reading_error)
        if scene.systematic is None:
            return errors
        named = scene.specified_systematic or Systematic()
        reference = named.reference_tolerance / np.sqrt(3)  # of a uniform distribution of that half width
        return replace(errors, channel_ohm=named.channel_spread_ohm, reference=reference)

    def resting_sd(self, seconds: float) -> float:
        """Return standard deviation of ln r of a cell at rest by itself, `seconds` after the baseline."""
        return hypot(self.drift * log10(1 + seconds / 60), self.settled)

    def resting_covariance(self, seconds: float, cells: int) -> Array:
        """Return the covariance of ln r of all cells at rest, (cells, cells): their own part and the common one."""
        common = self.common_drift * log10(1 + seconds / 60)
        return self.resting_sd(seconds) ** 2 * np.eye(cells) + common**2

    def offsets(self, measured: Array, scene: Scene) -> Array:
        """Return E·sd (cells, offsets).

        The effect of one standard deviation of every offset on the readings, in their unit.

        Offsets are those of rows and columns of every module (of two-point resistances), of the reference, and where
        there are such errors, of each reading. measured : (rows, columns), without the resistance in series.
        """
        layout, (rows, columns) = scene.panel.modules, measured.shape
        row, column = np.indices(measured.shape)
        if layout is not None:
            row, column = row + rows * (column // layout.each.columns), column + columns * (row // layout.each.rows)
        in_ohm = scene.circuit.unit == "ohm"
        total = (measured + scene.series_ohm if in_ohm else measured).reshape(-1, 1)
        lines = [line.reshape(-1, 1) == np.unique(line) for line in (row, column)] if in_ohm else []
        own = [np.diag(self.reading_error * total[:, 0])] if self.reading_error else []
        return np.hstack([*(self.channel_ohm * line for line in lines), self.reference * total, *own])
