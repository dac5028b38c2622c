"""Kirchhoff's current law for a matrix of cells.

Symbols: g (rows, columns) cell conductance in siemens; V potentials of the nodes in volt, rows
before columns.
"""

from typing import Any

import numpy as np

from lampest.panel.panel import Array, check_line_memory


def current_balance(incidence: Any, conductance: Any, potentials: Any) -> Any:
    """Return the net current out of every node through the cells, I = B (g ∘ Bᵀ V).

    The unit is ampere for potentials in volt. For lines I_j = Σ_k g_jk (V_j − V_k) of a row and I_k
    = Σ_j g_jk (V_k − V_j) of a column. CasADi matrices are accepted, as well as NumPy arrays.
    Source: paper, equation (2).

    Parameters
    ----------
    incidence : array or casadi.DM, shape (nodes, cells)
        B: +1 at the node on a cell's row, −1 at the node on its column.
    conductance : array or casadi.SX, shape (cells, 1)
        Siemens.
    potentials : array or casadi.SX, shape (nodes, patterns)
        V in volt, one column for each pattern.
    """
    return incidence @ (conductance * (incidence.T @ potentials))


def laplacian(conductance: Array) -> Array:
    """Return L of L·V = current_balance(B, g, V) of lines, (…, lines, lines) siemens.

    The matrix is singular. Source: paper, equation (3).
    """
    rows, columns = conductance.shape[-2:]
    check_line_memory(rows, columns)
    return bipartite_matrix(line_sums(conductance), -conductance)


def injected(conductance: Array, potentials: Array) -> Array:
    """Return L·V, the current balance of potentials V (…, lines, patterns).

    Rows are before columns; it has the same shape.
    """
    return bipartite(line_sums(conductance), -conductance, potentials)


def bipartite_matrix(diagonal: Array, between: Array) -> Array:
    """Return diag(d) + [[0, A], [Aᵀ, 0]], (…, lines, lines).

    d is (…, lines), and A is (…, rows, columns).
    """
    rows = between.shape[-2]
    lines = diagonal.shape[-1]
    matrix = np.zeros((*diagonal.shape, lines), dtype=between.dtype)
    matrix[..., :rows, rows:] = between
    matrix[..., rows:, :rows] = between.swapaxes(-1, -2)
    np.einsum("...ii->...i", matrix)[...] = diagonal
    return matrix


def bipartite(diagonal: Array, between: Array, values: Array) -> Array:
    """Return the product of bipartite_matrix(d, A) and V (…, lines, patterns)."""
    rows = between.shape[-2]
    product: Array = diagonal[..., None] * values
    product[..., :rows, :] += between @ values[..., rows:, :]
    product[..., rows:, :] += between.swapaxes(-1, -2) @ values[..., :rows, :]
    return product


def line_sums(values: Array) -> Array:
    """Return the sums of values (…, rows, columns) over every row, then over every column.

    Shape (…, rows + columns).
    """
    return np.concatenate([np.add.reduce(values, -1), np.add.reduce(values, -2)], axis=-1)
