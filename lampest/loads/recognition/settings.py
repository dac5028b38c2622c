"""What recognition assumes: errors beside the noise of the readings, and what a user may set."""

from dataclasses import dataclass, replace
from math import hypot, log10

import numpy as np

from lampest.loads.response import RESPONSE_SD
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene, Systematic, Water

PATCH_SHARE = 0.6  # edge of a cell's film over the pitch, as on the panel of the paper: 6 mm at 10 mm


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations of what is not measured: they widen error bars and temper verdicts.

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
        """With what a scene specifies of errors; what it leaves open is assumed.

        reading_error : of the logarithm of each reading, the same in all frames, as estimated from the frames.
        """
        errors = replace(self, reading_error=reading_error)
        if scene.systematic is None:
            return errors
        named = scene.specified_systematic or Systematic()
        reference = named.reference_tolerance / np.sqrt(3)  # of a uniform distribution of that half width
        return replace(errors, channel_ohm=named.channel_spread_ohm, reference=reference)

    def resting_sd(self, seconds: float) -> float:
        """Standard deviation of ln r of a cell at rest by itself, `seconds` after the baseline."""
        return hypot(self.drift * log10(1 + seconds / 60), self.settled)

    def resting_covariance(self, seconds: float, cells: int) -> Array:
        """(cells, cells) of ln r of all cells at rest: their own, and what they share."""
        common = self.common_drift * log10(1 + seconds / 60)
        return self.resting_sd(seconds) ** 2 * np.eye(cells) + common**2

    def offsets(self, measured: Array, scene: Scene) -> Array:
        """E·sd (cells, offsets): what one standard deviation of every offset adds to the readings, in their unit.

        Offsets are those of rows and columns (of two-point resistances), of the reference, and where there are such
        errors, of each reading. measured : (rows, columns) readings, without what stands in series.
        """
        layout = scene.panel.modules
        rows, columns = measured.shape if layout is None else (layout.each.rows, layout.each.columns)
        total = measured + scene.series_ohm if scene.circuit.unit == "ohm" else measured
        by_row = np.kron(np.eye(rows), np.ones((columns, 1)))
        by_column = np.kron(np.ones((rows, 1)), np.eye(columns))
        by_line = np.hstack([by_row, by_column])
        if layout is not None:  # every module has lines of its own
            blocks = np.kron(np.eye(layout.count), by_line).reshape(layout.count, rows, columns, -1)
            by_line = layout.joined(np.moveaxis(blocks, -1, 0)).reshape(blocks.shape[-1], -1).T
        channels = [self.channel_ohm * by_line] if scene.circuit.unit == "ohm" else []
        own = [np.diag(self.reading_error * total.ravel())] if self.reading_error else []
        return np.hstack([*channels, self.reference * total.reshape(-1, 1), *own])


@dataclass(frozen=True)
class RecognitionSettings:
    """What a user may set beside a recording.

    Parameters
    ----------
    patch_mm : edge of a cell's film in mm; None: 6/10 of the pitch.
    top_row_depth_mm : depth of row 0 below the water's surface in mm, row by row deeper; None: as the results have it.
    noise_percent : standard deviation of every reading in percent, where the results do not hold it; None: refuse.

    Raises ValueError where a number is out of range.
    """

    patch_mm: float | None = None
    top_row_depth_mm: float | None = None
    noise_percent: float | None = None

    def __post_init__(self) -> None:
        for name in ("patch_mm", "noise_percent"):
            value = getattr(self, name)
            if value is not None and not 1e-9 <= value <= 1e6:
                raise ValueError(f"{name} must be positive and finite, between 1e-09 and 1e+06")
        if self.top_row_depth_mm is not None:
            Water(self.top_row_depth_mm)

    def patch_of(self, panel: Panel) -> float:
        """Edge of the film in mm. Never more than the pitch."""
        return min(self.patch_mm or PATCH_SHARE * panel.pitch_mm, panel.pitch_mm)
