"""The voltage divider and its converter: volt ↔ ohm ↔ ADC code, what noise leaves of them, and what it hides."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.scene import TwoPointReadout


def voltage_from_resistance(readout: TwoPointReadout, resistance: Array) -> Array:
    """V = Vcc·Rref/(R + Rref) across the reference, V = Vcc·R/(R + Rref) across the sensor; any shape, ohm → volt.

    Source: paper, equation (1) (across the sensor) and section V.B (across the reference).
    """
    with np.errstate(divide="ignore"):
        ratio = np.asarray(resistance, dtype=float) / readout.reference_ohm
    if readout.measured_across == "reference":
        return readout.supply_volt / (1 + ratio)
    with np.errstate(divide="ignore"):
        return readout.supply_volt / (1 + 1 / ratio)


def resistance_from_voltage(readout: TwoPointReadout, volt: Array) -> Array:
    """R = (Vcc − V)/V·Rref across the reference, R = V/(Vcc − V)·Rref across the sensor; any shape, volt → ohm.

    0 V and Vcc give 0 or infinite ohm. Source: paper, equation (1) and section V.B.
    """
    volt = np.asarray(volt, dtype=float)
    rest = readout.supply_volt - volt
    upper, lower = (rest, volt) if readout.measured_across == "reference" else (volt, rest)
    with np.errstate(divide="ignore"):
        return upper / lower * readout.reference_ohm


def lsb_volt(readout: TwoPointReadout) -> float:
    """Vcc / 2^bits: one least significant bit in volt."""
    return readout.supply_volt / 2.0**readout.adc_bits


def code_from_voltage(readout: TwoPointReadout, volt: Array) -> NDArray[np.int64]:
    """code = ⌊V/Vcc · 2^bits⌋, held within 0 and 2^bits − 1; any shape."""
    code = np.floor(np.asarray(volt) / lsb_volt(readout))
    held: NDArray[np.int64] = np.clip(code, 0, 2**readout.adc_bits - 1).astype(np.int64)
    return held


def voltage_from_code(readout: TwoPointReadout, mean_code: Array) -> Array:
    """V = (code + ½)·Vcc/2^bits: the middle of the interval that a converter calls by this code; means of codes too."""
    return (np.asarray(mean_code, dtype=float) + 0.5) * lsb_volt(readout)


def resistance_from_sums(readout: TwoPointReadout, sums: NDArray[np.integer[Any]], readings: int) -> Array:
    """R of the mean of so many codes, any shape, ohm; a rail stands for the middle of its interval and stays finite."""
    return resistance_from_voltage(readout, voltage_from_code(readout, sums / readings))


def sigma_code(readout: TwoPointReadout) -> float:
    """σ of the mean of `readings` codes, in LSB: σ² = (noise² + 1/12 − b²)/readings + b².

    b² = Σ_h exp(−4π²h²·noise²)/(2π²h²) is what averaging cannot remove, because without noise all readings agree:
    1/12 for no noise, 0.0000 above half an LSB. Source: Widrow & Kollár, Quantization Noise, 2008 (dither).
    """
    harmonic = np.arange(1, 2001, dtype=float)
    # The tail beyond the last harmonic is 1/(2π²·2000); it only matters where there is no noise, and there b² is 1/12.
    left = np.sum(np.exp(-((2 * np.pi * harmonic * readout.noise_lsb) ** 2)) / (2 * np.pi**2 * harmonic**2))
    bias = 1 / 12 if readout.noise_lsb == 0 else min(float(left), 1 / 12)
    return float(np.sqrt((readout.noise_lsb**2 + 1 / 12 - bias) / readout.readings + bias))


def sigma_resistance(readout: TwoPointReadout, resistance: Array) -> Array:
    """σ_R = (R + Rref)²/Rref · σ_V/Vcc (delta method, either divider); any shape, ohm.

    `resistance` is what the divider sees, series resistance included. Source: error propagation of equation (1).
    """
    sigma_volt = sigma_code(readout) * lsb_volt(readout)
    total = np.asarray(resistance, dtype=float) + readout.reference_ohm
    return total**2 / readout.reference_ohm * sigma_volt / readout.supply_volt


def rails(readout: TwoPointReadout) -> tuple[float, float]:
    """(least, largest) resistance in ohm that a code between the first and the last one can mean.

    A reading beyond is a bound, not a value: a code at a rail only says that the voltage is beyond the code's edge.
    """
    top = 2.0**readout.adc_bits - 1
    ends = resistance_from_voltage(readout, np.array([1.0, top]) * lsb_volt(readout))
    return float(ends.min()), float(ends.max())


def resolution_limit(two_point_resistance: Array, sigma: Array) -> Array:
    """r_max = R²/σ: an open cell in place of one of r_max changes R by just its noise σ; any shape, ohm."""
    return np.asarray(two_point_resistance) ** 2 / np.asarray(sigma)
