"""Characteristic of a converter: which voltage a code stands for.

Converters round: the data sheets of the ATmega ("ADC accuracy definitions") put the first
transition of an ideal converter half a step above zero, and the last one 1.5 steps below full
scale. Code c therefore stands for c steps, and its interval reaches half a step to both sides.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from lampest.files.typed import Configuration
from lampest.panel.panel import Array

MAX_VOLT = 1e3  # V: limit of low voltage in IEC 60038


@dataclass(frozen=True, kw_only=True)
class Characteristic(Configuration):
    """Voltages that the codes of a converter stand for.

    Code c stands for zero_volt + c·(full_volt − zero_volt)/2^bits, or for the voltage that a curve
    gives. Codes fall with the voltage where full_volt is below zero_volt, as behind an inverting
    amplifier.

    Attributes
    ----------
    zero_volt : float or {'estimated'}
        Voltage of code 0.
    full_volt : float, or None
        Voltage of code 2^bits; None: the end of the converter's range. No frame shows it, so that
        'estimated' is refused.
    curve : tuple of (float, float), or None
        Points (volt, code) of the curve, straight between them. None: a straight line.

    Raises ValueError if a voltage is out of range, if both ends are one, if full_volt is to be
    estimated, or if the points of a curve do not rise or fall throughout.

    >>> lampest.Characteristic(zero_volt=0.14, full_volt=3.12).zero_volt
    0.14
    """

    zero_volt: float | Literal["estimated"] = 0.0
    full_volt: float | Literal["estimated"] | None = None
    curve: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.full_volt, str):
            raise ValueError(
                "full_volt: no frame shows it, "
                "because cells of another size read alike; measure a known voltage"
            )
        volts = [self.zero_volt, self.full_volt, *(volt for volt, _ in self.curve or ())]
        for volt in volts:
            if isinstance(volt, float | int) and not abs(volt) <= MAX_VOLT:
                raise ValueError(f"converter voltages must lie within {MAX_VOLT:g} V of ground")
        if self.zero_volt == self.full_volt:
            raise ValueError("zero_volt and full_volt must differ: they are the ends of the range")
        if self.curve is None:
            return
        if self.zero_volt != 0 or self.full_volt is not None:
            raise ValueError("curve takes the place of zero_volt and full_volt: give either")
        if len(self.curve) < 2:
            raise ValueError("curve needs two or more points [volt, code]")
        volt, code = np.array(sorted(self.curve)).T
        if not (np.all(np.diff(volt) > 0) and (np.all(np.diff(code) > 0) or _falls(code))):
            raise ValueError("curve must rise or fall throughout: each voltage has one code")

    @cached_property
    def points(self) -> tuple[Array, Array]:
        """Points of the curve in the order of the codes.

        Returns
        -------
        volt, code : arrays, shape (points,)
        """
        assert self.curve is not None
        volt, code = np.array(sorted(self.curve, key=lambda point: point[1])).T
        return volt, code

    def description(self) -> str:
        """Return the range in words."""
        if self.curve is not None:
            volt, code = self.points
            return f"codes by a curve from {volt[0]:g} V ({code[0]:g}) to {volt[-1]:g} V"
        if self.zero_volt == "estimated":
            return "zero of the converter estimated"
        end = "" if self.full_volt is None else f" to {self.full_volt:.6g} V"
        return f"codes from {self.zero_volt:.6g} V{end}"


def _falls(code: Array) -> bool:
    return bool(np.all(np.diff(code) < 0))


Known = Literal["esp32", "avr", "inverting amplifier"]


def known(name: Known, full_scale_volt: float) -> Characteristic:
    """Return the characteristic of a converter with a name, for the end of its range in volt.

    esp32 : 12 bits at 11 dB, a straight line through readings that users of the Arduino core report
    (nothing below 0.14 V, the last code at 3.12 V; Espressif's data sheet specifies 0.15 to
    2.45 V). Chips differ by some 6 %: a measured `curve` is better. avr : data sheets of the
    ATmega, with the supply as reference; typically its zero is off by 2 steps. inverting
    amplifier : two equal resistors about half the range, V_out = 2 V_ref − V (Mancini, Op Amps for
    Everyone, Texas Instruments SLOD006B, 2002, chapter 4).
    """
    if name == "esp32":
        return Characteristic(zero_volt=0.14, full_volt=3.12)
    if name == "inverting amplifier":
        return Characteristic(zero_volt=full_scale_volt, full_volt=0.0)
    return Characteristic()
