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
        chi_square, moved = _released(change, np.linalg.inv(covariance))
        score = chi_square + PRICE * int(moved.sum()) + float(np.linalg.slogdet(covariance)[1]) + least
        best = (score, moved.reshape(resting.cells.shape)) if score < best[0] else best
    return best


def _released(change: Array, precision: Array) -> tuple[float, NDArray[np.bool_]]:
    """(χ² of what is left, released cells): cells are released while one of them gains more than its PRICE.

    change (cells), precision (cells, cells). To release cell c gains g_c²/P_cc with g = P·change; P and g are then
    those of the others alone (sweep operator).
    """
    precision, slope = precision.copy(), precision @ change
    chi_square, held = float(change @ slope), np.ones(len(change), dtype=bool)
    while held.any():
        gain = np.where(held, slope**2 / np.maximum(np.diag(precision), 1e-300), 0.0)
        cell = int(np.argmax(gain))
        if gain[cell] < PRICE:
            break
        chi_square, held[cell] = chi_square - gain[cell], False
        column = precision[:, cell] / precision[cell, cell]
        slope = slope - column * slope[cell]
        precision -= np.outer(column, precision[cell])
    return chi_square, ~held
