"""The convex start of a frame.

The start minimises a convex function of the cells whose gradient is the misfit of two-point
readings. Where cells can reproduce all readings, the start is the solution of plain least squares,
see `convex_start`.
"""

from contextlib import suppress

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.files.errors import BROKEN
from lampest.panel.panel import Array


def convex_is_the_answer(cost: Cost, data: Data) -> bool:
    """Return whether the cost is plain least squares of readings with a unique inverse.

    The convex start minimises such a cost.
    """
    return all(term.reads_measurement for term in cost.terms) and data.readout.unique


def convex_cells(data: Data, near: Array | None) -> Array:
    """Return the readout's start of every frame, (frames, rows, columns) ohm.

    The start of two-point readings is the convex one. `near` is an estimate of the same shape at
    which the computation begins, or None. If the computation breaks down, the uniform start is
    returned.
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
    """Return the evaluation at the convex start where it minimises the cost, else `start`."""
    if not convex_is_the_answer(start.cost, start.data):
        return start
    cells = convex_cells(start.data, start.cell_resistance)
    return start.elsewhere(np.clip(cells, start.data.lower, start.data.upper))
