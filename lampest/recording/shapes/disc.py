"""The disc, from which all round loads are made."""

from math import pi
from typing import NamedTuple

import numpy as np

from lampest.panel.conditions import GRAVITY
from lampest.panel.panel import Array


class Disc(NamedTuple):
    """Numbers of a disc, in mm and kPa.

    A tilt is the relative change of the rim's pressure from centre to edge.
    """

    x_mm: float
    y_mm: float
    diameter_mm: float
    inner_mm: float
    suction_kpa: float
    rim_kpa: float
    tilt_x: float
    tilt_y: float

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the pressure at points x, y in mm from the centre.

        Returns
        -------
        contact, suction : array, shape of `x`
            Contact pressure without tilt, and suction, kPa.
        """
        radius = np.hypot(x, y)
        inside = radius < self.inner_mm / 2
        return ((radius < self.diameter_mm / 2) & ~inside) * self.rim_kpa, inside * self.suction_kpa


def annulus_mm2(inner_mm: float, outer_mm: float) -> float:
    """Return the area π (d² − d_i²)/4 in mm². Raises ValueError where it is empty."""
    if not 0 <= inner_mm < outer_mm:
        raise ValueError("the inner diameter must be smaller than the outer one")
    return pi * (outer_mm * outer_mm - inner_mm * inner_mm) / 4


def contact_of_weight(mass_g: float, area_mm2: float) -> float:
    """Return the pressure m·g/A in kPa (mN/mm²); infinite if the area underflows to 0."""
    return mass_g * GRAVITY / area_mm2 if area_mm2 else float("inf")


def bearing_kpa(suction_kpa: float, inner_mm: float, outer_mm: float) -> float:
    """Return the pressure of the rim that bears the suction, −s·d_i²/(d² − d_i²).

    Raises ValueError without a rim.
    """
    rim_mm2 = annulus_mm2(inner_mm, outer_mm)
    return -suction_kpa * annulus_mm2(0, inner_mm) / rim_mm2 if rim_mm2 else float("inf")
