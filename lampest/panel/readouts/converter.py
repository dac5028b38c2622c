"""Analogue-to-digital converter of a readout: codes, their noise, their range, their voltages.

Averages of codes retain a part of the quantisation error. The variance over repeated readings
therefore is not the noise alone.

Converters round: the data sheets of the ATmega ("ADC accuracy definitions") put the first
transition of an ideal converter half a step above zero, and the last one 1.5 steps below full
scale. Code c therefore stands for c steps, and its interval reaches half a step to both sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import counted
from lampest.files.levels import NOISE_REACH
from lampest.files.typed import Completed, Configuration, check_range, check_ranges
from lampest.panel.lines import PerLine, Side, along, as_tuple, check_lines, lines_text
from lampest.panel.panel import Array
from lampest.panel.readouts.known_converters import KNOWN_CONVERTERS, Known, KnownConverter

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
        self._check_name()
        if self.curve is None:
            return
        if self.zero_volt != 0 or self.full_volt is not None:
            raise ValueError("curve takes the place of zero_volt and full_volt: give either")
        if len(self.curve) < 2:
            raise ValueError("curve needs two or more points [volt, code]")
        volt, code = np.array(sorted(self.curve)).T
        rises, falls = np.all(np.diff(code) > 0), np.all(np.diff(code) < 0)
        if not (np.all(np.diff(volt) > 0) and (rises or falls)):
            raise ValueError("curve must rise or fall throughout: each voltage has one code")

    def _check_name(self) -> None:
        if self.name is None:
            return
        if self.zero_volt != 0 or self.curve is not None or self.signed:
            raise ValueError(
                f"{self.name} states zero_volt, curve and signed: only full_volt may stand beside"
            )
        ranges = self.numbers.ranges
        if ranges and self.full_volt not in (None, *ranges):
            listed = ", ".join(f"{volt:g}" for volt in ranges)
            raise ValueError(
                f"full_volt: {self.name} has the ranges {listed} V, not {self.full_volt:g} V"
            )

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
            full = self.numbers.full_volt if self.full_volt is None else self.full_volt
            chosen = self.numbers.ranges or self.full_volt is not None
            end = f" to {full:g} V" if chosen else ""
            return f"converter {self.name}{end}"
        if self.curve is not None:
            volt, code = self.points
            return f"codes by a curve from {volt[0]:g} V ({code[0]:g}) to {volt[-1]:g} V"
        if self.zero_volt == "estimated":
            return "zero of the converter estimated"
        end = "" if self.full_volt is None else f" to {self.full_volt:.6g} V"
        start = "signed codes, 0 at" if self.signed else "codes from"
        return f"{start} {self.zero_volt:.6g} V{end}"


@dataclass(frozen=True, kw_only=True)
class Converter(Completed):
    """Converter with codes from 0 to 2^bits − 1, or signed ones.

    Code c stands for c steps of 2^−bits of the range, which by default reaches from 0 to the
    supply. The range of signed codes reaches as far below the voltage of code 0 as above it.

    Attributes
    ----------
    supply_volt : float
        Supply of the circuit and reference of the converter in volt.
    adc_bits : int
        Resolution of the converter; without a number that of the named converter, otherwise 10.
    readings : int
        Conversions that are averaged for one cell.
    noise_lsb : PerLine or {'estimated'}, or None
        Standard deviation of one reading before quantisation, in least significant bits; a number
        or one for each driven line (`noisy_side`). 'estimated': from the unloaded frames. None:
        from five or more unloaded frames, otherwise that of a named converter by its data sheet, or
        of the shipped boards, which is sufficient dither for averaging.
    floor_code : int, or None
        Codes at or below it were not recorded: such a reading, zero or infinite by its unit, is a
        bound.
    passes_volt : tuple[float, float] or {'estimated'}, or None
        Smallest and largest voltage that a stage before the converter passes; a reading within its
        noise of either is a bound. 'estimated': from the frames. None: all.
    converter : Characteristic or Known, or None
        Voltages that the codes stand for, or a converter's name (`KNOWN_CONVERTERS`). None: from 0
        to full scale.
    scan_order : {'rows', 'columns'} or tuple of (int, int), or None
        Order in which the readings of a frame are taken: row by row, column by column, or a list of
        [row, column]. Memory, motion and times within a frame follow it. None: driven line by
        driven line.
    """

    supply_volt: float = 5.0
    adc_bits: int = 10
    readings: int = 20
    noise_lsb: PerLine | Literal["estimated"] | None = None
    floor_code: int | None = None
    passes_volt: tuple[float, float] | Literal["estimated"] | None = None
    converter: Characteristic | Known | None = None
    scan_order: Literal["rows", "columns"] | tuple[tuple[int, int], ...] | None = None

    @classmethod
    def completed(cls, content: Any) -> Any:
        """Return arguments, or the content of a file, with the bits of a named converter."""
        named = content.get("converter") if isinstance(content, Mapping) else None
        name = named.get("name") if isinstance(named, Mapping) else getattr(named, "name", named)
        known: Mapping[Any, KnownConverter] = KNOWN_CONVERTERS
        bits = known[name].adc_bits if isinstance(name, str) and name in known else None
        return content if bits is None else {"adc_bits": bits} | content

    def __post_init__(self) -> None:
        check_range("supply_volt", self.supply_volt, MIN_VOLT, MAX_VOLT, " V")
        check_ranges(self, 1, 32, "adc_bits")
        bits = self._stated.numbers.adc_bits
        if bits not in (None, self.adc_bits):
            raise ValueError(
                f"adc_bits: {self.adc_bits} contradicts the converter {self._stated.name}, "
                f"which has {bits} bits"
            )
        check_ranges(self, 1, 65535, "readings")
        check_lines("noise_lsb", self.assumed_noise)
        if max(as_tuple(self.assumed_noise)) > 2**self.adc_bits:
            raise ValueError(
                f"noise_lsb must not exceed the converter's range, {2**self.adc_bits} LSB"
            )
        lowest, highest = self.codes
        check_ranges(self, lowest, highest - 2, "floor_code")
        curve = self.characteristic.curve
        if curve is not None and not all(lowest <= code <= highest + 1 for _, code in curve):
            raise ValueError(f"converter.curve: codes lie between {lowest} and {highest + 1}")
        if self._ends[0] == self._ends[1]:
            raise ValueError(f"converter: code 0 stands at the end of the range, {self._ends[0]} V")
        if isinstance(self.passes_volt, str | None):
            return
        least, most = self.range_volt
        lower, upper = self.passes_volt
        if not least <= lower < upper <= most:
            raise ValueError(
                f"passes_volt must be two voltages from {least:g} to {most:g}, the lower one first"
            )

    @property
    def full_scale_volt(self) -> float:
        """Voltage at the end of the converter's range, where `converter` does not name another."""
        return self.supply_volt

    @property
    def _stated(self) -> Characteristic:
        """Voltages that the codes stand for, as the scene states them."""
        if isinstance(self.converter, Characteristic):
            return self.converter
        return Characteristic(name=self.converter)

    @cached_property
    def characteristic(self) -> Characteristic:
        """Voltages that the codes stand for, in numbers."""
        return self._stated.within(self.full_scale_volt)

    @property
    def range_assumed(self) -> bool:
        """Whether the range is one of several of a named chip, that after power-up."""
        return bool(self._stated.numbers.ranges) and self._stated.full_volt is None

    @property
    def codes(self) -> tuple[int, int]:
        """Lowest and highest code: 0 and 2^bits − 1, or −2^(bits−1) and 2^(bits−1) − 1."""
        lowest = -(2 ** (self.adc_bits - 1)) if self.characteristic.signed else 0
        return lowest, lowest + 2**self.adc_bits - 1

    @property
    def _ends(self) -> tuple[float, float]:
        """Voltages of code 0 and of the one above the highest.

        A voltage to be estimated is that of a scene without `converter`.
        """
        characteristic = self.characteristic
        if characteristic.curve is not None:
            volt, _ = characteristic.points
            return float(volt[0]), float(volt[-1])
        zero = characteristic.zero_volt
        full = characteristic.full_volt
        return (
            0.0 if isinstance(zero, str) else zero,
            full if isinstance(full, float | int) else self.full_scale_volt,
        )

    @property
    def zero_volt(self) -> float:
        """Voltage of code 0."""
        return self._ends[0]

    @property
    def range_volt(self) -> tuple[float, float]:
        """Least and largest voltage of the converter's range, in this order."""
        zero, full = self._ends
        if self.characteristic.signed and self.characteristic.curve is None:
            zero = 2 * zero - full
        return min(zero, full), max(zero, full)

    @property
    def code_sign(self) -> float:
        """1 if codes rise with the voltage, −1 if they fall."""
        return 1.0 if self._ends[0] < self._ends[1] else -1.0

    @property
    def noise_specified(self) -> bool:
        """Whether the noise is specified; otherwise frames determine it."""
        return self.noise_lsb not in (None, "estimated")

    @property
    def assumed_noise(self) -> PerLine:
        """`noise_lsb` if it is specified, otherwise that of the named converter or the usual one.

        The latter is the assumption until frames determine it.
        """
        if self.noise_lsb is None or self.noise_lsb == "estimated":
            noise = self._stated.numbers.noise_lsb
            return USUAL_NOISE_LSB if noise is None else noise
        return self.noise_lsb

    @property
    def noisy_side(self) -> Side:
        """Side whose lines `noise_lsb` lists: the driven one; rows unless a kind overrides it."""
        return "rows"

    def converter_description(self) -> str:
        """Return the converter's numbers in words."""
        noise = (
            lines_text(self.assumed_noise, "LSB")
            if self.noise_specified
            else "as the unloaded frames show it"
        )
        floor = f", codes above {self.floor_code}" if self.floor_code else ""
        ends = "" if self.converter is None else f", {self._stated.description()}"
        return (
            f"{self.adc_bits} bits, {counted(self.readings, 'reading')}, noise {noise}{floor}{ends}"
        )

    def recorded_from_volt(self, volt: Array) -> Array:
        """Return recorded readings of voltages at the converter, any shape."""
        return np.asarray(volt, dtype=float)

    def volt_from_recorded(self, recorded: Array) -> Array:
        """Return the voltages at the converter of recorded readings, any shape."""
        return np.asarray(recorded, dtype=float)

    @property
    def lsb_volt(self) -> float:
        """One least significant bit in volt: range/2^bits; of a curve, its mean step."""
        curve = self.characteristic.curve
        if curve is None:
            return abs(self._ends[1] - self._ends[0]) / (self.codes[1] + 1.0)
        volt, code = self.characteristic.points
        return float(abs(volt[-1] - volt[0]) / (code[-1] - code[0]))

    def steps_from_volt(self, volt: Array) -> Array:
        """Return voltages as codes that are neither rounded nor clipped; any shape."""
        if self.characteristic.curve is None:
            return np.asarray((np.asarray(volt) - self.zero_volt) * self.code_sign / self.lsb_volt)
        points, codes = self.characteristic.points
        order = np.argsort(points)
        return np.asarray(np.interp(volt, points[order], codes[order]))

    def code_from_volt(self, volt: Array) -> NDArray[np.int64]:
        """Return the nearest code, clipped to the lowest and the highest one; any shape."""
        code = np.clip(np.rint(self.steps_from_volt(volt)), *self.codes)
        return np.asarray(code, dtype=np.int64)

    def volt_from_code(self, mean_code: Array) -> Array:
        """Return the voltage that a code stands for, the middle of its interval.

        Codes may be means.
        """
        code = np.asarray(mean_code, dtype=float)
        if self.characteristic.curve is None:
            return np.asarray(self.zero_volt + self.code_sign * self.lsb_volt * code)
        volt, codes = self.characteristic.points
        return np.asarray(np.interp(code, codes, volt))

    def relative_step(self, volt: Array) -> Array:
        """Return the converter's step at voltages, in units of `lsb_volt`; any shape."""
        if self.characteristic.curve is None:
            return np.ones(np.shape(volt))
        points, codes = self.characteristic.points
        steps = np.abs(np.diff(points)) / np.diff(codes) / self.lsb_volt
        piece = np.searchsorted(codes, self.steps_from_volt(volt), side="right") - 1
        return np.asarray(steps[np.clip(piece, 0, len(steps) - 1)])

    def recorded_from_sums(self, sums: NDArray[np.integer[Any]], readings: int) -> Array:
        """Return recorded values of sums of `readings` codes."""
        return self.recorded_from_volt(self.volt_from_code(sums / readings))

    def noise_volt(self, codes: Array | None = None) -> Array:
        """Return the noise of one reading in volt, or that of `codes` in LSB.

        The result can be broadcast to (rows, columns).
        """
        codes = np.array(self.assumed_noise) if codes is None else codes
        return np.asarray((along(self.noisy_side, codes) if codes.ndim else codes) * self.lsb_volt)

    def sigma_code(self, noise_lsb: PerLine | None = None, readings: int | None = None) -> Array:
        """Return σ of the mean of `readings` codes, in LSB.

        σ² = (noise² + 1/12 − b²)/readings + b², with the variance b² of `_rounding_variance`. None:
        the converter's own noise, or number of readings.
        """
        noise = np.array(self.assumed_noise if noise_lsb is None else noise_lsb)
        bias = _rounding_variance(noise)
        return np.asarray(np.sqrt((noise**2 + 1 / 12 - bias) / (readings or self.readings) + bias))

    def constant_share(self, noise_lsb: PerLine | None = None) -> Array:
        """Return the share of σ that averaging cannot remove, to be broadcast to (rows, columns).

        None: that of the converter's own noise.
        """
        if noise_lsb is None:
            return self._own_constant_share
        rounding = _rounding_variance(np.array(noise_lsb))
        share = np.sqrt(rounding) / self.sigma_code(noise_lsb)
        return np.asarray(along(self.noisy_side, share) if share.ndim else share)

    @cached_property
    def _own_constant_share(self) -> Array:
        return self.constant_share(self.assumed_noise)

    def sigma(self, recorded: Array) -> Array:
        """Return σ of recorded readings, the same shape and unit."""
        volt = self.volt_from_recorded(recorded)
        return np.asarray(np.broadcast_to(self.sigma_volt(), volt.shape) * self.relative_step(volt))

    def sigma_volt(self) -> Array:
        """Return σ of the mean of `readings` codes in volt, to be broadcast to (rows, columns)."""
        return self.noise_volt(self.sigma_code())

    def rails(self) -> tuple[float, float]:
        """Return the range of recorded values that are no bounds.

        A reading outside it is one-sided: a code at a rail, or at the floor, only bounds the
        voltage by its edge.

        Returns
        -------
        least, most : float
            Recorded values, in the readout's unit.
        """
        lowest, top = self.codes
        floor = lowest if self.floor_code is None else self.floor_code
        # Lower edge of the first valid code, and of the last code; stages before the converter may
        # narrow the range.
        edges = np.sort(self.volt_from_code(np.array([floor + 0.5, top - 0.5])))
        if not isinstance(self.passes_volt, str | None):
            within = np.add(
                self.passes_volt,
                np.array([1, -1]) * NOISE_REACH * float(np.mean(self.sigma_volt())),
            )
            edges = np.array([max(edges[0], within[0]), min(edges[1], within[1])])
        ends = self.recorded_from_volt(edges)
        return float(ends.min()), float(ends.max())


def _rounding_variance(noise: Array) -> Array:
    """Return the part b² of the quantisation error that averaging cannot remove, LSB².

    b² = Σ_h exp(−4π²h²·noise²)/(2π²h²), because without noise all readings agree. Without noise
    b² is 1/12; above half an LSB of noise it is negligible. Source: Widrow & Kollár,
    Quantization Noise, 2008 (dither).

    Parameters
    ----------
    noise : array
        Standard deviation of one reading before quantisation, LSB.
    """
    # Terms of b², one for each harmonic h of the quantisation error: noise (…, 1), harmonic
    # (HARMONICS,)
    harmonic = np.arange(1, HARMONICS + 1, dtype=float)
    damped = np.exp(-((2 * np.pi * harmonic * noise[..., None]) ** 2))
    damped = damped / (2 * np.pi**2 * harmonic**2)
    bias = np.where(noise == 0, 1 / 12, np.minimum(np.sum(damped, axis=-1), 1 / 12))
    return np.asarray(bias)


def averaged_variance(converter: Converter, noise_lsb: PerLine) -> Array:
    """Return the variance that averaging removes, σ²(readings) − σ²(ENDLESS readings), LSB²."""
    lasting = converter.sigma_code(noise_lsb, ENDLESS)
    return np.asarray(converter.sigma_code(noise_lsb) ** 2 - lasting**2)


def noise_of_variance(converter: Converter, variance: float) -> float:
    """Return the noise in LSB that has a given `averaged_variance` in LSB².

    Bisection finds the noise.
    """
    low = 0.0
    high = 2.0**converter.adc_bits
    while high - low > NOISE_ACCURACY:
        middle = (low + high) / 2
        if float(averaged_variance(converter, middle)) < variance:
            low = middle
        else:
            high = middle
    return low
