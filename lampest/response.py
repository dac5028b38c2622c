"""The cell's answer to pressure: kPa ↔ resistance over its unloaded value, monotone and invertible in closed form.

The published curve, r/r0 against p in kPa (suction is negative):

    p ≤ 0         exp(−0.202·p)                     through 7.54 at −10; the slope at 0 nearly meets the next piece's
    0 … 2.5       1 − 0.192·p
    2.5 … 28      0.52 − 0.016·(p − 2.5)
    28 … 40       falls exponentially from 0.112 to 0.06
    40 …          falls exponentially through 0.02 at 235

Beyond −10 and 235 kPa nothing is published; the last pieces are continued. Source: paper, section II.A and figure 1-e.
"""

import numpy as np
from numpy.typing import ArrayLike

from lampest.panel import Array

LINEAR_PRESSURE = np.array([0.0, 2.5, 28.0])
LINEAR_RATIO = np.array([1.0, 0.52, 0.112])
SUCTION_RATE = np.log(7.54) / -10.0
SATURATING_RATE = np.log(0.06 / 0.112) / 12.0
SATURATED_RATE = np.log(0.02 / 0.06) / 195.0


def ratio_from_pressure(pressure: ArrayLike) -> Array:
    """r/r0 = f(p), any shape, kPa → 1; strictly falling."""
    pressure = np.asarray(pressure, dtype=float)
    linear = np.interp(pressure, LINEAR_PRESSURE, LINEAR_RATIO)
    logarithm = SUCTION_RATE * np.minimum(pressure, 0.0)
    logarithm = logarithm + SATURATING_RATE * np.clip(pressure - 28.0, 0.0, 12.0)
    logarithm = logarithm + SATURATED_RATE * np.maximum(pressure - 40.0, 0.0)
    return np.asarray(linear * np.exp(logarithm))


def pressure_from_ratio(ratio: ArrayLike) -> Array:
    """p = f⁻¹(r/r0), any shape, 1 → kPa; strictly falling. Raises ValueError where a ratio is not positive."""
    ratio = np.asarray(ratio, dtype=float)
    if not np.all(ratio > 0):
        raise ValueError("a resistance over its unloaded value must be positive")
    linear = np.interp(-ratio, -LINEAR_RATIO, LINEAR_PRESSURE)
    below = np.log(np.minimum(ratio / LINEAR_RATIO[-1], 1.0))
    saturating = np.maximum(below, 12.0 * SATURATING_RATE)
    suction = np.log(np.maximum(ratio, 1.0)) / SUCTION_RATE
    return np.asarray(linear + suction + saturating / SATURATING_RATE + (below - saturating) / SATURATED_RATE)


def relative_change_from_pressure(pressure: ArrayLike) -> Array:
    """ΔR/R0 = f(p) − 1, any shape, kPa → 1."""
    return ratio_from_pressure(pressure) - 1.0


def pressure_from_relative_change(relative_change: ArrayLike) -> Array:
    """p = f⁻¹(1 + ΔR/R0), any shape, 1 → kPa. Raises ValueError where a change is −1 or less."""
    return pressure_from_ratio(np.asarray(relative_change, dtype=float) + 1.0)
