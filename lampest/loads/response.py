"""The cell's answer to pressure: kPa ↔ resistance over its unloaded value, monotone and invertible.

Where a scene tells a response of its own (`lampest.panel.response`), that one; else the published curve, r/r0 against p
in kPa (suction is negative):

    p ≤ 0         exp(−0.202·p)                     through 7.54 at −10; the slope at 0 nearly meets the next piece's
    0 … 2.5       1 − 0.192·p
    2.5 … 28      0.52 − 0.016·(p − 2.5)
    28 … 40       falls exponentially from 0.112 to 0.06
    40 …          falls exponentially through 0.02 at 235

Beyond −10 and 235 kPa nothing is published; the last pieces are continued. Source: paper, section II.A and figure 1-e.
The curve is that of flat cells: bent ones answer less, at 40 kPa by −69 to −82 % instead of −94 % (figure 2-d).
"""

import numpy as np
from numpy.typing import ArrayLike

from lampest.panel.panel import Array
from lampest.panel.response import Response

LINEAR_PRESSURE = np.array([0.0, 2.5, 28.0])
LINEAR_RATIO = np.array([1.0, 0.52, 0.112])
SUCTION_RATE = np.log(7.54) / -10.0
SATURATING_RATE = np.log(0.06 / 0.112) / 12.0
SATURATED_RATE = np.log(0.02 / 0.06) / 195.0

VACUUM_KPA = -101.325
# Pressures that a resistance tells. Below, nothing is published. Above, 1 % of the resistance is 1.8 kPa and no longer
# 0.2, and what RESPONSE_SD leaves open is more than the pressure itself.
TOLD_KPA = (-10.0, 40.0)
# An assumption: standard deviation of ln(r/r0) of a cell at a pressure, as a fraction of the curve's ln f(p). The curve
# is the mean over two cells, three rounds each, "repeatable and robust", without published figures of its scatter
# (section II.A). A data sheet of a kindred film (Interlink FSR 400) gives 6 % from part to part, a hysteresis of 10 %
# and a drift of 5 % for each decade of time.
RESPONSE_SD = 0.1


def ratio_from_pressure(pressure: ArrayLike, response: Response | None = None) -> Array:
    """r/r0 = f(p), any shape, kPa → 1; strictly falling. Of a cell of gain 1; response: None is the published one."""
    pressure = np.asarray(pressure, dtype=float)
    if response is not None:
        return np.exp(response.logarithm(pressure))
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
    return pressure_from_logarithm(np.log(ratio))


def pressure_from_logarithm(logarithm: ArrayLike, response: Response | None = None) -> Array:
    """p = f⁻¹(e^x), x = ln(r/r0), any shape, 1 → kPa; ±∞ gives ∓∞, NaN stays. Response as above."""
    logarithm = np.asarray(logarithm, dtype=float)
    if response is not None:
        return response.pressure(logarithm)
    start = np.log(LINEAR_RATIO[-1])
    linear = np.interp(-np.exp(np.clip(logarithm, start, 0.0)), -LINEAR_RATIO, LINEAR_PRESSURE)
    suction = np.maximum(logarithm, 0.0) / SUCTION_RATE
    below = np.minimum(logarithm - start, 0.0)
    saturating = np.maximum(below, 12.0 * SATURATING_RATE)
    return np.asarray(linear + suction + saturating / SATURATING_RATE + (below - saturating) / SATURATED_RATE)


def gains_of(response: Response | None) -> Array:
    """κ of the cells, to be broadcast to (rows, columns); 1 where nothing is told."""
    return np.array(1.0) if response is None else response.gains


def log_ratio_from_pressure(pressure: ArrayLike, response: Response | None = None) -> Array:
    """ln f(p), any shape, kPa → 1; as `ratio_from_pressure`."""
    return np.log(ratio_from_pressure(pressure)) if response is None else response.logarithm(pressure)


def relative_change_from_pressure(pressure: ArrayLike) -> Array:
    """ΔR/R0 = f(p) − 1, any shape, kPa → 1."""
    return ratio_from_pressure(pressure) - 1.0


def pressure_from_relative_change(relative_change: ArrayLike) -> Array:
    """p = f⁻¹(1 + ΔR/R0), any shape, 1 → kPa. Raises ValueError where a change is −1 or less."""
    return pressure_from_ratio(np.asarray(relative_change, dtype=float) + 1.0)
