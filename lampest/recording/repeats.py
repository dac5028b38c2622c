"""Noise of a converter from repeated readings.

Means of codes keep what quantisation leaves, so that a variance over repeats is not the noise itself.
"""

from dataclasses import replace

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.lines import PerLine

MIN_REPEATS = 50  # they determine a noise to a tenth
ENDLESS = 65535  # readings: the part of σ that remains does not average out


def sigma_code(readout: Readout, noise_lsb: PerLine, readings: int | None = None) -> Array:
    """Return σ of the mean code, in LSB, for another noise and another number of readings."""
    return np.asarray(replace(readout, noise_lsb=noise_lsb, readings=readings or readout.readings).sigma_code())


def averaged_variance(readout: Readout, noise_lsb: PerLine) -> Array:
    """Return the variance that repeats average out, LSB²: σ²(readings) − σ²(endlessly many)."""
    return np.asarray(sigma_code(readout, noise_lsb) ** 2 - sigma_code(readout, noise_lsb, ENDLESS) ** 2)


def noise_of_variance(readout: Readout, variance: float) -> float:
    """Return the noise, LSB, of which repeats average out that variance, LSB²; by bisection."""
    low, high = 0.0, 2.0**readout.adc_bits
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (middle, high) if float(averaged_variance(readout, middle)) < variance else (low, middle)
    return low
