"""The pressure of a disc at points of patches, added up patch by patch in machine code.

Imported where a shape is fitted, and not before: numba takes half a second to come.
"""

from math import sqrt
from typing import Any

from lampest.panel.machine import machine_code


@machine_code
def _inside(beyond: float, soft: float) -> tuple[float, float]:
    """1 where −`beyond` is above `soft`, 0 where it is below −`soft`, ½ − ¾t + ¼t³ between; and its slope."""
    t = min(max(beyond / soft, -1.0), 1.0)
    return 0.5 - 0.75 * t + 0.25 * t * t * t, 0.75 * (t * t - 1) / soft


@machine_code
def add_means(x: Any, y: Any, disc: Any, form: Any, soft: float, points: int, means: Any) -> None:
    """Mean pressure on every patch and its slopes by the numbers of both, into means (13, patches down, across).

    x, y : mm from the centre, of the points across and down, `points` of them to a patch. disc, form : their numbers,
    (8) and (4). soft : mm, half the width of an edge.
    """
    outer, inner, suction, press = disc[2] / 2, disc[3] / 2, disc[4], disc[5]
    along, across, lobe_along, lobe_across = form
    share = 1.0 / (points * points)
    for i in range(len(y)):
        for j in range(len(x)):
            u = x[j] - along * x[j] - across * y[i]
            v = y[i] - across * x[j] + along * y[i]
            square = max(u * u + v * v, 1e-6)
            radius = sqrt(square)
            if radius > outer + soft:
                continue
            whole, whole_slope = _inside(radius - outer, soft)
            hole, hole_slope = 0.0, 0.0
            if inner > 0:
                hole, hole_slope = _inside(radius - inner, soft)
            twice, cross = (u * u - v * v) / square, 2 * u * v / square  # cos 2θ and sin 2θ
            lean = (disc[6] * u + disc[7] * v) / outer
            level = 1 + lean + lobe_along * twice + lobe_across * cross
            contact = press * (whole - hole)
            outward = press * level * (whole_slope - hole_slope) + suction * hole_slope
            turned = 2 * contact * (lobe_across * twice - lobe_along * cross) / square
            by_u = outward * u / radius + contact * disc[6] / outer - turned * v
            by_v = outward * v / radius + contact * disc[7] / outer + turned * u
            a, b = i // points, j // points
            means[0, a, b] += share * (contact * level + suction * hole)
            means[1, a, b] += share * (by_v * across - by_u * (1 - along))
            means[2, a, b] += share * (by_u * across - by_v * (1 + along))
            means[3, a, b] -= share * (press * level * whole_slope + contact * lean / outer) / 2
            means[4, a, b] += share * (press * level - suction) * hole_slope / 2
            means[5, a, b] += share * hole
            means[6, a, b] += share * (whole - hole) * level
            means[7, a, b] += share * contact * u / outer
            means[8, a, b] += share * contact * v / outer
            means[9, a, b] += share * (by_v * y[i] - by_u * x[j])
            means[10, a, b] -= share * (by_u * y[i] + by_v * x[j])
            means[11, a, b] += share * contact * twice
            means[12, a, b] += share * contact * cross
