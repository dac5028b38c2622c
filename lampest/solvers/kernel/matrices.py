"""Second derivatives of the cost over free cells as a matrix, in machine code."""

from typing import Any

import numpy as np

from lampest.panel.machine import call, machine_code
from lampest.solvers.kernel.algebra import LOWER, PLAIN, add_matrix, product_into
from lampest.solvers.kernel.points import reading_stiffness


@machine_code
def curvature_matrix(addresses: Any, where: Any, arena: Any, entries: Any, point: Any, free: Any, whole: bool) -> Any:
    """∇²φ over the free cells, its upper triangle; the point is the one that was priced last.

    Or, not `whole`, Gauss and Newton's: without the second derivatives of readings, and of r where they bend down.
    """
    vectors, impedance, twice = point
    rows, cells, count = where[9], vectors.shape[1], len(free)
    columns = cells // rows
    stiffness = reading_stiffness(addresses, where, arena, entries, cells)
    across, conductance = np.empty((rows + columns, count)), np.empty(count)
    _across_cells(impedance, free, rows, across)
    for number in range(count):
        conductance[number] = 1 / vectors[1, free[number]]
    matrix = np.zeros((count, count))
    if whole:
        _add_second_order(twice, free, rows, across, conductance, matrix)
        _add_bends(addresses, where, arena, vectors[4], across, conductance, matrix)
    for number in range(count):
        direct, through = vectors[2, free[number]], vectors[3, free[number]]
        matrix[number, number] += direct - through if whole else max(direct, 0.0)
    _add_responses(addresses, where, arena, stiffness, across, conductance, matrix)
    _add_entries(where, arena, entries, vectors[1], free, matrix)
    return matrix


@machine_code
def _add_second_order(twice: Any, free: Any, rows: int, across: Any, conductance: Any, matrix: Any) -> None:
    """matrix += 2 g (BᵀZB ∘ BᵀKB) g over the free cells, the upper triangle."""
    count, columns = len(free), len(twice) - rows
    bent = np.empty(across.shape)
    _across_cells(twice, free, rows, bent)
    for one in range(count):
        j, k = free[one] // columns, rows + free[one] % columns
        for other in range(one, count):
            both = (across[j, other] - across[k, other]) * (bent[j, other] - bent[k, other])
            matrix[one, other] += 2 * conductance[one] * conductance[other] * both


@machine_code
def _across_cells(matrix: Any, free: Any, rows: int, across: Any) -> None:
    """A·b of every free cell (lines, free), of a matrix A (lines, lines)."""
    lines = len(matrix)
    columns = lines - rows
    for line in range(lines):
        for number in range(len(free)):
            across[line, number] = matrix[line, free[number] // columns] - matrix[line, rows + free[number] % columns]


@machine_code
def _add_responses(
    addresses: Any, where: Any, arena: Any, stiffness: Any, across: Any, conductance: Any, matrix: Any
) -> None:
    """matrix += Jᵀ·diag(stiffness)·J over the free cells, the upper triangle."""
    rows, cells, count = where[9], len(stiffness), len(conductance)
    if count == 0:
        return
    columns, slopes = cells // rows, where[4] + cells
    response, least = np.empty((cells, count)), 0.0
    for number in range(cells):
        j, k, root = number // columns, rows + number % columns, np.sqrt(abs(stiffness[number]))
        p, q = root * arena[slopes + number], root * arena[slopes + cells + number]
        t, least = root * arena[slopes + 2 * cells + number], min(least, stiffness[number])
        for cell in range(count):
            at_row, at_column = across[j, cell], across[k, cell]
            slope = p * at_row * at_row + q * at_column * at_column + t * at_row * at_column
            response[number, cell] = conductance[cell] * slope
    if least >= 0:
        words, one = np.empty(4, dtype=np.int32), np.empty(1)
        words[0], words[1], words[2], words[3], one[0] = LOWER, PLAIN, count, cells, 1.0
        start, unit = words.ctypes.data, one.ctypes.data
        call(
            addresses[4],
            (start, start + 4, start + 8, start + 12, unit, response.ctypes.data, start + 8, unit,
             matrix.ctypes.data, start + 8),
        )  # fmt: skip
        one[0] = words[0] * response[0, 0]
    else:
        signed, square = response.copy(), np.empty((count, count))
        for number in range(cells):
            if stiffness[number] < 0:
                for cell in range(count):
                    signed[number, cell] = -response[number, cell]
        product_into(addresses, signed, True, response, False, square)
        add_matrix(matrix, square, False)


@machine_code
def _add_bends(
    addresses: Any, where: Any, arena: Any, weights: Any, across: Any, conductance: Any, matrix: Any
) -> None:
    """matrix += Σ_i e_i (∂(p, q, t)_i)ᵀ h″_i ∂(p, q, t)_i for weights e, as far as h bends at all."""
    rows, cells, count = where[9], len(weights), len(conductance)
    columns, bends, largest = cells // rows, where[4] + 4 * cells, 0.0
    for number in range(6 * cells):
        largest = max(largest, abs(arena[bends + number]))
    if largest == 0:
        return
    lines = rows + columns
    own, pulled, square = np.empty((lines, count)), np.zeros((lines, count)), np.empty((count, count))
    mutual, bent, largest = np.empty((cells, count)), np.empty((cells, count)), 0.0
    for line in range(lines):
        for cell in range(count):
            own[line, cell] = across[line, cell] ** 2 * conductance[cell]
    for number in range(cells):
        j, k, weight, at = number // columns, rows + number % columns, weights[number], bends + number
        pp, pq, pt = weight * arena[at], weight * arena[at + cells], weight * arena[at + 2 * cells]
        qq, qt, tt = weight * arena[at + 3 * cells], weight * arena[at + 4 * cells], weight * arena[at + 5 * cells]
        largest = max(largest, abs(tt))
        for cell in range(count):
            both = across[j, cell] * across[k, cell] * conductance[cell]
            mutual[number, cell], bent[number, cell] = both, tt * both
            pulled[j, cell] += pp / 2 * own[j, cell] + pq * own[k, cell] + pt * both
            pulled[k, cell] += qq / 2 * own[k, cell] + qt * both
    product_into(addresses, own, True, pulled, False, square)
    add_matrix(matrix, square, False)
    add_matrix(matrix, square, True)
    if largest > 0:
        product_into(addresses, mutual, True, bent, False, square)
        add_matrix(matrix, square, False)


@machine_code
def _add_entries(where: Any, arena: Any, entries: Any, resistance: Any, free: Any, matrix: Any) -> None:
    """matrix += r·(second derivatives of the terms between cells)·r, the upper triangle."""
    cells = len(resistance)
    slot = np.full(cells, -1)
    for number in range(len(free)):
        slot[free[number]] = number
    for number in range(entries.shape[1]):
        one, other = entries[0, number], entries[1, number]
        if one < cells and slot[one] >= 0 and slot[one] <= slot[other]:
            bend = arena[where[5] + number]
            matrix[slot[one], slot[other]] += bend * resistance[one] * resistance[other]
