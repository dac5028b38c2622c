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
    press = disc.rim_kpa
    means = _means_over_points(x, y, disc, form, soft)
    lean = (disc.tilt_x * means.rim_u + disc.tilt_y * means.rim_v) / outer
    return np.array(
        [
            press * means.level + disc.suction_kpa * means.hole,
            form.across * means.by_v - (1 - form.along) * means.by_u,
            form.across * means.by_u - (1 + form.along) * means.by_v,
            -press * (means.by_outer + lean / outer) / 2,
            (press * means.by_inner - disc.suction_kpa * means.hole_slope) / 2,
            means.hole,
            means.level,
            press / outer * means.rim_u,
            press / outer * means.rim_v,
            means.by_along,
            -means.by_across,
            press * means.rim_twice,
            press * means.rim_cross,
        ]
    )


class _Means(NamedTuple):
    """Means over the points of a patch, (cells,) each, which the derivatives are composed of.

    Attributes
    ----------
    level, hole : array
        Relative pressure of the rim, and share of the hole.
    by_u, by_v : array
        Slopes of the pressure, kPa/mm.
    by_outer, by_inner : array
        Relative pressure of the rim times the slopes of the edges.
    hole_slope : array
        Slope of the hole's edge.
    rim_u, rim_v : array
        First moments of the rim.
    by_along, by_across : array
        Changes of the pressure with the elongation.
    rim_twice, rim_cross : array
        Rim times cos 2θ and sin 2θ.
    """

    level: Array
    hole: Array
    by_u: Array
    by_v: Array
    by_outer: Array
    by_inner: Array
    hole_slope: Array
    rim_u: Array
    rim_v: Array
    by_along: Array
    by_across: Array
    rim_twice: Array
    rim_cross: Array


def _means_over_points(x: Array, y: Array, disc: Disc, form: Unevenness, soft: float) -> _Means:
    """Return the means that `_at_points` combines; both functions have the same parameters.

    The pressure is p = rim_kpa · (whole − hole) · (1 + tilt·(u, v)/R + lobes) + suction · hole,
    with soft indicators of disc and hole.
    """
    outer = disc.diameter_mm / 2
    press = disc.rim_kpa
    # Coordinates in which the elongated disc is round: (u, v) = ((1 − a) x − s y, (1 + a) y − s x).
    u = (1 - form.along) * x - form.across * y
    v = (1 + form.along) * y - form.across * x
    square = np.maximum(u * u + v * v, MIN_SQUARE)
    radius = np.sqrt(square)
    edges = np.array([outer, disc.inner_mm / 2])
    (whole, hole), (whole_slope, hole_slope) = _inside(radius - edges[:, None, None], soft)
    if not disc.inner_mm:
        hole = hole_slope = np.zeros_like(radius)
    rim = whole - hole
    # cos 2θ and sin 2θ
    twice = (u * u - v * v) / square
    cross = 2 * u * v / square
    level = (
        1
        + (disc.tilt_x / outer) * u
        + (disc.tilt_y / outer) * v
        + form.lobe_along * twice
        + form.lobe_across * cross
    )
    # ∂p/∂u and ∂p/∂v by the chain rule: radially, by the tilt, and by the angle of the lobes
    outward = (press * level * (whole_slope - hole_slope) + disc.suction_kpa * hole_slope) / radius
    turned = (2 * press) * rim * (form.lobe_across * twice - form.lobe_along * cross) / square
    by_u = outward * u + (press * disc.tilt_x / outer) * rim - turned * v
    by_v = outward * v + (press * disc.tilt_y / outer) * rim + turned * u
    integrands = _Means(
        level=rim * level,
        hole=hole,
        by_u=by_u,
        by_v=by_v,
        by_outer=level * whole_slope,
        by_inner=level * hole_slope,
        hole_slope=hole_slope,
        rim_u=rim * u,
        rim_v=rim * v,
        by_along=by_v * y - by_u * x,
        by_across=by_u * y + by_v * x,
        rim_twice=rim * twice,
        rim_cross=rim * cross,
    )
    return _Means(*(np.array(integrands) @ np.full(x.shape[1], 1 / x.shape[1])))


def _inside(beyond: Array, soft: float) -> tuple[Array, Array]:
    """Return a soft indicator and its derivative.

    The indicator is ½ − ¾t + ¼t³ with t = beyond/soft clipped to ±1.
    """
    t = np.minimum(np.maximum(beyond * (1 / soft), -1.0), 1.0)
    square = t * t
    return 0.5 + t * (0.25 * square - 0.75), (square - 1) * (0.75 / soft)
