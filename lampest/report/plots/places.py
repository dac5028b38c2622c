"""Cells at places of their own: patches, an outline round all of them, and contours inside it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, Colormap, Normalize
from matplotlib.tri import Triangulation

from lampest.panel.panel import Array, Panel

OUTLINE = 0.15  # of a patch: the width of the outline
NEAR = 1.5  # pitches: the diagonal of a square and its rounding; between cells farther apart nothing was measured
EMPTY = "0.85"


def draw_patches(axes: Axes, panel: Panel, values: Array, norm: Normalize, colours: Colormap, contoured: bool) -> None:
    """Values (rows, columns) as squares of the pitch, as the lattice lies; contours where cells are neighbours."""
    places = panel.places_mm[:, panel.present].T
    corners = squares(panel)
    centres = places[:, None]
    wide = centres + (1 + 2 * OUTLINE) * (corners - centres)
    axes.add_collection(PolyCollection(list(wide), facecolors="0.25", edgecolors="none", zorder=0.5))
    shown = values[panel.present]
    patches = PolyCollection(list(corners), norm=norm, cmap=colours.with_extremes(bad=EMPTY), edgecolors="face", lw=0.2)
    patches.set_array(np.ma.masked_invalid(shown))
    axes.add_collection(patches)
    if contoured and isinstance(norm, BoundaryNorm) and np.isfinite(shown).all():
        _contours(axes, panel, places, shown, norm, colours)


def squares(panel: Panel) -> Array:
    """(cells, 4, 2) corners in millimetre: each square along the way to the cell's nearest neighbour."""
    places = panel.places_mm[:, panel.present].T
    number = np.cumsum(panel.present.ravel()) - 1
    first, second, distance = panel.neighbours
    way, nearest = np.tile([1.0, 0.0], (len(places), 1)), np.full(len(places), np.inf)
    for one, other, apart in zip(number[first], number[second], distance, strict=True):
        for here, there in ((one, other), (other, one)):
            if apart < nearest[here]:
                way[here], nearest[here] = (places[there] - places[here]) / (apart * panel.pitch_mm), apart
    across = np.stack([-way[:, 1], way[:, 0]], axis=1)
    half = panel.pitch_mm / 2
    return np.stack([places + half * (a * way + b * across) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], axis=1)


def _contours(axes: Axes, panel: Panel, places: Array, shown: Array, norm: BoundaryNorm, colours: Colormap) -> None:
    """Bands over triangles whose corners are near each other."""
    if np.linalg.matrix_rank(places - places.mean(axis=0)) < 2:
        return
    mesh = Triangulation(*places.T)
    sides = places[mesh.triangles] - places[np.roll(mesh.triangles, 1, axis=1)]
    mesh.set_mask(np.hypot(*sides.T).T.max(axis=1) > NEAR * panel.pitch_mm)
    if mesh.mask is not None and mesh.mask.all():
        return
    beyond = 1.1 * norm.boundaries[-1]
    look: dict[str, Any] = {"cmap": colours, "norm": norm, "extend": "both"}
    axes.tricontourf(mesh, np.clip(shown, -beyond, beyond), norm.boundaries, **look)
