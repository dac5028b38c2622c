"""How much of a square patch a circle covers, and its first moments there: closed forms with their derivatives.

All follow from the part of the unit disc that lies left of X = x and below Y = y:

    area    F(x, y) = ∫_{−1}^{x} [clip(y, −h, h) + h] dX,  h = √(1 − X²),  ∂F/∂x = clip(y, −h, h) + h at X = x
    moment  K(x, y) = ∫ X dA = ½ [(x² − 1) Y + Y³/3] between Y = −k and clip(y, −k, k),  k = √(1 − x²)

A patch is the alternating sum over its corners. The derivatives by the radius follow from homogeneity:
r ∂A/∂r = 2A − x ∂A/∂x − y ∂A/∂y for areas, with 3 in place of 2 for moments.
"""

from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array, Panel


@dataclass(frozen=True, eq=False)
class Cover:
    """What concentric circles about (x, y) cover of every patch.

    values : (circles, 3, rows, columns) share of the patch, and mean over the patch of (X − x, Y − y) inside, in mm.
    slopes : (3, circles, 3, rows, columns) their derivatives by x, y and the circle's own diameter.
    """

    values: Array
    slopes: Array


def cover(panel: Panel, patch_mm: float, centre_mm: tuple[float, float], diameters_mm: tuple[float, ...]) -> Cover:
    """Share and first moments of every square patch of edge `patch_mm` under circles: exact, not sampled."""
    shape = (len(diameters_mm), 3, *panel.shape)
    values, slopes = np.zeros(shape), np.zeros((3, *shape))
    radius, half = np.array(diameters_mm) / 2, patch_mm / 2
    windows, sides = [], []
    for centres, middle in zip(panel.centres_mm(), centre_mm, strict=True):
        near = np.flatnonzero(np.abs(centres - middle) < radius.max() + half)
        if len(near) == 0:
            return Cover(values, slopes)
        windows.append(slice(near[0], near[-1] + 1))
        edges = centres[near] - middle
        sides.append(np.stack([edges - half, edges + half], axis=1).reshape(1, -1) / radius[:, None])
    x, y = sides[0][:, None, :], sides[1][:, :, None]
    parts = np.empty((9, len(radius), y.shape[1], x.shape[2]))
    _corners(x, y, parts)
    window = (..., windows[1], windows[0])
    power = (radius ** np.array([[1.0], [2.0], [2.0]]) / patch_mm**2)[:, :, None, None]
    value, by_x, by_y = parts[0:3], parts[3:6], parts[6:9]
    by_radius = np.array([2.0, 3.0, 3.0])[:, None, None, None] * value - x * by_x - y * by_y
    values[window] = _patches(value * (power * radius[:, None, None])).swapaxes(0, 1)
    for number, part in enumerate((-by_x, -by_y, by_radius / 2)):
        slopes[number][window] = _patches(part * power).swapaxes(0, 1)
    return Cover(values, slopes)


def _patches(corners: Array) -> Array:
    """Upper minus lower and right minus left edge: (…, 2 rows, 2 columns) → (…, rows, columns)."""
    rows = corners[..., 1::2, :] - corners[..., ::2, :]
    patches: Array = rows[..., 1::2] - rows[..., ::2]
    return patches


def _corners(x: Array, y: Array, out: Array) -> None:
    """F, K(x, y), K(y, x), then the derivatives of the three by x, then by y: into (9, circles, y, x)."""
    h, w = _chord(x), _chord(y)  # half the chord at X = x, and at Y = y
    top, right = np.maximum(np.minimum(y, h), -h), np.maximum(np.minimum(x, w), -w)
    half_x = _half(x)
    # Beyond −w and w the line Y = y runs outside the disc: there clip(y, −h, h) is ±h.
    outside = np.where(x < -w, half_x, _half(-w)) + np.where(x > w, half_x - _half(w), 0.0)
    out[0] = half_x + np.sign(y) * outside + y * (right + w)
    out[1] = (np.abs(x) < 1) * ((x * x - 1) * (top + h) + (top**3 + h**3) / 3) / 2
    out[2] = (np.abs(y) < 1) * ((y * y - 1) * (right + w) + (right**3 + w**3) / 3) / 2
    out[3] = top + h
    out[4] = x * out[3]
    out[5] = (top * top - h * h) / 2
    out[6] = right + w
    out[7] = (right * right - w * w) / 2
    out[8] = y * out[6]


def _chord(x: Array) -> Array:
    """√(1 − x²), and 0 outside."""
    return np.sqrt(np.maximum(1 - x * x, 0))


def _half(x: Array) -> Array:
    """∫_{−1}^{x} √(1 − X²) dX, any shape."""
    x = np.maximum(np.minimum(x, 1.0), -1.0)
    return (x * _chord(x) + np.arcsin(x)) / 2 + np.pi / 4
