"""A diode in the way of the driving current: its forward drop, and what it leaves to a resistance behind it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from lampest.panel.panel import Array

# Of what diodes do: n·kT/q is 0.02 V in the cold with n = 1, and an LED's 0.2 V; a Schottky drops 0.1 V, an LED 4 V.
SLOPES, DROPS, CURRENTS = (0.015, 0.5), (0.01, 10.0), (1e-7, 10.0)
STEPS = 7  # of Newton's method: five suffice for the value at any resistance, and its second derivatives need two more


@dataclass(frozen=True)
class Diode:
    """V_d = s·ln(1 + I/I_s), I_s such that V_d is drop_volt at at_ampere; Shockley's law.

    Parameters
    ----------
    drop_volt : at the current at_ampere, as a data sheet says. slope_volt : s = n·kT/q, what an e-fold of current adds
        to the drop; 2.303 s is a decade's.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    drop_volt: float = 0.6
    at_ampere: float = 1e-3
    slope_volt: float = 0.05

    def __post_init__(self) -> None:
        for name, (least, most) in (("drop_volt", DROPS), ("at_ampere", CURRENTS), ("slope_volt", SLOPES)):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name} must lie between {least:g} and {most:g}")

    def description(self) -> str:
        """The drop and its slope."""
        decade = 1e3 * np.log(10) * self.slope_volt
        return f"diode {self.drop_volt:g} V at {1e3 * self.at_ampere:g} mA, {decade:.3g} mV a decade"

    @cached_property
    def _saturation(self) -> float:
        """I_s ampere."""
        return float(self.at_ampere / np.expm1(self.drop_volt / self.slope_volt))

    def drop(self, current: Array) -> Array:
        """V_d at a current, ampere → volt."""
        return np.asarray(self.slope_volt * np.log1p(current / self._saturation))

    def left(self, supply_volt: float, resistance: Any) -> Any:
        """I·R with Vcc = I·R + V_d(I): what the diode leaves to a resistance, volt; arrays and CasADi alike.

        With A = I_s R/s and w = A e^{V_d/s} the equation is w + ln w = Vcc/s + A + ln A, and I·R = s (w − A). Newton's
        method begins right of the root, and the equation's concavity keeps all further steps left of it, growing.
        """
        part = resistance * (self._saturation / self.slope_volt)
        right = part + _logarithm(part) + supply_volt / self.slope_volt
        omega = right + _logarithm(1 + _exponential(-right))
        for _ in range(STEPS):
            omega = omega * (1 + right - _logarithm(omega)) / (1 + omega)
        return self.slope_volt * (omega - part)


def _logarithm(value: Any) -> Any:
    """ln of an array, or of CasADi's matrices by their own method."""
    return value.log() if hasattr(value, "log") else np.log(value)


def _exponential(value: Any) -> Any:
    return value.exp() if hasattr(value, "exp") else np.exp(value)
