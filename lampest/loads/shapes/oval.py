"""Pressure of a disc that is neither round nor even: stretched, with soft edges, and a rim that presses in lobes.

A stretched circle has no closed form on square patches, and real edges are soft. So its pressure is the mean over
points whose distance from an edge, within `SOFT` of it, says how much of it counts; with derivatives.
"""

from typing import NamedTuple

import numpy as np

from lampest.loads.shapes.disc import Disc
from lampest.panel.panel import Array, Panel

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
    slopes, pressure = np.zeros((12, *panel.shape)), np.zeros(panel.shape)
    reach = disc.diameter_mm / 2 * (1 + abs(form.along) + abs(form.across)) + patch_mm * (0.5 + SOFT)
    near = [
        np.flatnonzero(np.abs(centres - middle) < reach)
        for centres, middle in zip(panel.centres_mm(), disc[:2], strict=True)
    ]
    if not all(map(len, near)):
        return pressure, slopes
    window = (..., slice(near[1][0], near[1][-1] + 1), slice(near[0][0], near[0][-1] + 1))
    offset = ((np.arange(POINTS) + 0.5) / POINTS - 0.5) * patch_mm
    x, y = (
        (centres[one][:, None] + offset).ravel() - middle
        for centres, one, middle in zip(panel.centres_mm(), near, disc[:2], strict=True)
    )
    parts = _at_points(x[None, :], y[:, None], disc, form, SOFT * patch_mm)
    blocks = (13, len(near[1]), POINTS, len(near[0]), POINTS)
    means = parts.reshape(blocks).mean(axis=(2, 4))
    pressure[window], slopes[window] = means[0], means[1:]
    return pressure, slopes


def _at_points(x: Array, y: Array, disc: Disc, form: Unevenness, soft: float) -> Array:
    """Pressure and its slopes at points x (1, across), y (down, 1) mm from the centre: (13, down, across)."""
    u, v = x - form.along * x - form.across * y, y - form.across * x + form.along * y
    square = np.maximum(u * u + v * v, 1e-6)
    radius, outer = np.sqrt(square), disc.diameter_mm / 2
    (whole, whole_slope), (hole, hole_slope) = (_inside(radius - edge, soft) for edge in (outer, disc.inner_mm / 2))
    if disc.inner_mm == 0:
        hole, hole_slope = np.zeros_like(radius), np.zeros_like(radius)
    twice, cross = (u * u - v * v) / square, 2 * u * v / square  # cos 2θ and sin 2θ
    level = 1 + (disc.tilt_x * u + disc.tilt_y * v) / outer + form.lobe_along * twice + form.lobe_across * cross
    rim = whole - hole
    contact = disc.rim_kpa * rim
    outward = disc.rim_kpa * level * (whole_slope - hole_slope) + disc.suction_kpa * hole_slope
    turned = 2 * contact * (form.lobe_across * twice - form.lobe_along * cross) / square
    by_u = outward * u / radius + contact * disc.tilt_x / outer - turned * v
    by_v = outward * v / radius + contact * disc.tilt_y / outer + turned * u
    out = np.empty((13, *radius.shape))
    out[0] = contact * level + disc.suction_kpa * hole
    out[1] = -by_u * (1 - form.along) + by_v * form.across
    out[2] = by_u * form.across - by_v * (1 + form.along)
    out[3] = -disc.rim_kpa * level * whole_slope / 2 - contact * (disc.tilt_x * u + disc.tilt_y * v) / (2 * outer**2)
    out[4] = (disc.rim_kpa * level - disc.suction_kpa) * hole_slope / 2
    out[5] = hole
    out[6] = rim * level
    out[7] = contact * u / outer
    out[8] = contact * v / outer
    out[9] = by_v * y - by_u * x
    out[10] = -by_u * y - by_v * x
    out[11] = contact * twice
    out[12] = contact * cross
    return out


def _inside(beyond: Array, soft: float) -> tuple[Array, Array]:
    """1 where −`beyond` is above `soft`, 0 where it is below −`soft`, ½ − ¾t + ¼t³ between; and its slope."""
    t = np.clip(beyond / soft, -1, 1)
    return 0.5 - 0.75 * t + 0.25 * t**3, 0.75 * (t * t - 1) / soft
