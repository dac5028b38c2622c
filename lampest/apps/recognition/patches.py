"""The mean pressure of a disc on patches, with derivatives.

The disc may be elongated and press unevenly along its rim. The mean is taken over points, with soft
edges, because an elongated circle on squares has no closed form.
"""

from typing import NamedTuple

import numpy as np

from lampest.panel.panel import Array
from lampest.recording.shapes.disc import Disc

# Points along either edge of a patch, 1.2 mm apart on a patch of 6 mm. Edges of the disc are soft
# over twice this distance, as real ones are.
POINTS = 5
# Their places along and across, over the patch's edge.
ACROSS, ALONG = (np.indices((POINTS, POINTS)).reshape(2, -1) + 0.5) / POINTS - 0.5
MIN_SQUARE = 1e-6  # mm², of the distance from the centre, where the angle is undefined


class Unevenness(NamedTuple):
    """Relative departures of a load from a disc.

    Attributes
    ----------
    along, across : float
        Elongation: ln of the long axis over the mean diameter, along the rows, and 45° from them.
    lobe_along, lobe_across : float
        Relative amplitudes of the rim's pressure by cos 2θ and sin 2θ.
    """

    along: float = 0.0
    across: float = 0.0
    lobe_along: float = 0.0
    lobe_across: float = 0.0


EVEN = Unevenness()


def pressure_at_places(
    places: Array, patch_mm: float, disc: Disc, form: Unevenness = EVEN
) -> tuple[Array, Array]:
    """Return the mean pressure on patches, and its derivatives by the numbers of `disc` and `form`.

    Parameters
    ----------
    places : array, shape (2, …)
        x and y of the patches' centres, mm; NaN where there is none.
    patch_mm : float
        Edge of a patch.
    disc : Disc
    form : Unevenness

    Returns
    -------
    array, shape (…)
        kPa.
    array, shape (12, …)
        Derivatives.
    """
    soft = patch_mm / POINTS
    reach = disc.diameter_mm / 2 * (1 + abs(form.along) + abs(form.across)) + patch_mm / 2 + soft
    means = np.zeros((13, *places.shape[1:]))
    near = (np.abs(places[0] - disc.x_mm) < reach) & (np.abs(places[1] - disc.y_mm) < reach)
    if near.any():
        x = (places[0, near] - disc.x_mm)[:, None] + ALONG * patch_mm
        y = (places[1, near] - disc.y_mm)[:, None] + ACROSS * patch_mm
        means[:, near] = _at_points(x, y, disc, form, soft)
    return means[0], means[1:]


def _at_points(x: Array, y: Array, disc: Disc, form: Unevenness, soft: float) -> Array:
    """Return the mean over points of the pressure and of its derivatives, (13, cells).

    The pressure is p = rim_kpa · (whole − hole) · (1 + tilt·(u, v)/R + lobes) + suction · hole,
    with soft indicators of disc and hole.

    Parameters
    ----------
    x, y : array, shape (cells, points)
        mm from the centre.
    disc : Disc
    form : Unevenness
    soft : float
        Half the width of soft edges, mm.
    """
    outer = disc.diameter_mm / 2
    # Coordinates in which the elongated disc is round: (u, v) = ((1 − a) x − s y, (1 + a) y − s x).
    u = (1 - form.along) * x - form.across * y
    v = (1 + form.along) * y - form.across * x
    square = np.maximum(u * u + v * v, MIN_SQUARE)
    radius = np.sqrt(square)
    edges = np.array([outer, disc.inner_mm / 2])
    (whole, hole), (whole_slope, hole_slope) = _inside(radius - edges[:, None, None], soft)
    if not disc.inner_mm:
        hole = hole_slope = np.zeros_like(radius)
    rim = disc.rim_kpa * (whole - hole)
    # cos 2θ and sin 2θ
    twice = (u * u - v * v) / square
    cross = 2 * u * v / square
    tilt = (disc.tilt_x * u + disc.tilt_y * v) / outer
    level = 1 + tilt + form.lobe_along * twice + form.lobe_across * cross
    by_outer = disc.rim_kpa * level * whole_slope
    by_inner = (disc.rim_kpa * level - disc.suction_kpa) * hole_slope
    # ∂p/∂u and ∂p/∂v by the chain rule: radially, by the tilt, and by the angle of the lobes
    outward = (by_outer - by_inner) / radius
    turned = 2 * rim * (form.lobe_across * twice - form.lobe_along * cross) / square
    by_u = outward * u + (disc.tilt_x / outer) * rim - turned * v
    by_v = outward * v + (disc.tilt_y / outer) * rim + turned * u
    integrands = [
        rim * level + disc.suction_kpa * hole,
        form.across * by_v - (1 - form.along) * by_u,
        form.across * by_u - (1 + form.along) * by_v,
        -(by_outer + rim * tilt / outer) / 2,
        by_inner / 2,
        hole,
        (whole - hole) * level,
        rim * u / outer,
        rim * v / outer,
        by_v * y - by_u * x,
        -by_u * y - by_v * x,
        rim * twice,
        rim * cross,
    ]
    return np.asarray(np.mean(integrands, axis=2))


def _inside(beyond: Array, soft: float) -> tuple[Array, Array]:
    """Return a soft indicator and its derivative.

    The indicator is ½ − ¾t + ¼t³ with t = beyond/soft clipped to ±1.
    """
    t = np.minimum(np.maximum(beyond * (1 / soft), -1.0), 1.0)
    square = t * t
    return 0.5 + t * (0.25 * square - 0.75), (square - 1) * (0.75 / soft)
