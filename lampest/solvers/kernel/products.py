"""Products with second derivatives of the cost, in machine code, without a matrix of cells × cells."""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.algebra import add_product
from lampest.solvers.kernel.points import reading_stiffness


@machine_code
def _loaded(addresses: Any, own: Any, block: Any, matrix: Any, result: Any) -> None:
    """result = W·A (lines, lines), W = [[diag, B], [Bᵀ, diag]] of `own` (lines) and `block` B (rows, columns)."""
    rows, lines = len(block), len(matrix)
    for line in range(lines):
        for other in range(lines):
            result[line, other] = own[line] * matrix[line, other]
    add_product(addresses, 1.0, block, False, matrix[rows:], False, 1.0, result[:rows])
    add_product(addresses, 1.0, block, True, matrix[:rows], False, 1.0, result[rows:])


@machine_code
def _add_diagonal(share: float, one: Any, other: Any, result: Any) -> None:
    """result += share·diag(A·B), A symmetric."""
    for line in range(len(one)):
        for place in range(len(one)):
            result[place] += share * one[line, place] * other[line, place]


@machine_code
def modelled(addresses: Any, where: Any, arena: Any, entries: Any, point: Any, straight: int, whole: bool) -> Any:
    """(model, links): what products with ∇²φ need at the point that was priced last, in u or in 1/r (`straight` -1).

    model : (12, cells) g, ∂²φ/∂y², the slopes p, q, t of the readings' equation, ∂φ/∂y times its six bends, and what
    stands on the diagonal beside those. links : of the terms' second derivatives between cells, with both their cells.
    Not `whole`: Gauss and Newton's.
    """
    vectors = point[0]
    cells = vectors.shape[1]
    model, count = np.zeros((12, cells)), 0
    stiffness = reading_stiffness(addresses, where, arena, entries, cells)
    for cell in range(cells):
        model[0, cell], model[1, cell] = 1 / vectors[1, cell], stiffness[cell]
        for part in range(3):
            model[2 + part, cell] = arena[where[4] + (1 + part) * cells + cell]
        direct, through = vectors[2, cell], vectors[3, cell]
        if whole:
            for part in range(6):
                model[5 + part, cell] = vectors[4, cell] * arena[where[4] + (4 + part) * cells + cell]
            model[11, cell] = direct - through - straight * (direct + through)
        else:
            model[11, cell] = max(direct, 0.0)
    links = np.empty((3, entries.shape[1]))
    for number in range(entries.shape[1]):
        one, other = entries[0, number], entries[1, number]
        if one < cells:
            links[0, count], links[1, count] = one, other
            links[2, count] = arena[where[5] + number] * vectors[1, one] * vectors[1, other]
            count += 1
    return model, links[:, :count].copy()


@machine_code
def bent_along(
    addresses: Any, rows: int, model: Any, links: Any, point: Any, whole: bool, step: Any, image: Any
) -> None:
    """image ← ∇²φ·step (cells), of a model at a point, without a matrix of cells × cells.

    With dZ = Z L_{g s} Z the change of Z and dy that of the readings: g·bᵀ (Z W' Z + Z L_{g s} K + K L_{g s} Z) b,
    where W' is of the weights ∂²φ/∂y² dy and of what the slopes change by.
    """
    _, impedance, twice = point
    lines, cells = len(impedance), len(step)
    columns = lines - rows
    block, own, cross = np.empty((rows, columns)), np.zeros(lines), np.empty((rows, columns))
    for cell in range(cells):
        j, k, drawn = cell // columns, cell % columns, model[0, cell] * step[cell]
        block[j, k] = -drawn
        own[j] += drawn
        own[rows + k] += drawn
    moved, pulled, change = np.empty((lines, lines)), np.empty((lines, lines)), np.zeros(lines)
    _loaded(addresses, own, block, impedance, moved)
    add_product(addresses, 1.0, impedance[:rows], False, moved[:, rows:], False, 0.0, cross)
    _add_diagonal(1.0, impedance, moved, change)
    own[:] = 0.0
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        p, q, t = change[j], change[k], cross[j, k - rows]
        weight = model[1, cell] * (model[2, cell] * p + model[3, cell] * q + model[4, cell] * t)
        own[j] += weight * model[2, cell] + model[5, cell] * p + model[6, cell] * q + model[7, cell] * t
        own[k] += weight * model[3, cell] + model[6, cell] * p + model[8, cell] * q + model[9, cell] * t
        half = weight * model[4, cell] + model[7, cell] * p + model[9, cell] * q + model[10, cell] * t
        block[j, k - rows] = half / 2
    _loaded(addresses, own, block, impedance, pulled)
    add_product(addresses, 1.0, impedance[:rows], False, pulled[:, rows:], False, 0.0, cross)
    change[:] = 0.0
    _add_diagonal(1.0, impedance, pulled, change)
    if whole:
        add_product(addresses, 1.0, twice[:rows], False, moved[:, rows:], False, 1.0, cross)
        add_product(addresses, 1.0, moved[:, :rows], True, twice[:, rows:], False, 1.0, cross)
        _add_diagonal(2.0, twice, moved, change)
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        bent = model[0, cell] * (change[j] + change[k] - 2 * cross[j, k - rows])
        image[cell] = bent + model[11, cell] * step[cell]
    for number in range(links.shape[1]):
        image[int(links[0, number])] += links[2, number] * step[int(links[1, number])]
