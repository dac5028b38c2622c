"""What happens and the estimator is not told; and the random numbers, one stream for each effect."""

import dataclasses
import zlib
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True)
class Unmodelled:
    """Effects that enter the data but not the recording's scene. Zero or None: absent.

    Parameters
    ----------
    series_resistance_ohm : series resistance that the scene is silent about, on top of the one it names.
    channel_spread_ohm : standard deviation of the on-resistance of a multiplexer's channels, one for each line.
    reference_tolerance : the reference resistor is off by up to this fraction, drawn uniformly.
    drift_per_minute : standard deviation of the rate at which the logarithm of a cell's resistance drifts, per minute.
    outlier_probability : chance that one reading is a random code instead of a conversion.
    noise_factor : the noise of one reading is so many times what the scene says.
    supply_ripple_lsb, supply_ripple_hz : amplitude and frequency of a sine on what the converter sees, its phase drawn
        for every frame; a scan takes the whole frame period, channel by channel. Without a frequency one period is as
        long as the scan of a line.
    gain_spread : standard deviation of a frame's gain, drawn for every frame: all its voltages by one factor.
    load_speed_mm_s : loads travel along x by TRAVEL_MM to and fro at this speed, also while the lines are scanned one
        after the other; the truth is that of the middle of the scan.
    inl_lsb : the largest deviation of the converter's curve from a straight line, smooth, in least significant bits.
    wire_ohm_per_cell : resistance of rows and columns from cell to cell, on top of what the scene says, in ohm.
    reading_error : standard deviation of the logarithm of a factor on each recorded reading, the same in all frames.
    response_loss : a bent film answers by this fraction less, in the logarithm of its resistance.
    response_spread : standard deviation of the logarithm of a factor on each cell's answer, likewise in the logarithm.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    series_resistance_ohm: float = 0.0
    channel_spread_ohm: float = 0.0
    reference_tolerance: float = 0.0
    drift_per_minute: float = 0.0
    outlier_probability: float = 0.0
    noise_factor: float | None = None
    supply_ripple_lsb: float | None = None
    supply_ripple_hz: float | None = None
    gain_spread: float | None = None
    load_speed_mm_s: float | None = None
    inl_lsb: float | None = None
    wire_ohm_per_cell: float | None = None
    reading_error: float | None = None
    response_loss: float | None = None
    response_spread: float | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{field.name} must be zero or positive, and finite")
        if self.reference_tolerance >= 1:
            raise ValueError("reference_tolerance must be below 1")
        if self.outlier_probability > 1:
            raise ValueError("outlier_probability must not exceed 1")
        if self.response_loss is not None and self.response_loss >= 1:
            raise ValueError("response_loss must be below 1")

    @property
    def disturbs(self) -> bool:
        """Whether anything is added to what the converter sees."""
        return bool(self.supply_ripple_lsb or self.gain_spread or self.inl_lsb)

    @property
    def needs_converter(self) -> tuple[str, ...]:
        """Effects that are present and act on a converter."""
        names = ("reference_tolerance", "outlier_probability", "supply_ripple_lsb", "gain_spread", "inl_lsb")
        noisier = () if self.noise_factor is None else ("noise_factor",)
        return (*(name for name in names if getattr(self, name)), *noisier)


def random_stream(seed: int, purpose: str) -> np.random.Generator:
    """The random numbers for one purpose: those of other purposes stay the same whether or not these are drawn."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()),)))
