"""Cells of which no reading of their own tells: how far penalties may be off there."""

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.posterior.interval import LEVEL, TWO_SIDED
from lampest.posterior.linear import LinearModel


def least_widening(model: LinearModel) -> Array:
    """At least C of every penalty row, of those of one estimate; see `lampest.posterior.dense`.

    The largest of 1 and ω x̂²/s². An estimate obeys a penalty on a cell that was not read as if it were true, so that x̂
    tells nothing there: such a row may be as far off as 95 % of its term's other rows are, which loads make far.
    """
    squares = model.penalty_squares
    widened = np.maximum(1.0, squares)
    if (unread := unread_rows(model)) is None:
        return widened
    for number in np.unique(model.penalty_term):
        own = model.penalty_term == number
        if (others := own & ~unread).any():
            far = np.quantile(squares[others], LEVEL, method="higher") / TWO_SIDED**2
            widened[own & unread] = np.maximum(widened[own & unread], far)
    return widened


def unread_rows(model: LinearModel) -> NDArray[np.bool_] | None:
    """Which penalty rows speak of a cell that was not read; None where every cell was."""
    cells = np.zeros(model.at.cell_resistance.size)
    cells[model.free[model.unread]] = 1.0
    return np.asarray(abs(model.penalty_jacobian) @ cells > 0) if cells.any() else None
