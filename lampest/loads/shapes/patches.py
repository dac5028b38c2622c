"""The pressure of a disc at points of patches, added up patch by patch in machine code.

Imported where a shape is fitted, and not before: numba takes half a second to come.
"""

from math import sqrt
from typing import Any

import numpy as np

from lampest.panel.machine import machine_code


@machine_code
def _inside(beyond: float, soft: float) -> tuple[float, float]:
    """1 where −`beyond` is above `soft`, 0 where it is below −`soft`, ½ − ¾t + ¼t³ between; and its slope."""
    t = min(max(beyond / soft, -1.0), 1.0)
    return 0.5 - 0.75 * t + 0.25 * t * t * t, 0.75 * (t * t - 1) / soft


@machine_code
def _add_mean(x: Any, y: Any, disc: Any, form: Any, soft: float, mean: Any) -> None:
    """Mean pressure on one patch and its slopes, into mean (13) of zeros; x, y : mm from the centre, of its points."""
    outer, inner, suction, press = disc[2] / 2, disc[3] / 2, disc[4], disc[5]
    along, across, lobe_along, lobe_across = form
    share = 1.0 / (len(x) * len(y))
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
            mean[0] += share * (contact * level + suction * hole)
            mean[1] += share * (by_v * across - by_u * (1 - along))
            mean[2] += share * (by_u * across - by_v * (1 + along))
            mean[3] -= share * (press * level * whole_slope + contact * lean / outer) / 2
            mean[4] += share * (press * level - suction) * hole_slope / 2
            mean[5] += share * hole
            mean[6] += share * (whole - hole) * level
            mean[7] += share * contact * u / outer
            mean[8] += share * contact * v / outer
            mean[9] += share * (by_v * y[i] - by_u * x[j])
            mean[10] -= share * (by_u * y[i] + by_v * x[j])
            mean[11] += share * contact * twice
            mean[12] += share * contact * cross


@machine_code
def add_means(across: Any, down: Any, disc: Any, form: Any, patch: float, soft: float, points: int, means: Any) -> None:
    """Mean pressure on every patch and its slopes by the numbers of both, into means (13, rows, columns) of zeros.

    across, down : mm, the centres of the patches. disc, form : their numbers, (8) and (4). patch : mm, edge of the
    patches, with `points` points along either. soft : mm, half the width of an edge.
    """
    reach = disc[2] / 2 * (1 + abs(form[0]) + abs(form[1])) + patch / 2 + soft
    offset = ((np.arange(points) + 0.5) / points - 0.5) * patch
    for a in range(len(down)):
        if abs(down[a] - disc[1]) < reach:
            for b in range(len(across)):
                if abs(across[b] - disc[0]) < reach:
                    x, y = across[b] + offset - disc[0], down[a] + offset - disc[1]
                    _add_mean(x, y, disc, form, soft, means[:, a, b])
