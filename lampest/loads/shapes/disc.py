"""A disc: what all round loads are made of; its pressure at points, and its mean on patches with derivatives.

On patches it may be stretched and press in lobes, with soft edges: the mean over points, each weighed by its distance
from an edge. A stretched circle has no closed form on squares.
"""

from math import log, pi
from typing import NamedTuple

import numpy as np

from lampest.loads.pressure import GRAVITY
from lampest.panel.panel import Array, Panel


def patch_means(places: Array, disc: Array, form: Array, patch: float, soft: float, points: int) -> Array:
    """(13, …): mean pressure on every patch and its slopes by the numbers of `disc` and `form`.

    places : (2, …) mm, x and y of the patches' centres, NaN where there is none. disc, form : their numbers, (8) and
    (4). patch : mm, edge of the patches, with `points` points along either. soft : mm, half the width of an edge.
    Patches out of reach hold zero.
    """
    reach = disc[2] / 2 * (1 + abs(form[0]) + abs(form[1])) + patch / 2 + soft
    means = np.zeros((13, *places.shape[1:]))
    near = (np.abs(places[0] - disc[0]) < reach) & (np.abs(places[1] - disc[1]) < reach)
    if not near.any():
        return means
    offset = ((np.arange(points) + 0.5) / points - 0.5) * patch
    x = (places[0, near] - disc[0])[:, None, None] + offset
    y = (places[1, near] - disc[1])[:, None, None] + offset[:, None]
    means[:, near] = _at_points(x, y, disc, form, soft).mean(axis=(2, 3))
    return means


def _at_points(x: Array, y: Array, disc: Array, form: Array, soft: float) -> Array:
    """(13, …) pressure and its slopes at points x and y, mm from the centre, to be broadcast together."""
    outer, inner, suction, press = disc[2] / 2, disc[3] / 2, disc[4], disc[5]
    along, stretched, lobe_along, lobe_across = form
    u, v = x - along * x - stretched * y, y - stretched * x + along * y
    square = np.maximum(u * u + v * v, 1e-6)
    radius = np.sqrt(square)
    whole, whole_slope = _inside(radius - outer, soft)
    hole, hole_slope = _inside(radius - inner, soft) if inner > 0 else (np.zeros_like(radius),) * 2
    twice, cross = (u * u - v * v) / square, 2 * u * v / square  # cos 2θ and sin 2θ
    lean = (disc[6] * u + disc[7] * v) / outer
    level = 1 + lean + lobe_along * twice + lobe_across * cross
    contact = press * (whole - hole)
    outward = press * level * (whole_slope - hole_slope) + suction * hole_slope
    turned = 2 * contact * (lobe_across * twice - lobe_along * cross) / square
    by_u = outward * u / radius + contact * disc[6] / outer - turned * v
    by_v = outward * v / radius + contact * disc[7] / outer + turned * u
    return np.stack(
        [
            contact * level + suction * hole,
            by_v * stretched - by_u * (1 - along),
            by_u * stretched - by_v * (1 + along),
            -(press * level * whole_slope + contact * lean / outer) / 2,
            (press * level - suction) * hole_slope / 2,
            hole,
            (whole - hole) * level,
            contact * u / outer,
            contact * v / outer,
            by_v * y - by_u * x,
            -(by_u * y + by_v * x),
            contact * twice,
            contact * cross,
        ]
    )


def _inside(beyond: Array, soft: float) -> tuple[Array, Array]:
    """1 where −`beyond` is above `soft`, 0 where it is below −`soft`, ½ − ¾t + ¼t³ between; and its slope."""
    t = np.clip(beyond / soft, -1.0, 1.0)
    return 0.5 - 0.75 * t + 0.25 * t**3, 0.75 * (t * t - 1) / soft


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


def annular_pressure(disc: Disc, x: Array, y: Array) -> tuple[Array, Array]:
    """Contact pressure without tilt and suction, kPa, at points x, y mm from the disc's centre; all one shape."""
    radius = np.hypot(x, y)
    inside = radius < disc.inner_mm / 2
    rim = (radius >= disc.inner_mm / 2) & (radius < disc.diameter_mm / 2)
    return rim * disc.rim_kpa, inside * disc.suction_kpa


POINTS = 5  # along either edge of a patch: 1.2 mm on a patch of 6 mm
SOFT = 0.2  # of a patch's edge, half the width over which an edge is soft: real ones are, and points are so far apart


class Unevenness(NamedTuple):
    """How a load departs from a disc; all relative.

    along, across : its long axis is longer by this in log, its short one shorter: along the rows, and 45° from it.
    lobe_along, lobe_across : amplitude of the rim's pressure by cos 2θ and sin 2θ.
    """

    along: float
    across: float
    lobe_along: float
    lobe_across: float


EVEN = Unevenness(0.0, 0.0, 0.0, 0.0)


def oval_pressure(panel: Panel, patch_mm: float, disc: Disc, form: Unevenness = EVEN) -> tuple[Array, Array]:
    """Mean pressure on every patch, (rows, columns) kPa, and its slopes by the numbers of both (12, rows, columns)."""
    return pressure_at_places(panel.places_mm, patch_mm, disc, form)


def pressure_at_places(places: Array, patch_mm: float, disc: Disc, form: Unevenness = EVEN) -> tuple[Array, Array]:
    """The same of patches at any places (2, …) mm: (…) and (12, …)."""
    numbers = np.array(disc, dtype=float), np.array(form, dtype=float)
    means = patch_means(places, *numbers, patch_mm, SOFT * patch_mm, POINTS)
    return means[0], means[1:]
