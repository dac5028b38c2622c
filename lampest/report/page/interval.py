"""A figure that knows how sure it is."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Interval:
    """A figure and the ends of its 95 % bootstrap interval (percentiles)."""

    value: float
    lower: float
    upper: float

    @property
    def holds_zero(self) -> bool:
        return self.lower <= 0 <= self.upper
