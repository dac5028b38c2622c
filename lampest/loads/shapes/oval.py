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
    from lampest.loads.shapes.patches import add_means

    means = np.zeros((13, *panel.shape))
    across, down = panel.centres_mm()
    add_means(
        across, down, np.array(disc, dtype=float), np.array(form, dtype=float), patch_mm, SOFT * patch_mm, POINTS, means
    )
    return means[0], means[1:]
