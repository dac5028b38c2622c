"""The four-point inequality of two-point resistances, which are distances: R_jk ≤ R_jq + R_pq + R_pk.

From row j over column q and row p to column k no way is shorter than the direct one. Source: effective resistance is a
metric (Klein & Randić, J. Math. Chem. 12, 1993), applied three times.
"""

import numpy as np

from lampest.panel.panel import Array


def four_point_excess(resistance: Array, sigma: Array) -> Array:
    """max_jkpq (R_jk − R_jq − R_pq − R_pk)/σ of all four, (frames); resistance, σ (frames, rows, columns) ohm.

    The shortest way over any q from row j to row p is taken before the shortest over any p, (rows² · columns) sums. A
    reading with infinite σ takes no part.
    """
    return np.array([_excess(*frame) for frame in zip(resistance, sigma, strict=True)])


def _excess(resistance: Array, sigma: Array) -> float:
    """Of one frame (rows, columns)."""
    value = np.where(np.isfinite(sigma), resistance, np.inf)
    variance = np.where(np.isfinite(sigma), sigma, 0.0) ** 2
    rows, columns = value.shape
    between, spread = np.empty((rows, rows)), np.empty((rows, rows))
    for row in range(rows):
        over = value[row] + value
        middle = over.argmin(axis=1)
        between[row] = over[np.arange(rows), middle]
        spread[row] = variance[row, middle] + variance[np.arange(rows), middle]
    worst = -np.inf
    for row in range(rows):
        way = between[row][:, None] + value
        over = way.argmin(axis=0)
        chosen = over, np.arange(columns)
        noise = np.sqrt(variance[row] + spread[row, over] + variance[chosen])
        counted = np.isfinite(value[row]) & np.isfinite(way[chosen]) & (noise > 0)
        worst = max(worst, float(((value[row] - way[chosen])[counted] / noise[counted]).max(initial=-np.inf)))
    return worst
