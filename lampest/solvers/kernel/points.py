"""The cost and its first derivatives at a point, in machine code.

With weights e of the readings and slopes h of their equation W = [[diag Σ e h_p, ½ e h_t], [·, diag Σ e h_q]],
K = Z W Z, Jᵀe = g·bᵀ K b. What the terms and the readout's equation say comes from CasADi's functions, called by their
addresses.
"""

from typing import Any

import numpy as np

from lampest.panel.machine import call, machine_code
from lampest.solvers.kernel.algebra import product_into
from lampest.solvers.kernel.impedances import impedance_into

FELL_SHORT, SETTLED = 0, 1


@machine_code
def priced(addresses: Any, where: Any, arena: Any, ties: Any, point: Any) -> tuple[float, float]:
    """(φ, the scale of its gradient) at vectors[0] = u, and all else of a point; infinite where Z does not exist.

    vectors : (5, cells) u, r, r·∂φ/∂r, Jᵀ∂φ/∂y and ∂φ/∂y. impedance, twice : Z and K (lines, lines).
    """
    vectors, impedance, twice = point
    rows, cells, terms = where[9], vectors.shape[1], where[7]
    columns = cells // rows
    conductance = np.empty((rows, columns))
    for cell in range(cells):
        conductance[cell // columns, cell % columns] = 1 / vectors[1, cell]
    if not impedance_into(addresses, conductance, ties[0], impedance):
        return np.inf, 1.0
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        arena[where[2] + cell] = impedance[j, j]
        arena[where[2] + cells + cell] = impedance[k, k]
        arena[where[2] + 2 * cells + cell] = impedance[j, k]
    call(addresses[0], (addresses[3],))
    for cell in range(cells):
        arena[where[0] + cell] = vectors[1, cell]
        arena[where[1] + cell] = arena[where[4] + cell]
    call(addresses[0], (addresses[1],))
    first, objective, blank = where[3], 0.0, 0.0
    for term in range(terms):
        objective += arena[first + term]
        blank += arena[first + terms + term]
    for cell in range(cells):
        vectors[2, cell] = arena[first + 2 * terms + cell] * vectors[1, cell]
        vectors[4, cell] = arena[first + 2 * terms + cells + cell]
    loading, half = np.zeros(impedance.shape), np.empty(impedance.shape)
    slopes = where[4] + cells
    for cell in range(cells):
        j, k, weight = cell // columns, rows + cell % columns, vectors[4, cell]
        loading[j, j] += weight * arena[slopes + cell]
        loading[k, k] += weight * arena[slopes + cells + cell]
        loading[j, k] = loading[k, j] = weight * arena[slopes + 2 * cells + cell] / 2
    product_into(addresses, loading, False, impedance, False, half)
    product_into(addresses, impedance, False, half, False, twice)
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        vectors[3, cell] = (twice[j, j] + twice[k, k] - 2 * twice[j, k]) / vectors[1, cell]
    scale = blank / cells + objective
    return objective, scale if scale != 0 else 1.0


@machine_code
def reading_stiffness(addresses: Any, where: Any, arena: Any, entries: Any, cells: int) -> Any:
    """(cells) ∂²φ/∂y² of every reading, where the point is that was priced last."""
    call(addresses[0], (addresses[2],))
    stiffness = np.zeros(cells)
    for number in range(entries.shape[1]):
        if entries[0, number] >= cells:
            stiffness[entries[0, number] - cells] += arena[where[5] + number]
    return stiffness


@machine_code
def free_numbers(vectors: Any, bounds: Any) -> Any:
    """The numbers of the cells that have room and are not pressed against a bound; bounds : (2, cells) of u."""
    cells = vectors.shape[1]
    chosen, count = np.empty(cells, dtype=np.int64), 0
    for cell in range(cells):
        slope = vectors[2, cell] + vectors[3, cell]
        low, high = bounds[0, cell], bounds[1, cell]
        pressed = (vectors[0, cell] <= low and slope > 0) or (vectors[0, cell] >= high and slope < 0)
        if low < high and not pressed:
            chosen[count] = cell
            count += 1
    return chosen[:count].copy()


@machine_code
def projected_residual(vectors: Any, bounds: Any, scale: float) -> float:
    """max |u − Π(u − ∇φ/s)|."""
    largest = 0.0
    for cell in range(vectors.shape[1]):
        target = vectors[0, cell] - (vectors[2, cell] + vectors[3, cell]) / scale
        target = min(max(target, bounds[0, cell]), bounds[1, cell])
        away = abs(vectors[0, cell] - target)
        if not away <= largest:
            largest = away
    return largest


@machine_code
def farthest(one: Any, other: Any) -> float:
    """max |a − b|."""
    largest = 0.0
    for number in range(len(one)):
        largest = max(largest, abs(one[number] - other[number]))
    return largest


@machine_code
def put_within(vectors: Any, target: Any, bounds: Any) -> None:
    """A target as the place of a point, within the bounds."""
    for cell in range(len(target)):
        held = min(max(target[cell], bounds[0, cell]), bounds[1, cell])
        vectors[0, cell] = held
        vectors[1, cell] = np.exp(held)


@machine_code
def blank_point(lines: int, cells: int) -> Any:
    """Where a point is put."""
    return np.empty((5, cells)), np.empty((lines, lines)), np.empty((lines, lines))


@machine_code
def appraised(addresses: Any, where: Any, arena: Any, given: Any, ties: Any, cell_resistance: Any) -> Any:
    """(readings, what the cost's `first` returns, ∇φ in u) of cells (cells) ohm; no number where Z does not exist."""
    cells, rows = len(cell_resistance), where[9]
    for number in range(len(given)):
        arena[where[6] + number] = given[number]
    point = blank_point(rows + cells // rows, cells)
    reading, first, gradient = np.empty(cells), np.empty(2 * where[7] + 2 * cells), np.empty(cells)
    for cell in range(cells):
        point[0][1, cell] = cell_resistance[cell]
    objective, _ = priced(addresses, where, arena, ties, point)
    for number in range(len(first)):
        first[number] = arena[where[3] + number] if objective < np.inf else np.nan
    for cell in range(cells):
        reading[cell] = arena[where[1] + cell]
        gradient[cell] = point[0][2, cell] + point[0][3, cell]
    return reading, first, gradient
