"""How few cells must have moved between two frames: what tells circuits apart that all explain each frame.

A circuit with as many cells as readings explains nearly every single frame. Two frames say more: a load touches some
cells, and under the right circuit all others stand still, within the noise. Under a wrong one, cells that nobody
touched seem to move with the load. So many cells as must move for the rest to stand still are counted, each for a
price.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.model_check.cells_fit import CellsFit
from lampest.panel.panel import Array

# −2 log probability, per cell that is said to move: what a cell gains at random is χ² of one degree, and the largest of
# 400 such exceeds 12 in one case of five.
PRICE = 12.0
CREEPS = (0.0, 3e-3)  # of log r, by which cells may move on their own: not at all, or as films creep in seconds


def moved_score(resting: CellsFit, frame: CellsFit) -> tuple[float, NDArray[np.bool_]]:
    """(min over sets S of χ²(the cells outside S stand still) + PRICE·|S| + log det, S) of two fits of one circuit.

    The change of all cells together (temperature, supply) is taken off. log det is that of the covariance of the change
    against the frame's own: −2 log density of the frame's readings, so that a circuit gains nothing by being blind.
    """
    change = np.log(frame.cells / resting.cells).ravel()
    change = change - np.median(change)
    own = np.linalg.inv(frame.information)
    together = own + np.linalg.inv(resting.information)
    least = float(np.linalg.slogdet(frame.information)[1])
    best = (np.inf, np.ones(resting.cells.shape, dtype=bool))
    for creep in CREEPS:
        covariance = together + creep**2 * np.eye(len(change))
        precision = np.linalg.inv(covariance)
        gained, moved = _released(precision @ change, precision)
        chi_square = float(change @ precision @ change) - gained
        score = chi_square + PRICE * int(moved.sum()) + float(np.linalg.slogdet(covariance)[1]) + least
        best = (score, moved.reshape(resting.cells.shape)) if score < best[0] else best
    return best


def released(slope: Array, precision: Array) -> NDArray[np.bool_]:
    """Cells that must have moved, of changes d with −2 log density dᵀ·precision·d − 2 slope·d: the better of two ways.

    Forward, one after the other is released while it gains more than its PRICE, and what then gains less beside the
    others is tied again: among changes that readings hardly tell apart the first to go is often one between those that
    moved. Backward, one after the other is tied while that loses less than its PRICE.
    """
    forward = _tied(slope, precision, _released(slope, precision)[1])
    backward = _tied(slope, precision, np.ones(len(slope), dtype=bool))
    return min((forward, backward), key=lambda one: one[0])[1]


def _tied(slope: Array, precision: Array, moved: NDArray[np.bool_]) -> tuple[float, NDArray[np.bool_]]:
    """(−2 log density and prices, moved cells): cells are tied while one of them loses less than its PRICE.

    To tie cell c loses d_c²/C_cc, with the covariance C of those that are free; d and C are then those of the others.
    """
    free = np.flatnonzero(moved)
    covariance = np.linalg.inv(precision[np.ix_(free, free)])
    change = covariance @ slope[free]
    gained, held = float(slope[free] @ change), np.zeros(len(free), dtype=bool)
    while not held.all():
        loss = np.where(held, np.inf, change**2 / np.maximum(np.diag(covariance), 1e-300))
        cell = int(np.argmin(loss))
        if loss[cell] >= PRICE:
            break
        gained, held[cell] = gained - loss[cell], True
        column = covariance[:, cell] / covariance[cell, cell]
        change = change - column * change[cell]
        covariance = covariance - np.outer(column, covariance[cell])
    left = np.zeros(len(slope), dtype=bool)
    left[free[~held]] = True
    return PRICE * int(left.sum()) - gained, left


def _released(slope: Array, precision: Array) -> tuple[float, NDArray[np.bool_]]:
    """(χ² that is gained, released cells): cells are released while one of them gains more than its PRICE.

    To release cell c gains slope_c²/P_cc; slope and P are then those of the others alone (sweep operator).
    """
    precision, slope = precision.copy(), slope.copy()
    gained, held = 0.0, np.ones(len(slope), dtype=bool)
    while held.any():
        gain = np.where(held, slope**2 / np.maximum(np.diag(precision), 1e-300), 0.0)
        cell = int(np.argmax(gain))
        if gain[cell] < PRICE:
            break
        gained, held[cell] = gained + gain[cell], False
        column = precision[:, cell] / precision[cell, cell]
        slope = slope - column * slope[cell]
        precision -= np.outer(column, precision[cell])
    return gained, ~held
