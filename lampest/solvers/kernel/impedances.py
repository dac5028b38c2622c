"""The impedance of the lines in machine code, by elimination of the rows.

With the blocks of Z over rows (r) and columns (c), from L(g) + diag(t): S = C − gᵀR⁻¹g, Z_cc = S⁻¹, Z_rc = R⁻¹g S⁻¹,
Z_rr = R⁻¹ + R⁻¹g Z_rcᵀ, R and C diagonal.
"""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.algebra import product_into


@machine_code
def impedance_into(addresses: Any, conductance: Any, ties: Any, impedance: Any) -> bool:
    """Z (lines, lines); whether every pivot is positive.

    Elimination of a Laplacian needs no exchange of rows: its pivots are sums of what is left to ground.
    """
    rows, columns = conductance.shape
    over, total = np.empty((rows, columns)), np.empty(rows)
    for j in range(rows):
        total[j] = ties[j]
        for k in range(columns):
            total[j] += conductance[j, k]
        if not total[j] > 0:
            return False
        for k in range(columns):
            over[j, k] = conductance[j, k] / total[j]
    rest, across, between = np.empty((columns, columns)), np.empty((rows, columns)), np.empty((rows, rows))
    product_into(addresses, conductance, True, over, False, rest)
    for k in range(columns):
        whole = ties[rows + k]
        for j in range(rows):
            whole += conductance[j, k]
        for other in range(columns):
            rest[k, other] = -rest[k, other]
        rest[k, k] += whole
    if not _inverted(rest):
        return False
    product_into(addresses, over, False, rest, False, across)
    product_into(addresses, across, False, over, True, between)
    for j in range(rows):
        for other in range(rows):
            impedance[j, other] = between[j, other]
        impedance[j, j] += 1 / total[j]
        for k in range(columns):
            impedance[j, rows + k] = across[j, k]
            impedance[rows + k, j] = across[j, k]
    for k in range(columns):
        for other in range(columns):
            impedance[rows + k, rows + other] = rest[k, other]
    return True


@machine_code
def _inverted(matrix: Any) -> bool:
    """A symmetric positive definite matrix to its inverse in place, by Gauss and Jordan; whether it was definite."""
    size = len(matrix)
    for pivot in range(size):
        head = matrix[pivot, pivot]
        if not head > 0:
            return False
        matrix[pivot, pivot] = 1.0
        for column in range(size):
            matrix[pivot, column] /= head
        for row in range(size):
            if row != pivot:
                factor = matrix[row, pivot]
                matrix[row, pivot] = 0.0
                for column in range(size):
                    matrix[row, column] -= factor * matrix[pivot, column]
    for row in range(size):
        for column in range(row):
            middle = (matrix[row, column] + matrix[column, row]) / 2
            matrix[row, column] = middle
            matrix[column, row] = middle
    return True
