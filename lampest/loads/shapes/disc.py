"""A disc: what all round loads are made of.

A circle of diameter d about (x, y) presses with p·(1 + tilt) between its inner diameter d_i and d, and sucks with s
inside d_i. Simulation takes its pressure at points, recognition its exact mean on every patch, with derivatives.
"""

from math import log, pi
from typing import NamedTuple

import numpy as np

from lampest.loads.footprint import cover
from lampest.loads.pressure import GRAVITY
from lampest.panel.panel import Array, Panel


class Disc(NamedTuple):
    """Numbers of a disc: mm and kPa; tilt is the relative change of p from the centre to the edge."""

    x_mm: float
    y_mm: float
    diameter_mm: float
    inner_mm: float
    suction_kpa: float
    rim_kpa: float
    tilt_x: float
    tilt_y: float


def annulus_mm2(inner_mm: float, outer_mm: float) -> float:
    """π (d² − d_i²)/4 in mm². Raises ValueError where it is empty."""
    if not 0 <= inner_mm < outer_mm:
        raise ValueError("the inner diameter must be smaller than the outer one")
    return pi * (outer_mm * outer_mm - inner_mm * inner_mm) / 4


def contact_of_weight(mass_g: float, area_mm2: float) -> float:
    """m·g/A in kPa (mN/mm²). Raises ValueError where that is infinite."""
    if area_mm2 == 0:  # of edges too small for their product
        return checked_contact(float("inf"))
    return checked_contact(mass_g * GRAVITY / area_mm2 if area_mm2 < float("inf") else 0.0)


def checked_contact(kpa: float) -> float:
    """A contact pressure. Raises ValueError where it is negative or not finite."""
    if not 0 <= kpa < float("inf"):
        raise ValueError("the contact pressure must be zero or positive, and finite")
    return kpa


def bearing_kpa(suction_kpa: float, inner_mm: float, outer_mm: float) -> float:
    """p_bear = −s·d_i²/(d² − d_i²): the rim's pressure that bears the suction. Raises ValueError without a rim."""
    rim_mm2 = annulus_mm2(inner_mm, outer_mm)
    if rim_mm2 == 0:  # of diameters too small for their squares
        return float("inf")
    return -suction_kpa * annulus_mm2(0, inner_mm) / rim_mm2


def log_bearing(suction_kpa: float, share: float) -> float:
    """ln p_bear = ln(−s) + 2 ln ι − ln(1 − ι²) with ι = d_i/d: the same, for fits that step in logarithms."""
    return log(-suction_kpa) + 2 * log(share) - log(1 - share * share)


def bearing_slope(share: float) -> float:
    """∂ ln p_bear/∂ι = 2/(ι (1 − ι²)) with ι = d_i/d."""
    return 2 / (share * (1 - share * share))


def annular_pressure(disc: Disc, x: Array, y: Array) -> tuple[Array, Array]:
    """Contact pressure without tilt and suction, kPa, at points x, y mm from the disc's centre; all one shape."""
    radius = np.hypot(x, y)
    inside = radius < disc.inner_mm / 2
    rim = (radius >= disc.inner_mm / 2) & (radius < disc.diameter_mm / 2)
    return rim * disc.rim_kpa, inside * disc.suction_kpa


def disc_pressure(panel: Panel, patch_mm: float, disc: Disc) -> tuple[Array, Array]:
    """Mean pressure on every patch, (rows, columns) kPa, and its slopes by the disc's numbers (8, rows, columns)."""
    radius = disc.diameter_mm / 2
    circles = (disc.diameter_mm, disc.inner_mm) if disc.inner_mm > 0 else (disc.diameter_mm,)
    covered = cover(panel, patch_mm, (disc.x_mm, disc.y_mm), circles)
    tilt = np.array([1.0, disc.tilt_x / radius, disc.tilt_y / radius])
    contact, contact_slope = covered.values[0], covered.slopes[:, 0]
    slopes = np.zeros((8, *panel.shape))
    pressure = np.zeros(panel.shape)
    if disc.inner_mm > 0:
        inner, inner_slope = covered.values[1], covered.slopes[:, 1]
        contact = contact - inner
        pressure = disc.suction_kpa * inner[0]
        slopes[[0, 1, 3]] = disc.suction_kpa * inner_slope[:, 0]
        slopes[3] -= disc.rim_kpa * _weighted(tilt, inner_slope[2])
        slopes[4] = inner[0]
        contact_slope = contact_slope.copy()
        contact_slope[:2] -= inner_slope[:2]
    slopes[5] = _weighted(tilt, contact)
    pressure = pressure + disc.rim_kpa * slopes[5]
    for number in range(3):
        slopes[number] += disc.rim_kpa * _weighted(tilt, contact_slope[number])
    slopes[2] -= disc.rim_kpa * _weighted(tilt[1:], contact[1:]) / disc.diameter_mm
    slopes[6:] = disc.rim_kpa * contact[1:] / radius
    return pressure, slopes


def _weighted(weights: Array, parts: Array) -> Array:
    """Σ w_i·part_i, (parts, rows, columns) → (rows, columns)."""
    total: Array = (weights @ parts.reshape(len(weights), -1)).reshape(parts.shape[1:])
    return total
