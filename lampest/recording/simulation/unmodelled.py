"""What happens and the estimator is not told; and the random numbers, one stream for each effect."""

import dataclasses
import zlib
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True)
class Unmodelled:
    """Effects that enter the data but not the recording's scene. Zero: absent.

    Parameters
    ----------
    series_resistance_ohm : series resistance that the scene is silent about, on top of the one it names.
    channel_spread_ohm : standard deviation of the on-resistance of a multiplexer's channels, one for each line.
    reference_tolerance : the reference resistor is off by up to this fraction, drawn uniformly.
    drift_per_minute : standard deviation of the rate at which the logarithm of a cell's resistance drifts, per minute.
    outlier_probability : chance that one reading is a random code instead of a conversion.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    series_resistance_ohm: float = 0.0
    channel_spread_ohm: float = 0.0
    reference_tolerance: float = 0.0
    drift_per_minute: float = 0.0
    outlier_probability: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (isfinite(value) and value >= 0):
                raise ValueError(f"{field.name} must be zero or positive, and finite")
        if self.reference_tolerance >= 1:
            raise ValueError("reference_tolerance must be below 1")
        if self.outlier_probability > 1:
            raise ValueError("outlier_probability must not exceed 1")


def random_stream(seed: int, purpose: str) -> np.random.Generator:
    """The random numbers for one purpose: those of other purposes stay the same whether or not these are drawn."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()),)))
