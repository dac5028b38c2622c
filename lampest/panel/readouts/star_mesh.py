"""Two-point resistances of cells, by an inverse if its condition allows, otherwise by star–mesh elimination.

Symbols: w (networks, lines, lines) conductances between lines in siemens; their diagonals are not used.
"""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from lampest.files.typed import typed
from lampest.panel.panel import Array
from lampest.panel.readouts.floating import FloatingNetwork, grounding

Index = NDArray[np.intp]
SAFE_CONDITION = 1e4  # amplification of rounding that leaves 11 digits; usual panels have about 3·(rows + columns)


@typed
def two_point_resistance(cell_resistance: Array) -> Array:
    """Return the two-point resistances R = f(r) of a panel, (rows, columns) or (frames, rows, columns) ohm.

    Input and result have the same shape.

    At least ten digits of every entry are correct. Open cells and shorts are allowed; see
    `exact_two_point_resistance`. Raises ValueError if a cell is negative or NaN. Source: paper, equations (5)-(10).

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
    """Return R = f(r) with all but the last one or two digits correct in every entry, for any contrast of the cells.

    Input and result are (rows, columns) or (frames, rows, columns) ohm. A cell of infinite resistance is open, one of
    zero resistance is a short. Lines without a connection have R = inf, lines that shorts connect have R = 0.

    Star–mesh elimination of a line s leaves w_ab + w_as·w_sb/Σ_c w_sc between the others, without a subtraction. The
    conductance between the last two lines is 1/R. All pairs are obtained by recursion: one half of the lines of a side
    is eliminated, and in a copy the other half. The cost is a small multiple of (rows + columns)³. Raises ValueError if
    a cell is negative or NaN. Source: Alfa, Xue, Ye, Mathematics of Computation 71 (2002), after Grassmann, Taksar,
    Heyman (1985).
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
    """Return the conductances between every row and every column after elimination of all other lines.

    Parameters
    ----------
    weights : array, shape (1, lines, lines)
        Conductances between lines, rows first.
    rows : int
        Number of rows.

    Returns
    -------
    conductance : array, shape (pairs,)
    row, column : array of int, shape (pairs,)
        Numbers of the two lines of each pair.
    """
    lines, first_column = np.arange(weights.shape[1])[None], rows
    shorted = bool(np.any(np.isinf(weights)))
    while weights.shape[1] > 2:
        columns = weights.shape[1] - rows
        first, size = (0, rows) if rows >= columns else (rows, columns)
        half = size - size // 2
        places = np.arange(first, first + size)
        opposite = np.setdiff1d(np.arange(rows + columns), places)
        # Both halves have the same size: for an odd number of lines, the middle one stays in both.
        parts = []
        for stay, go in ((places[:half], places[half:]), (places[-half:], places[:-half])):
            order = np.concatenate([stay, opposite, go] if first == 0 else [opposite, stay, go])
            parts.append((weights[:, order[:, None], order], lines[:, order]))
        weights = _without_last(np.concatenate([part for part, _ in parts]), size // 2, shorted=shorted)
        lines = np.concatenate([part for _, part in parts])[:, : weights.shape[1]]
        rows = half if first == 0 else rows
    return weights[:, 0, 1], lines[:, 0], lines[:, 1] - first_column


def _without_last(weights: Array, count: int, *, shorted: bool) -> Array:
    """Return the networks after star–mesh elimination of their last `count` lines; `weights` is overwritten."""
    for last in range(weights.shape[1] - 1, weights.shape[1] - 1 - count, -1):
        spokes, mesh = weights[:, last, :last], weights[:, :last, :last]
        # w_ab += w_as·w_sb/Σ_c w_sc
        total = spokes.sum(axis=1, keepdims=True)
        share = np.divide(spokes, total, out=np.zeros_like(spokes), where=total > 0)
        if not shorted:
            mesh += spokes[:, :, None] * share[:, None, :]
            continue
        # Shorts are the limit of one large conductance: all current of the line divides equally among them.
        endless = np.isinf(spokes)
        among = endless / np.maximum(endless.sum(axis=1, keepdims=True), 1)
        share = np.where(np.isinf(total), among, share)
        gain = spokes[:, :, None] * share[:, None, :]
        mesh += np.fmax(gain, gain.transpose(0, 2, 1))
    return weights[:, : weights.shape[1] - count, : weights.shape[1] - count]
