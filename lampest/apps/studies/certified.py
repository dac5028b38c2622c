"""Certified values: 50-digit arithmetic, and a second test of optimality.

The module shares no code with the solvers.
"""

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lampest.cost.cost import Cost
from lampest.cost.problem import NO_DUAL, Data, Evaluation
from lampest.files.errors import extra
from lampest.panel.panel import Array
from lampest.panel.readouts.floating import exact_two_point_resistance


def correct_digits(values: Array, certified: Array) -> float:
    """Return the number of correct digits, LRE = −log10(|values − certified|/|certified|).

    The worst entry counts, from 0 to 15. Entries that are infinite or zero in both are right; NaN
    if anything is NaN. Source: NIST StRD.
    """
    if np.any(np.isnan(values)) or np.any(np.isnan(certified)):
        return float("nan")
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        error = np.where(values == certified, 0.0, np.abs(values / certified - 1))
        worst = float(np.max(np.where(np.isnan(error), np.inf, error), initial=0.0))
        return float(np.clip(-np.log10(worst), 0.0, 15.0))


def fifty_digit_library() -> Any:
    """Return mpmath. Raises InputError if it is not installed."""
    with extra("extremes"):
        import mpmath
    return mpmath


def fifty_digits(cells: Array) -> Array:
    """Return R = f(r), (rows, columns) ohm, with 50 digits.

    Infinite cells are open, zeros are shorts. Unconnected lines have R = inf. Raises InputError if
    mpmath is not installed.
    """
    mpmath = fifty_digit_library()
    rows, columns = cells.shape
    conducting = coo_array(np.isfinite(cells))
    lines = (conducting.row, rows + conducting.col)
    graph = coo_array((conducting.data, lines), shape=(rows + columns,) * 2)
    part = connected_components(graph, directed=False)[1]
    resistance = np.where(cells == 0, 0.0, np.inf)
    with mpmath.workdps(50):
        # A tie of each part's first line to ground carries no current; a short stands for 10⁻²⁵
        # ohm.
        matrix = mpmath.diag(
            [int(line == np.argmax(part == part[line])) for line in range(rows + columns)]
        )
        for first, second in zip(*lines, strict=True):
            ohm = float(cells[first, second - rows])
            conductance = 1 / mpmath.mpf(ohm) if ohm else mpmath.mpf(10) ** 25
            for j, k in ((first, second), (second, first)):
                matrix[j, j] += conductance
                matrix[j, k] -= conductance
        inverse = mpmath.inverse(matrix)
        for first, second in np.argwhere((part[:rows, None] == part[rows:]) & (cells > 0)):
            k = rows + second
            resistance[first, second] = float(
                inverse[first, first] + inverse[k, k] - 2 * inverse[first, k]
            )
    return resistance


def exact_cost(cost: Cost, data: Data, cells: Array, two_point: Array | None = None) -> float:
    """Return φ(r) with f(r) by elimination without subtractions.

    Cells have the shape (frames, rows, columns), in ohm.
    """
    two_point = exact_two_point_resistance(cells) if two_point is None else two_point
    at = Evaluation(cost, data, cells, two_point, ())
    return at.objective


def exact_scale(cost: Cost, data: Data, cells: Array) -> float:
    """Return the scale of costs and gradients: φ at f(r) = 0 per cell + φ(r)."""
    blank = exact_cost(cost, data, cells, np.zeros_like(cells))
    return (blank / cells.size + exact_cost(cost, data, cells)) or 1.0


def exact_residual(cost: Cost, data: Data, cells: Array) -> float:
    """Return max |u − Π(u − ∇φ/s)| as `Evaluation.kkt_residual`.

    ∂R/∂u is by central differences in u = log r. Of the package's derivatives only those of the
    terms are used. Not for absolute losses. The rounding error of u in the terms' part is
    subtracted: under a penalty of 10¹² no u in double precision is closer to an optimum.
    """
    step = 1e-4
    readings = exact_two_point_resistance(cells)
    direct, through = Evaluation(cost, data, cells, readings, ()).partials(NO_DUAL)
    slope = direct * cells
    odd = np.indices(cells.shape).sum(axis=0) % 2 == 1
    neighbours = cells * np.exp(np.where(odd, 1, -1) * np.spacing(np.abs(np.log(cells))))
    blur = np.abs(
        Evaluation(cost, data, neighbours, readings, ()).partials(NO_DUAL)[0] * neighbours - slope
    )
    for place in np.ndindex(cells.shape):
        sides = []
        for factor in (np.exp(step), np.exp(-step)):
            moved = cells[place[0]].copy()
            moved[place[1:]] *= factor
            sides.append(exact_two_point_resistance(moved))
        slope[place] += np.sum(through[place[0]] * (sides[0] - sides[1])) / (2 * step)
    # ∂φ/∂u = ∂φ/∂r · r + Σ ∂φ/∂R · ΔR/(2h), less the rounding error of u in the first part
    slope = np.sign(slope) * np.maximum(np.abs(slope) - blur, 0.0)
    position = np.log(cells)
    return float(
        np.max(
            np.abs(
                position
                - np.clip(position - slope / exact_scale(cost, data, cells), *data.log_bounds)
            )
        )
    )
