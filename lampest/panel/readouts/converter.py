"""Analogue-to-digital converter of a readout: codes, their noise, their range, their voltages.

Averages of codes retain a part of the quantisation error. The variance over repeated readings
therefore is not the noise alone.

Converters round: the data sheets of the ATmega ("ADC accuracy definitions") put the first
transition of an ideal converter half a step above zero, and the last one 1.5 steps below full
scale. Code c therefore stands for c steps, and its interval reaches half a step to both sides.

Converters with a name have numbers of their data sheets. Their codes are those of the chip, in as
many bits as it has: a library that prints the 12 bits of an ADS1015 in the upper part of 16 prints
multiples of 16.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from lampest.files.errors import counted
from lampest.files.typed import Configuration, read_only
from lampest.panel.lines import PerLine, along, lines_text
from lampest.panel.panel import Array

MAX_VOLT = 1e3  # V: limit of low voltage in IEC 60038
MIN_REPEATS = 50  # repeated readings, which determine a noise to a tenth
# readings, so many that the remaining part of σ is the one that averaging cannot remove
ENDLESS = 65535
# Of the quantisation error. The tail beyond is 1/(2π²·2000); it matters only without noise, where
# b² is 1/12.
HARMONICS = 2000
NOISE_ACCURACY = 1e-6  # LSB
USUAL_NOISE_LSB = 0.7  # that of the shipped boards
MIN_VOLT = 1e-3  # V: that of a thermocouple
Known = Literal[
    "esp32",
    "avr",
    "RP2040",
    "ADS1015",
    "ADS1115",
    "ADS1118",
    "MCP3008",
    "MCP3208",
    "inverting amplifier",
]


@dataclass(frozen=True, kw_only=True)
class KnownConverter:
    """Numbers of a converter with a name.

    Attributes
    ----------
    adc_bits : int, or None
        Resolution; None: as the scene says.
    zero_volt : float
        Voltage of code 0.
    full_volt : float, or None
        Voltage of code n (`Characteristic`), of several ranges that after power-up; None: the end
        of the range, a supply or a reference.
    ranges : tuple of float
        Voltages of code n between which the chip's register chooses; empty: any.
    signed : bool
        Whether codes run from below zero.
    falls : bool
        Whether codes fall from the end of the range to 0 V.
    noise_lsb : float, or None
        Standard deviation of one reading in LSB; None: not specified.
    """

    adc_bits: int | None = None
    zero_volt: float = 0.0
    full_volt: float | None = None
    ranges: tuple[float, ...] = ()
    signed: bool = False
    falls: bool = False
    noise_lsb: float | None = None


# V: SBAS444E, table "Full-Scale Range and Corresponding LSB Size"; taken for the ADS1015, ADS1118
ADS_RANGES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)

KNOWN_CONVERTERS: Mapping[Known, KnownConverter] = MappingProxyType(
    {
        # 11 dB, a straight line through readings that users of the Arduino core report: nothing
        # below 0.14 V, the last code at 3.12 V (Espressif's data sheet specifies 0.15 to 2.45 V).
        # Chips differ by some 6 %.
        "esp32": KnownConverter(zero_volt=0.14, full_volt=3.12),
        # Microchip, ATmega48A/328P data sheet, "ADC Conversion Result": the supply is the
        # reference; typically its zero is off by 2 steps.
        "avr": KnownConverter(),
        # Raspberry Pi, RP2040 data sheet, section 4.9: 12 bits of ADC_AVDD. It states no noise;
        # 0.97 LSB were measured (pico-adc.markomo.me, "Input-Referred Noise").
        "RP2040": KnownConverter(adc_bits=12, noise_lsb=0.97),
        # Ranges are those of the ADS1115, of 12 bits; its own data sheet (SBAS473) was not read.
        "ADS1015": KnownConverter(adc_bits=12, full_volt=2.048, ranges=ADS_RANGES, signed=True),
        # Texas Instruments, SBAS444E (ADS111x), table 6-1: 1 LSB rms at every range and rate. For
        # the ADS1118 by the copy of its table in a driver; its data sheet (SBAS457F) was not read.
        "ADS1115": KnownConverter(
            adc_bits=16, full_volt=2.048, ranges=ADS_RANGES, signed=True, noise_lsb=1.0
        ),
        "ADS1118": KnownConverter(
            adc_bits=16, full_volt=2.048, ranges=ADS_RANGES, signed=True, noise_lsb=1.0
        ),
        # Microchip, DS21295 (MCP3004/3008) and DS21298 (MCP3204/3208): V_REF is the end of the
        # range; no noise is stated.
        "MCP3008": KnownConverter(adc_bits=10),
        "MCP3208": KnownConverter(adc_bits=12),
        # Two equal resistors about half the range, V_out = 2 V_ref − V (Mancini, Op Amps for
        # Everyone, Texas Instruments SLOD006B, 2002, chapter 4).
        "inverting amplifier": KnownConverter(falls=True),
    }
)


@dataclass(frozen=True, kw_only=True)
class Characteristic(Configuration):
    """Voltages that the codes of a converter stand for.

    Code c stands for zero_volt + c·(full_volt − zero_volt)/n with n = 2^bits, or 2^(bits−1) of
    signed codes, or for the voltage that a curve gives. Codes fall with the voltage where full_volt
    is below zero_volt, as behind an inverting amplifier.

    Attributes
    ----------
    name : Known, or None
        Converter whose numbers hold (`KNOWN_CONVERTERS`); only `full_volt` may stand beside it, for
        another range of the chip. None: the numbers below.
    zero_volt : float or {'estimated'}
        Voltage of code 0.
    full_volt : float, or None
        Voltage of code n, one above the largest; None: the end of the converter's range. No frame
        shows it, so that 'estimated' is refused.
    curve : tuple of (float, float), or None
        Points (volt, code) of the curve, straight between them. None: a straight line.
    signed : bool
        Whether codes run from −2^(bits−1) to 2^(bits−1) − 1, as those of differential converters.

    Raises ValueError if a voltage is out of range, if both ends are one, if full_volt is to be
    estimated or no range of the named chip, if other numbers stand beside a name, or if the points
    of a curve do not rise or fall throughout.

    >>> lampest.Characteristic(zero_volt=0.14, full_volt=3.12).zero_volt
    0.14
    """

    name: Known | None = None
    zero_volt: float | Literal["estimated"] = 0.0
    full_volt: float | Literal["estimated"] | None = None
    curve: tuple[tuple[float, float], ...] | None = None
    signed: bool = False

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
        if self.name is not None:
            if self.zero_volt != 0 or self.curve is not None or self.signed:
                raise ValueError(
                    f"{self.name} states zero_volt, curve and signed: "
                    "only full_volt may stand beside"
                )
            ranges = self.numbers.ranges
            if ranges and self.full_volt not in (None, *ranges):
                listed = ", ".join(f"{volt:g}" for volt in ranges)
                raise ValueError(
                    f"full_volt: {self.name} has the ranges {listed} V, not {self.full_volt:g} V"
                )
        if self.curve is None:
            return
        if self.zero_volt != 0 or self.full_volt is not None:
            raise ValueError("curve takes the place of zero_volt and full_volt: give either")
        if len(self.curve) < 2:
            raise ValueError("curve needs two or more points [volt, code]")
        volt, code = np.diff(sorted(self.curve), axis=0).T
        if not (np.all(volt > 0) and (np.all(code > 0) or np.all(code < 0))):
            raise ValueError("curve must rise or fall throughout: each voltage has one code")

    @property
    def numbers(self) -> KnownConverter:
        """Numbers of the named converter; those of none without a name."""
        return KNOWN_CONVERTERS[self.name or "avr"]

    def within(self, full_scale_volt: float) -> "Characteristic":
        """Return the characteristic without a name, for the end of its range in volt."""
        if self.name is None:
            return self
        numbers = self.numbers
        full = numbers.full_volt if self.full_volt is None else self.full_volt
        if numbers.falls:
            end = full_scale_volt if full is None else full
            return Characteristic(zero_volt=end, full_volt=0.0)
        return Characteristic(zero_volt=numbers.zero_volt, full_volt=full, signed=numbers.signed)

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
        if self.name is not None:
            full = self.full_volt
            if full is None and self.numbers.ranges:
                full = self.numbers.full_volt
            return f"converter {self.name}" + ("" if full is None else f" to {full:g} V")
        if self.curve is not None:
            volt, code = self.points
            return f"codes by a curve from {volt[0]:g} V ({code[0]:g}) to {volt[-1]:g} V"
        if self.zero_volt == "estimated":
            return "zero of the converter estimated"
        end = "" if self.full_volt is None else f" to {self.full_volt:.6g} V"
        start = "signed codes, 0 at" if self.signed else "codes from"
        return f"{start} {self.zero_volt:.6g} V{end}"


def stated_characteristic(readout: Any) -> Characteristic:
    """Return the voltages that the codes stand for, as the scene states them."""
    named = readout.converter
    return named if isinstance(named, Characteristic) else Characteristic(name=named)


def converter_in_words(readout: Any) -> str:
    """Return the bits, readings, noise, floor and range of a readout's converter in words."""
    noise = (
        lines_text(readout.assumed_noise, "LSB")
        if states_noise(readout)
        else "as the unloaded frames show it"
    )
    floor = f", codes above {readout.floor_code}" if readout.floor_code else ""
    stated = stated_characteristic(readout)
    ends = "" if readout.converter is None else f", {stated.description()}"
    readings = counted(readout.readings, "reading")
    return f"{readout.adc_bits} bits, {readings}, noise {noise}{floor}{ends}"


def range_assumed(readout: Any) -> bool:
    """Return whether the range is one of several of a named chip, that after power-up."""
    stated = stated_characteristic(readout)
    return bool(stated.numbers.ranges) and stated.full_volt is None


def relative_step(readout: Any, volt: Array) -> Array:
    """Return the converter's step at voltages, in units of `lsb_volt`; any shape."""
    if readout.characteristic.curve is None:
        return np.ones(np.shape(volt))
    points, codes = readout.characteristic.points
    steps = np.abs(np.diff(points)) / np.diff(codes) / readout.lsb_volt
    piece = np.searchsorted(codes, readout.steps_from_volt(volt), side="right") - 1
    return np.asarray(steps[np.clip(piece, 0, len(steps) - 1)])


def states_noise(readout: Any) -> bool:
    """Return whether the scene states the noise as a number, or one for each line."""
    return bool(readout.noise_lsb == readout.assumed_noise)


def noise_volt(readout: Any, codes: Array | None = None) -> Array:
    """Return the noise of one reading in volt, or that of `codes` in LSB.

    The result can be broadcast to (rows, columns).
    """
    codes = np.array(readout.assumed_noise) if codes is None else codes
    return np.asarray(
        (along(readout.noisy_side, codes) if codes.ndim else codes) * readout.lsb_volt
    )


def mean_sigma(readout: Any) -> Array:
    """Return σ of the mean of `readings` codes in volt, to be broadcast to (rows, columns)."""
    return noise_volt(readout, sigma_code(readout))


def sigma_code(
    readout: Any, noise_lsb: PerLine | None = None, readings: int | None = None
) -> Array:
    """Return σ of the mean of `readings` codes, in LSB.

    σ² = (noise² + 1/12 − b²)/readings + b², with the variance b² of `_rounding_variance`. None:
    the converter's own noise, or number of readings.
    """
    noise_lsb = readout.assumed_noise if noise_lsb is None else noise_lsb
    noise = np.array(noise_lsb)
    bias = _rounding_variance(noise_lsb)
    return np.sqrt((noise**2 + 1 / 12 - bias) / (readings or readout.readings) + bias)


def constant_share(readout: Any, noise_lsb: PerLine | None = None) -> Array:
    """Return the share of σ that averaging cannot remove, to be broadcast to (rows, columns).

    None: that of the converter's own noise.
    """
    noise = readout.assumed_noise if noise_lsb is None else noise_lsb
    share = np.sqrt(_rounding_variance(noise)) / sigma_code(readout, noise)
    return along(readout.noisy_side, share) if share.ndim else share


def rails_reached(readout: Any, recorded: Array) -> str:
    """Return the rails that recorded readings exceed, in words; '' if no reading does."""
    least, largest = readout.rails()
    beyond = ((least, recorded < least), (largest, recorded > largest))
    reached = [f"{rail:.3g}" for rail, readings in beyond if np.any(readings)]
    if not reached:
        return ""
    rails = "rails" if len(reached) > 1 else "rail"
    return f"the converter's {rails} of {' and '.join(reached)} {readout.unit}"


@lru_cache(maxsize=64)
def _rounding_variance(noise_lsb: PerLine) -> Array:
    """Return the part b² of the quantisation error that averaging cannot remove, LSB².

    b² = Σ_h exp(−4π²h²·noise²)/(2π²h²), because without noise all readings agree. Without noise
    b² is 1/12; above half an LSB of noise it is negligible. Source: Widrow & Kollár,
    Quantization Noise, 2008 (dither).

    Parameters
    ----------
    noise_lsb : PerLine
        Standard deviation of one reading before quantisation.
    """
    noise = np.array(noise_lsb)
    # Terms of b², one for each harmonic h of the quantisation error: noise (…, 1), harmonic
    # (HARMONICS,)
    harmonic = np.arange(1, HARMONICS + 1, dtype=float)
    damped = np.exp(-((2 * np.pi * harmonic * noise[..., None]) ** 2))
    damped = damped / (2 * np.pi**2 * harmonic**2)
    bias = np.where(noise == 0, 1 / 12, np.minimum(np.sum(damped, axis=-1), 1 / 12))
    variance: Array = read_only(bias)
    return variance


def averaged_variance(readout: Any, noise_lsb: PerLine) -> Array:
    """Return the variance that averaging removes, σ²(readings) − σ²(ENDLESS readings), LSB²."""
    lasting = sigma_code(readout, noise_lsb, ENDLESS)
    return sigma_code(readout, noise_lsb) ** 2 - lasting**2


def noise_of_variance(readout: Any, variance: float) -> float:
    """Return the noise in LSB that has a given `averaged_variance` in LSB².

    Bisection finds the noise.
    """
    low = 0.0
    high = 2.0**readout.adc_bits
    while high - low > NOISE_ACCURACY:
        middle = (low + high) / 2
        if float(averaged_variance(readout, middle)) < variance:
            low = middle
        else:
            high = middle
    return low
