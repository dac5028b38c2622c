"""Diode in series with a driven line."""

from dataclasses import dataclass
from functools import cached_property
from math import e
from typing import Any

import numpy as np

from lampest.files.typed import Configuration, check_ranges
from lampest.panel.panel import Array

# Five suffice for the value at any resistance, second derivatives need two more.
NEWTON_STEPS = 7


@dataclass(frozen=True)
class Diode(Configuration):
    """Diode by Shockley's law, V_d = s·ln(1 + I/I_s).

    I_s is such that V_d is drop_volt at at_ampere.

    Attributes
    ----------
    drop_volt : float
        Voltage drop in volt at the current at_ampere, as in a data sheet.
    at_ampere : float
        Current in ampere.
    slope_volt : float
        s = n·kT/q in volt, the increase of the drop for an e-fold current; 2.303 s for a decade.

    >>> lampest.Diode(drop_volt=0.6, at_ampere=1e-3, slope_volt=0.05).drop_volt
    0.6
    """

    drop_volt: float = 0.6
    at_ampere: float = 1e-3
    slope_volt: float = 0.05

    def __post_init__(self) -> None:
        # n·kT/q is 0.02 V in the cold with n = 1, and 0.2 V for an LED; a Schottky diode drops 0.1
        # V, an LED 4 V.
        check_ranges(self, 0.01, 10, "drop_volt")
        check_ranges(self, 1e-7, 10, "at_ampere")
        check_ranges(self, 0.015, 0.5, "slope_volt")

    def description(self) -> str:
        """Return the drop and its slope in words."""
        return (
            f"diode {self.drop_volt:g} V at {1e3 * self.at_ampere:g} mA, "
            f"{1e3 * np.log(10) * self.slope_volt:.3g} mV a decade"
        )

    @cached_property
    def _saturation(self) -> float:
        """Saturation current I_s in ampere."""
        return float(self.at_ampere / np.expm1(self.drop_volt / self.slope_volt))

    def drop(self, current: Array) -> Array:
        """Return the drop V_d in volt at a current in ampere, any shape."""
        return np.asarray(self.slope_volt * np.log1p(current / self._saturation))

    def resistor_volt(self, supply_volt: float, resistance: Any) -> Any:
        """Return the voltage I·R across a resistance in series with the diode.

        Vcc = I·R + V_d(I); NumPy and CasADi. With A = I_s R/s and w = A e^{V_d/s} the equation is w
        + ln w = Vcc/s + A + ln A, and I·R = s (w − A). Newton's method begins above the root. As
        the equation is concave, all further iterates are below it and increase.
        """
        # A = I_s R/s, right-hand side Vcc/s + A + ln A, and the start w = right + ln(1 + e^−right)
        part = resistance * (self._saturation / self.slope_volt)
        right = part + _logarithm(part) + supply_volt / self.slope_volt
        omega = right + _logarithm(1 + e**-right)
        # Newton: w ← w (1 + right − ln w)/(1 + w) for w + ln w = right
        for _ in range(NEWTON_STEPS):
            omega = omega * (1 + right - _logarithm(omega)) / (1 + omega)
        return self.slope_volt * (omega - part)


def _logarithm(value: Any) -> Any:
    """Return ln of an array or of a CasADi matrix."""
    return value.log() if hasattr(value, "log") else np.log(value)
