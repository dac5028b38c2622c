"""What conjugate gradients are preconditioned with, in machine code: terms, cells and lines."""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.algebra import add_matrix, band_factored, product_into, symmetric_divided

LEAST_SHARE = 0.05  # of a cell's own response, as in the two-point stencil


@machine_code
def _own_slopes(rows: int, model: Any, impedance: Any, ties: Any) -> Any:
    """(own, lines): −∂y/∂g of every cell's own reading (cells), and of a line's readings by its other cells (lines).

    Where all else stands alike, a current into a line of total conductance A, with its tie, moves that by 1/A.
    """
    cells, lines = model.shape[1], len(impedance)
    columns = lines - rows
    own, total, slope = np.empty(cells), ties.copy(), np.zeros(lines)
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        own[cell] = _slope(rows, model, impedance, cell, cell)
        total[j] += model[0, cell]
        total[k] += model[0, cell]
        slope[j] += model[2, cell] / columns
        slope[k] += model[3, cell] / rows
    return own, slope / total**2


@machine_code
def _slope(rows: int, model: Any, impedance: Any, reading: int, cell: int) -> float:
    """−∂y/∂g of one reading by one cell."""
    columns = len(impedance) - rows
    j, k = reading // columns, rows + reading % columns
    m, n = cell // columns, rows + cell % columns
    at_row, at_column = impedance[j, m] - impedance[j, n], impedance[k, m] - impedance[k, n]
    both = model[4, reading] * at_row * at_column
    return float(model[2, reading] * at_row * at_row + model[3, reading] * at_column * at_column + both)


@machine_code
def made_preconditioner(addresses: Any, rows: int, model: Any, links: Any, point: Any, band: int, ties: Any) -> Any:
    """(base, seen, inner, whether it is one): P = B + V C Vᵀ stands for ∇²φ over all cells, by Woodbury's formula.

    The terms as they are, JᵀWJ as of J's stencil (diag(e) + U K Uᵀ) g of any readout, whose diagonal e is a cell, whose
    columns U are the lines, and whose K is what a line's readings share; see
    `lampest.panel.readouts.two_point.floating`. base : B = (the terms) + diag(g²e²w), as 1/B (cells, 1) or, where terms
    tie cells (`band` > 0, how far apart), as its Cholesky factor (cells, band + 1). seen : (2, cells) g·e·w and g, so
    that V = [g e w U, g U]. inner : (C⁻¹ + Vᵀ B⁻¹ V)⁻¹, (2·lines)², C⁻¹ = [[−UᵀwU, K⁻¹], [K⁻¹, 0]]; empty where a
    line's readings share nothing.
    """
    _, impedance, _ = point
    cells, lines = model.shape[1], len(impedance)
    columns = lines - rows
    own, shared = _own_slopes(rows, model, impedance, ties)
    squares, seen, largest = np.empty(cells), np.empty((2, cells)), 0.0
    inner, right = np.zeros((2 * lines, 2 * lines)), np.zeros((2 * lines, 2 * lines))
    for cell in range(cells):
        largest = max(largest, model[1, cell])
    for cell in range(cells):
        j, k, least = cell // columns, rows + cell % columns, LEAST_SHARE * abs(own[cell])
        rest = own[cell] - shared[j] - shared[k]
        if abs(rest) < least or rest * own[cell] < 0:
            rest = least if own[cell] > 0 else -least
        weight = max(model[1, cell], 1e-6 * largest)
        seen[0, cell], seen[1, cell] = model[0, cell] * rest * weight, model[0, cell]
        squares[cell] = (model[0, cell] * rest) ** 2 * weight
        _add_between(inner, 0, 0, j, k, -weight)
    base, solid = _base(addresses, model, links, squares, band)
    for line in range(lines):
        if shared[line] == 0 or not solid:
            return base, seen, np.empty((0, 0)), solid
        inner[line, lines + line] += 1 / shared[line]
        inner[lines + line, line] += 1 / shared[line]
    for line in range(2 * lines):
        right[line, line] = 1.0
    _add_through_base(addresses, rows, base, seen, inner)
    return base, seen, right, symmetric_divided(addresses, inner, right)


@machine_code
def _base(addresses: Any, model: Any, links: Any, squares: Any, band: int) -> Any:
    """(base, whether it is one) of `made_preconditioner`; cells where terms bend down count as if they did not where
    squares do not outweigh that.
    """
    cells, largest = len(squares), 0.0
    base = np.empty((cells, band + 1))
    for attempt in range(2):
        base[:] = 0.0
        for number in range(links.shape[1]):
            one, other = int(links[0, number]), int(links[1, number])
            if one >= other:
                base[other, one - other] += links[2, number]
        for cell in range(cells):
            base[cell, 0] += squares[cell] + max(model[11, cell], 0.0 if attempt > 0 or band == 0 else -np.inf)
            largest = max(largest, base[cell, 0])
        if band == 0:
            for cell in range(cells):
                base[cell, 0] = 1 / base[cell, 0] if base[cell, 0] > 0 else 0.0
            return base, True
        for cell in range(cells):
            base[cell, 0] += 1e-9 * largest
        if band_factored(addresses, base):
            return base, True
    return base, False


@machine_code
def _add_through_base(addresses: Any, rows: int, base: Any, seen: Any, inner: Any) -> None:
    """inner += Vᵀ B⁻¹ V of what `made_preconditioner` has; with a factor L of B that is YᵀY, L Y = V."""
    cells, band, lines = len(base), base.shape[1] - 1, len(inner) // 2
    columns = lines - rows
    if band == 0:
        for cell in range(cells):
            j, k, inverse = cell // columns, rows + cell % columns, base[cell, 0]
            for one in range(2):
                for other in range(2):
                    _add_between(inner, one * lines, other * lines, j, k, seen[one, cell] * seen[other, cell] * inverse)
        return
    through, square = np.zeros((cells, 2 * lines)), np.empty(inner.shape)
    for cell in range(cells):
        row = through[cell]
        for part in range(2):
            row[part * lines + cell // columns] += seen[part, cell]
            row[part * lines + rows + cell % columns] += seen[part, cell]
        most = min(band, cell)
        for back in range(1, most - 2, 4):  # four at a time: half the time
            one, above = base[cell - back, back], through[cell - back]
            two, second = base[cell - back - 1, back + 1], through[cell - back - 1]
            three, third = base[cell - back - 2, back + 2], through[cell - back - 2]
            four, fourth = base[cell - back - 3, back + 3], through[cell - back - 3]
            for line in range(2 * lines):
                row[line] -= one * above[line] + two * second[line] + three * third[line] + four * fourth[line]
        for back in range(most - most % 4 + 1, most + 1):
            share, above = base[cell - back, back], through[cell - back]
            for line in range(2 * lines):
                row[line] -= share * above[line]
        for line in range(2 * lines):
            row[line] /= base[cell, 0]
    product_into(addresses, through, True, through, False, square)
    add_matrix(inner, square, False)


@machine_code
def _add_between(matrix: Any, above: int, left: int, j: int, k: int, value: float) -> None:
    """matrix += what a cell between lines j and k adds to Uᵀ diag(x) U, in one of four blocks."""
    matrix[above + j, left + j] += value
    matrix[above + k, left + k] += value
    matrix[above + j, left + k] += value
    matrix[above + k, left + j] += value
