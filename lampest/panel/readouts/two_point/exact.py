"""Two-point resistances of cells, by an inverse where it promises its digits and by elimination elsewhere."""

from contextlib import suppress

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.two_point.floating import FloatingNetwork, grounding
from lampest.panel.readouts.two_point.starmesh import exact_two_point_resistance

SAFE_CONDITION = 1e4  # rounding times that leaves 11 digits; ordinary panels have about 3·(rows + columns)


def two_point_resistance(cell_resistance: Array) -> Array:
    """R = f(r): two-point resistances of a panel, (rows, columns) or (frames, rows, columns) ohm → the same shape.

    At least ten digits of every entry are right: where an inverse does not promise them, it is not used, but
    exact_two_point_resistance. That also knows open cells (infinite), shorts (zero) and lines that nothing connects
    (R infinite). Raises ValueError where a cell is negative or no number.
    Source: paper, equations (5)-(10).
    """
    if cell_resistance.ndim == 3:
        return np.stack([two_point_resistance(frame) for frame in cell_resistance])
    if not np.all(cell_resistance >= 0):
        raise ValueError("cell resistances must be zero or positive, and numbers")
    with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
        network = FloatingNetwork.solve(1 / cell_resistance, grounding(cell_resistance))
        if network.condition() <= SAFE_CONDITION:
            return network.reading()
    return exact_two_point_resistance(cell_resistance)
