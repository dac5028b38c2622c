"""The mean pressure of a disc over square patches, point by point, with its slopes by the disc's numbers."""

import numpy as np

from lampest.panel.panel import Array


def patch_means(across: Array, down: Array, disc: Array, form: Array, patch: float, soft: float, points: int) -> Array:
    """(13, rows, columns): mean pressure on every patch and its slopes by the numbers of `disc` and `form`.

    across, down : mm, the centres of the patches. disc, form : their numbers, (8) and (4). patch : mm, edge of the
    patches, with `points` points along either. soft : mm, half the width of an edge. Patches out of reach hold zero.
    """
    reach = disc[2] / 2 * (1 + abs(form[0]) + abs(form[1])) + patch / 2 + soft
    columns, rows = (np.flatnonzero(np.abs(places - disc[n]) < reach) for n, places in ((0, across), (1, down)))
    means = np.zeros((13, len(down), len(across)))
    if not (len(columns) and len(rows)):
        return means
    offset = ((np.arange(points) + 0.5) / points - 0.5) * patch
    x = (across[columns, None] - disc[0] + offset).ravel()[None]
    y = (down[rows, None] - disc[1] + offset).ravel()[:, None]
    values = _at_points(x, y, disc, form, soft)
    shape = (13, len(rows), points, len(columns), points)
    means[:, rows[:, None], columns] = np.broadcast_to(values, (13, y.size, x.size)).reshape(shape).mean(axis=(2, 4))
    return means


def _at_points(x: Array, y: Array, disc: Array, form: Array, soft: float) -> Array:
    """(13, y, x) pressure and its slopes at points x (1, n) and y (n, 1), mm from the centre."""
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
