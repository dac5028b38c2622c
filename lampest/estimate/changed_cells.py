"""Selection of the cells that changed between the unloaded panel and a frame.

Log changes d of cells that stand still are N(0, C). Two criteria share C. `selected` counts the cells that must have
moved for the others to stand still, each at the same price, and makes no assumption on how far they moved.
`still_cells` compares likelihoods of changes from N(0, 1), which also determine the size of C.
"""

from collections.abc import Callable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.solvers.preconditioners import Cholesky

# −2 log probability, per cell that is said to move: a cell's gain at random is χ² of one degree, and the largest of
# 400 such exceeds 12 in one case of five.
PRICE = 12.0
FEWEST = 0.3  # of the cells must stand still: else a load covers the panel
MOVED = 2.8  # −2 log of the odds that a cell moved: one in five, and then by about 1 in the logarithm
LINEAR = 0.15  # of log r: so large an error moves cells by more than one per cent beside the straight line
LOADED = 3 * LINEAR  # of log r: so far a load moves a cell, and no error that is small enough for linear theory

Chosen = NDArray[np.bool_]


def mostly_still(moved: NDArray[np.bool_]) -> bool:
    """Whether more than half of the cells are where they were."""
    return 2 * int(moved.sum()) < moved.size


def apart_from_moved(still: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the still cells of all frames, flat, without those that touch one that moved.

    A load does not end at a cell.
    """
    moved = np.pad(~still.reshape(-1, *shape), ((0, 0), (1, 1), (1, 1)))
    apart = still & ~sliding_window_view(moved, (3, 3), axis=(1, 2)).any(axis=(-2, -1)).ravel()
    return apart if apart.mean() >= FEWEST else still


def selected(slope: Array, precision: Array) -> tuple[float, Chosen]:
    """Return the loss and the cells that must have moved, of changes d with −2 log density dᵀ·precision·d − 2 slope·d.

    Cells are taken back that are not needed, from those that one after the other must have moved, and from all.
    """
    _, added = _swept_alone(slope, precision, 1)
    selections = []
    for begun in (added, np.ones(len(slope), dtype=bool)):
        free, moved = np.flatnonzero(begun), np.zeros(len(slope), dtype=bool)
        covariance = np.linalg.inv(precision[np.ix_(free, free)])
        change = covariance @ slope[free]
        lost, tied = _swept_alone(change, covariance, -1)
        moved[free[~tied]] = True
        selections.append((PRICE * int(moved.sum()) + lost - float(slope[free] @ change), moved))
    return min(selections, key=lambda selection: selection[0])


def scores_beside(change: Array, precision: Array, columns: Array) -> Array:
    """Return −2 log evidence with one error more, for each of several; moved cells are only added.

    The change of still cells is d = a θ + noise with θ ~ N(0, 1): the precision P becomes
    P − P a aᵀ P/(1 + aᵀ P a). Compared with no error, −2 log evidence has log(1 + aᵀ P a) more.

    Parameters
    ----------
    change : array, shape (cells,)
    precision : array, shape (cells, cells)
        Of the change without these errors.
    columns : array, shape (cells, errors)
        a of each.
    """
    weighted = (precision @ columns).T
    within = 1 + np.sum(weighted * columns.T, axis=1)
    pulled = weighted @ change / within
    slope = precision @ change - pulled[:, None] * weighted
    size = np.diag(precision) - weighted**2 / within[:, None]

    def column(cells: NDArray[np.intp]) -> Array:
        of_cell = np.take_along_axis(weighted, cells[:, None], axis=1)
        return np.asarray(precision[cells] - of_cell * weighted / within[:, None])

    gained, added = _swept(slope, size, column, 1)
    unexplained = float(change @ precision @ change) - within * pulled**2
    return np.asarray(unexplained + PRICE * added.sum(axis=1) - gained + np.log(within))


def _swept_alone(vector: Array, matrix: Array, sign: int) -> tuple[float, Chosen]:
    """As `_swept`, of a single hypothesis with its whole matrix."""
    total, taken = _swept(vector[None], np.diag(matrix)[None], lambda cells: matrix[cells], sign)
    return float(total[0]), taken[0]


def _swept(
    vector: Array, size: Array, column: Callable[[NDArray[np.intp]], Array], sign: int
) -> tuple[Array, NDArray[np.bool_]]:
    """(Σ v²/M, which) of cells taken one after the other: the largest down to PRICE (sign 1), or the least up to it.

    Parameters
    ----------
    vector : array, shape (hypotheses, cells)
    size : array, shape (hypotheses, cells)
        Diagonal of each hypothesis' matrix M.
    column : callable
        Returns one column of each M, (hypotheses, cells), by the cells' numbers (hypotheses,).
    sign : int
    """
    every, total, taken = np.arange(len(vector)), np.zeros(len(vector)), np.zeros(vector.shape, dtype=bool)
    rows = np.empty((len(vector), 16, vector.shape[1]))  # of the pivoted Cholesky factors of the cells taken
    for number in range(vector.shape[1]):
        worth = vector**2 / np.maximum(size, 1e-300)
        cells = np.argmax(np.where(taken, -np.inf, sign * worth), axis=1)
        largest = worth[every, cells]
        active = ~taken[every, cells] & (sign * (largest - PRICE) >= 0)
        if not active.any():
            break
        total, taken[every[active], cells[active]] = total + np.where(active, largest, 0.0), True
        if number == rows.shape[1]:
            rows = np.concatenate([rows, np.empty_like(rows)], axis=1)
        before = rows[:, :number]
        added = column(cells) - np.matmul(before[every, :, cells][:, None], before)[:, 0]
        pivot = np.where(active, added[every, cells], 1.0)[:, None]
        added = np.where(active[:, None], added, 0.0)
        vector = vector - added * (vector[every, cells][:, None] / pivot)
        rows[:, number] = added / np.sqrt(pivot)
        size = size - rows[:, number] ** 2
    return total, taken


def still_cells(change: Array, covariance: Array, begun: Chosen | None = None) -> tuple[float, Chosen]:
    """(−2 log likelihood, which stand still): each cell where it is likelier, given those that stand still.

    A cell that moved has a change of variance 1, and costs MOVED; one beyond LOADED has. It ends where nothing is
    better than before. begun : the cells that it begins with; None: the half that changed least.
    """
    away = np.abs(change - np.median(change))
    still = (away <= np.median(away)) & (np.abs(change) < LOADED) if begun is None else begun
    best: tuple[float, Chosen] = (np.inf, still)
    while still.any():
        factor = Cholesky.of(change, np.flatnonzero(still), covariance[np.ix_(still, still)])
        if factor is None:
            raise np.linalg.LinAlgError("a covariance is not positive definite")
        root, moved = factor.inverse_root(), change[~still]
        pull, own = root.T @ (root @ change[still]), np.sum(root**2, axis=0)  # C⁻¹ d, diag C⁻¹
        cost = change[still] @ pull - 2 * np.log(np.diag(root)).sum() + (moved**2).sum() + MOVED * len(moved)
        if not cost < best[0]:
            break
        best, across = (float(cost), still), covariance[np.ix_(~still, still)]
        miss, variance = np.empty((2, len(change)))
        miss[still], variance[still] = pull / own, 1 / own
        miss[~still] = moved - across @ pull
        variance[~still] = np.diag(covariance)[~still] - np.sum((root @ across.T) ** 2, axis=0)
        variance = np.maximum(variance, 1e-300)
        still = (miss**2 / variance + np.log(variance) < MOVED + change**2) & (np.abs(change) < LOADED)
    return best
