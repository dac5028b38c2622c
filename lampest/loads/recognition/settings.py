"""What recognition assumes: errors beside the noise of the readings, and what a user may set beside the results."""

from dataclasses import dataclass, field, replace
from math import hypot, isfinite, log10
from typing import Any, ClassVar

import numpy as np

from lampest.loads.response import RESPONSE_SD
from lampest.panel.film import OPEN_CREEP
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene, Systematic, Water

LEAST, MOST = 1e-9, 1e6  # of patch_mm, mm, and noise_percent
PATCH_SHARE = 0.6  # edge of a cell's film over the pitch, as on the panel of the paper: 6 mm at 10 mm


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations of what is not measured. Every one of them widens error bars and tempers verdicts.

    Parameters
    ----------
    response : of ln(r/r0) at a pressure, as a fraction of ln f(p): cells answer differently. Recognition estimates it
        between 0.5 and 2.5 times this.
    bent : of the same, alike in all cells: bent film answers less, by half where it is bent sharply.
    cell_spread : of the logarithm of the unloaded cells about their mean; only a prior where data are too noisy.
    drift : of the logarithm of a cell's resistance at rest, for each decade of time, of a panel that had been on
        for a minute. common_drift : of the same, alike in all cells: temperature. Films settle logarithmically, so
        hours add little.
    settled : of the logarithm of a cell's resistance at rest, apart from drift.
    creep, creep_sd : the film's creep per decade, see `lampest.panel.film`, and its standard deviation. Wider than a
        scene that leaves it open, because false alarms cost more than weak loads that come back to a place just left.
    remanence_sd : of the part of its largest recent answer that a film keeps for minutes; see `Remembered`.
    channel_ohm : of the on-resistance of a multiplexer's channel about its mean, one for each line.
    reference : relative error of the reference resistor: 1 % at most, uniform.
    reading_error : of the logarithm of a factor on each reading, the same in all frames.

    Source of the others: CD74HC4067 (about 10 ohm between any two channels), ordinary 1 % resistors, films that
    creep by a few percent for each decade of time. Raises ValueError where one is negative or not finite.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    response: float = RESPONSE_SD
    bent: float = 0.15
    cell_spread: float = 0.4
    drift: float = 0.01
    common_drift: float = 0.02
    settled: float = 0.002
    creep: float = OPEN_CREEP[0]
    creep_sd: float = 0.05
    remanence_sd: float = 0.12
    channel_ohm: float = 3.0
    reference: float = 0.006
    reading_error: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or positive, and finite")

    def told_by(self, scene: Scene, reading_error: float) -> "ModelErrors":
        """With what a scene specifies of errors and of the film; what it leaves open is assumed.

        reading_error : of the logarithm of each reading, the same in all frames, as estimated from the frames.
        """
        errors = replace(self, reading_error=reading_error)
        if scene.film is not None:
            creep = scene.film.told_creep
            errors = replace(errors, creep=creep.mean, creep_sd=creep.sd)
        if scene.systematic is None:
            return errors
        named = scene.told_systematic or Systematic()
        reference = named.reference_tolerance / np.sqrt(3)  # of a uniform distribution of that half width
        return replace(errors, channel_ohm=named.channel_spread_ohm, reference=reference)

    def resting_sd(self, seconds: float) -> float:
        """Standard deviation of ln r of a cell at rest by itself, `seconds` after the baseline."""
        return hypot(self.drift * log10(1 + seconds / 60), self.settled)

    def resting_covariance(self, seconds: float, cells: int) -> Array:
        """(cells, cells) of ln r of all cells at rest: their own, and what they share."""
        own, common = self.resting_sd(seconds), self.common_drift * log10(1 + seconds / 60)
        return own**2 * np.eye(cells) + common**2

    def offsets(self, measured: Array, scene: Scene) -> Array:
        """E·sd (cells, offsets): what one standard deviation of every offset adds to the readings, in their unit.

        Offsets are those of rows and columns (of two-point resistances), of the reference, and where there are such
        errors, of each reading. measured : (rows, columns) readings, without what stands in series.
        """
        rows, columns = measured.shape
        total = measured + scene.series_ohm if scene.circuit.unit == "ohm" else measured
        by_row = np.kron(np.eye(rows), np.ones((columns, 1)))
        by_column = np.kron(np.ones((rows, 1)), np.eye(columns))
        channels = [self.channel_ohm * np.hstack([by_row, by_column])] if scene.circuit.unit == "ohm" else []
        own = [np.diag(self.reading_error * total.ravel())] if self.reading_error else []
        return np.hstack([*channels, self.reference * total.reshape(-1, 1), *own])


@dataclass(frozen=True)
class RecognitionSettings:
    """Assumptions about the panel and the errors.

    Parameters
    ----------
    patch_mm : edge of a cell's film in mm; None: 6/10 of the pitch.
    top_row_depth_mm : depth of row 0 below the water's surface in mm, row by row deeper; None: as the results have it.
    noise_percent : standard deviation of every reading in percent, where the results do not hold it; None: refuse.
    model_errors : the errors beside the readings' noise.
    zero_after : frames in a row without a load from which the unloaded panel is taken anew; 0: never.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    patch_mm: float | None = None
    top_row_depth_mm: float | None = None
    noise_percent: float | None = None
    model_errors: ModelErrors = field(default_factory=ModelErrors)
    zero_after: int = 20

    def __post_init__(self) -> None:
        if self.zero_after != 0 and self.zero_after < 5:
            raise ValueError("zero_after must be 0, or at least 5 frames")
        for name in ("patch_mm", "noise_percent"):
            value = getattr(self, name)
            if value is not None and not LEAST <= value <= MOST:
                raise ValueError(f"{name} must be positive and finite, between {LEAST:g} and {MOST:g}")
        if self.top_row_depth_mm is not None:
            Water(self.top_row_depth_mm)

    def patch_of(self, panel: Panel) -> float:
        """Edge of the film in mm. Never more than the pitch."""
        return min(self.patch_mm or PATCH_SHARE * panel.pitch_mm, panel.pitch_mm)
