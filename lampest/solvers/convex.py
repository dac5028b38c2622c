"""The convex start.

It is the cells that minimise a convex function whose gradient is the misfit of two-point readings.
Of plain least squares it is the answer wherever cells can reproduce all readings, see
`convex_start`.
"""

from contextlib import suppress

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.files.errors import BROKEN
from lampest.panel.panel import Array


def convex_is_the_answer(cost: Cost, data: Data) -> bool:
    """Return whether the convex start minimises the cost.

    It does for plain least squares of readings with a unique inverse.
    """
    return all(term.reads_measurement for term in cost.terms) and data.readout.unique


def convex_cells(data: Data, near: Array | None) -> Array:
    """Return the readout's start of every frame, (frames, rows, columns) ohm.

    Of two-point readings it is the convex one. `near` is an estimate of the same shape from which
    it is computed, or None. If the computation breaks down, the uniform start is returned.
    """
    places = [None] * len(data.measured) if near is None else list(near)
    with suppress(*BROKEN):
        return np.stack(
            [
                data.readout.start(*frame)
                for frame in zip(data.measured, data.upper, places, strict=True)
            ]
        )
    return data.uniform_start


def by_convex_program(start: Evaluation) -> Evaluation:
    """Return the point at the convex start near a point, where that minimises the cost.

    Else the same point is returned.
    """
    if not convex_is_the_answer(start.cost, start.data):
        return start
    cells = convex_cells(start.data, start.cell_resistance)
    return start.elsewhere(np.clip(cells, start.data.lower, start.data.upper))
