"""Two-point resistances of cells, by an inverse where it promises its digits, else by star–mesh elimination.

Symbols: w (networks, lines, lines) conductances between lines in siemens; their diagonals are never read.
"""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from lampest.files.typed import typed
from lampest.panel.panel import Array
from lampest.panel.readouts.floating import FloatingNetwork, grounding

Index = NDArray[np.intp]
SAFE_CONDITION = 1e4  # rounding times that leaves 11 digits; ordinary panels have about 3·(rows + columns)


@typed
def two_point_resistance(cell_resistance: Array) -> Array:
    """R = f(r): two-point resistances of a panel, (rows, columns) or (frames, rows, columns) ohm → the same shape.

    At least ten digits of every entry are right; see `exact_two_point_resistance`, also for open cells and shorts.
    Raises ValueError where a cell is negative or no number. Source: paper, equations (5)-(10).

    >>> lampest.two_point_resistance(np.full((2, 2), 1000.0)).round(6)
    array([[750., 750.],
           [750., 750.]])
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


def exact_two_point_resistance(cell_resistance: Array) -> Array:
    """R = f(r) with all but the last one or two digits right in every entry, whatever the contrast of the cells.

    (rows, columns) or (frames, rows, columns) ohm → the same shape. A cell of infinite resistance is open and one of
    zero is a short; lines that nothing connects have R = inf, lines that shorts connect have R = 0.
    Removing a line s leaves w_ab + w_as·w_sb/Σ_c w_sc between the others, without a subtraction; of the last two it
    leaves 1/R. Half of the lines of one side are removed, in turn each half, then likewise among those that are left:
    all pairs cost a small multiple of (rows + columns)³. Raises ValueError where a cell is negative or no number.
    Source: Alfa, Xue, Ye, Mathematics of Computation 71 (2002), after Grassmann, Taksar, Heyman (1985).
    """
    if not np.all(cell_resistance >= 0):
        raise ValueError("cell resistances must be zero or positive, and numbers")
    if cell_resistance.ndim == 3:
        return np.stack([exact_two_point_resistance(frame) for frame in cell_resistance])
    rows, columns = cell_resistance.shape
    resistance = np.empty((rows, columns))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        weights = np.zeros((1, rows + columns, rows + columns))
        weights[0, :rows, rows:] = 1 / cell_resistance
        weights[0, rows:, :rows] = weights[0, :rows, rows:].T
        between, row, column = _all_pairs(weights, rows)
        resistance[row, column] = 1 / between
    return resistance


def _all_pairs(weights: Array, rows: int) -> tuple[Array, Index, Index]:
    """Conductance between every row and every column once all other lines are removed, with their numbers; all 1-d.

    weights : (1, lines, lines), rows first.
    """
    lines, first_column = np.arange(weights.shape[1])[None], rows
    shorted = bool(np.any(np.isinf(weights)))
    while weights.shape[1] > 2:
        columns = weights.shape[1] - rows
        first, size = (0, rows) if rows >= columns else (rows, columns)
        half = size - size // 2
        places = np.arange(first, first + size)
        opposite = np.setdiff1d(np.arange(rows + columns), places)
        # Both halves are as large: of an odd number of lines the one in the middle is in either.
        parts = []
        for stay, go in ((places[:half], places[half:]), (places[-half:], places[:-half])):
            order = np.concatenate([stay, opposite, go] if first == 0 else [opposite, stay, go])
            parts.append((weights[:, order[:, None], order], lines[:, order]))
        weights = _without_last(np.concatenate([part for part, _ in parts]), size // 2, shorted=shorted)
        lines = np.concatenate([part for _, part in parts])[:, : weights.shape[1]]
        rows = half if first == 0 else rows
    return weights[:, 0, 1], lines[:, 0], lines[:, 1] - first_column


def _without_last(weights: Array, count: int, *, shorted: bool) -> Array:
    """Return the networks without their last `count` lines; `weights` is overwritten."""
    for last in range(weights.shape[1] - 1, weights.shape[1] - 1 - count, -1):
        spokes, mesh = weights[:, last, :last], weights[:, :last, :last]
        total = spokes.sum(axis=1, keepdims=True)
        share = np.divide(spokes, total, out=np.zeros_like(spokes), where=total > 0)
        if not shorted:
            mesh += spokes[:, :, None] * share[:, None, :]
            continue
        # The limit of one large conductance for all shorts: they share all incoming current.
        endless = np.isinf(spokes)
        among = endless / np.maximum(endless.sum(axis=1, keepdims=True), 1)
        share = np.where(np.isinf(total), among, share)
        gain = spokes[:, :, None] * share[:, None, :]
        mesh += np.fmax(gain, gain.transpose(0, 2, 1))
    return weights[:, : weights.shape[1] - count, : weights.shape[1] - count]
