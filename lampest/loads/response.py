"""The published response of a cell to pressure, and f(p) = r/r0 of any response.

r/r0 against p in kPa (suction is negative); strictly falling, and inverted exactly:

    p ≤ 0         exp(−0.202·p)                     through 7.54 at −10; the slope at 0 nearly meets the next piece's
    0 … 2.5       1 − 0.192·p
    2.5 … 28      0.52 − 0.016·(p − 2.5)
    28 … 40       falls exponentially from 0.112 to 0.06
    40 …          falls exponentially through 0.02 at 235

Beyond −10 and 235 kPa nothing is published; the last pieces are continued. Source: paper, section II.A and figure 1-e.
The curve is that of flat cells: bent ones answer less, at 40 kPa by −69 to −82 % instead of −94 % (figure 2-d).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lampest.panel.panel import Array
from lampest.panel.response import Response

# The points of figure 1-e: kPa and r/r0; straight between them, and decay rates of ln(r/r0) per kPa beside them.
LINEAR_PRESSURE = np.array([0.0, 2.5, 28.0])
LINEAR_RATIO = np.array([1.0, 0.52, 0.112])
SUCTION_RATE = np.log(7.54) / -10.0
SATURATING_RATE = np.log(0.06 / 0.112) / 12.0
SATURATED_RATE = np.log(0.02 / 0.06) / 195.0

VACUUM_KPA = -101.325  # of an empty space against the standard atmosphere
# kPa between which a resistance determines the pressure. Below, nothing is published. Above, 1 % of the resistance is
# 1.8 kPa and no longer 0.2, and what RESPONSE_SD leaves open is more than the pressure itself.
TOLD_KPA = (-10.0, 40.0)
# An assumption: standard deviation of ln(r/r0) of a cell at a pressure, as a fraction of ln f(p). The curve is the mean
# over two cells, without published scatter (section II.A). A data sheet of a kindred film (Interlink FSR 400) gives 6 %
# from part to part, a hysteresis of 10 % and a drift of 5 % for each decade of time.
RESPONSE_SD = 0.1


@dataclass(frozen=True, kw_only=True)
class PublishedCurve(Response):
    """The paper's curve, for scenes that name no response of their own."""

    def logarithm(self, pressure: ArrayLike) -> Array:
        """ln f(p)."""
        pressure = np.asarray(pressure, dtype=float)
        linear = np.interp(pressure, LINEAR_PRESSURE, LINEAR_RATIO)
        logarithm = SUCTION_RATE * np.minimum(pressure, 0.0)
        logarithm = logarithm + SATURATING_RATE * np.clip(pressure - 28.0, 0.0, 12.0)
        logarithm = logarithm + SATURATED_RATE * np.maximum(pressure - 40.0, 0.0)
        return np.asarray(np.log(linear * np.exp(logarithm)))

    def pressure(self, logarithm: ArrayLike) -> Array:
        """p of ln f(p)."""
        logarithm = np.asarray(logarithm, dtype=float)
        start = np.log(LINEAR_RATIO[-1])
        linear = np.interp(-np.exp(np.clip(logarithm, start, 0.0)), -LINEAR_RATIO, LINEAR_PRESSURE)
        suction = np.maximum(logarithm, 0.0) / SUCTION_RATE
        below = np.minimum(logarithm - start, 0.0)
        saturating = np.maximum(below, 12.0 * SATURATING_RATE)
        return np.asarray(linear + suction + saturating / SATURATING_RATE + (below - saturating) / SATURATED_RATE)

    def curve_sd(self, pressure: ArrayLike) -> Array:
        """None is published; RESPONSE_SD covers it."""
        return np.zeros(np.shape(pressure))

    @property
    def told_kpa(self) -> tuple[float, float]:
        """TOLD_KPA."""
        return TOLD_KPA


PUBLISHED = PublishedCurve()


def ratio_from_pressure(pressure: ArrayLike, response: Response = PUBLISHED) -> Array:
    """r/r0 = f(p) of a cell of gain 1, any shape, kPa → 1; strictly falling."""
    return np.exp(response.logarithm(pressure))


def relative_change_from_pressure(pressure: ArrayLike) -> Array:
    """ΔR/R0 = f(p) − 1 of the published curve, any shape, kPa → 1."""
    return ratio_from_pressure(pressure) - 1.0
