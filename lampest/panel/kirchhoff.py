"""Kirchhoff's current law for a matrix of cells.

Symbols: g (rows, columns) cell conductance in siemens; u, v potentials of row and column lines in volt.
"""

from typing import Any

import numpy as np

from lampest.panel.panel import Array, check_line_memory


def current_balance(conductance: Any, row_potential: Any, column_potential: Any) -> tuple[Any, Any]:
    """Return the net current out of every line: I_j = Σ_k g_jk (u_j − v_k) and I_k = Σ_j g_jk (v_k − u_j).

    Returns the two balances in ampere, with the shapes of the potentials. NumPy arrays and CasADi matrices are
    accepted. Source: paper, equation (2).

    Parameters
    ----------
    conductance : array or casadi.SX, shape (rows, columns)
        Siemens.
    row_potential, column_potential : array or casadi.SX, shapes (rows, patterns) and (columns, patterns)
        Volt, one column for each pattern.
    """
    rows, columns = conductance.shape
    from_rows = (conductance @ np.ones((columns, 1))) * row_potential - conductance @ column_potential
    from_columns = (conductance.T @ np.ones((rows, 1))) * column_potential - conductance.T @ row_potential
    return from_rows, from_columns


def laplacian(conductance: Array) -> Array:
    """Return L with L·(u, v) = current_balance(g, u, v): (…, lines, lines) siemens, singular; paper, equation (3)."""
    rows, columns = conductance.shape[-2:]
    check_line_memory(rows, columns)
    return bipartite_matrix(line_sums(conductance), -conductance)


def injected(conductance: Array, potentials: Array) -> Array:
    """Return L·V, the current balance of potentials V (…, lines, patterns), rows before columns; the same shape."""
    return bipartite(line_sums(conductance), -conductance, potentials)


def bipartite_matrix(diagonal: Array, between: Array) -> Array:
    """Return diag(d) + [[0, A], [Aᵀ, 0]], (…, lines, lines), for d (…, lines) and A (…, rows, columns)."""
    rows, lines = between.shape[-2], diagonal.shape[-1]
    matrix = np.zeros((*diagonal.shape, lines), dtype=between.dtype)
    matrix[..., :rows, rows:], matrix[..., rows:, :rows] = between, between.swapaxes(-1, -2)
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
    """Return the sums over every row, then over every column, of values (…, rows, columns): (…, rows + columns)."""
    return np.concatenate([np.add.reduce(values, -1), np.add.reduce(values, -2)], axis=-1)
