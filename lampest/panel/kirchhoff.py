"""Kirchhoff's current law for a matrix of cells, and the inverse of its matrix.

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


def inverse_of(conductance: Array, ties: Array) -> Array:
    """Return Z = (L(g) + diag(t))⁻¹, (…, lines, lines) ohm.

    Raises LinAlgError if a line is not connected.

    The lines of the longer side are eliminated by hand, so that the cost is that of the shorter
    side's inverse and of the entries of Z. With a the sums of the eliminated lines, the others form
    a network of conductances Gᵀ diag(a)⁻¹ G with ties t + Gᵀ diag(a)⁻¹ t. Positive sums lose no
    digits where cells are decades apart.
    Source: Grassmann, Taksar, Heyman, Operations Research 33 (1985).
    """
    rows, columns = conductance.shape[-2:]
    if rows < columns:
        return np.roll(inverse_of(*_exchanged(conductance, ties)), (rows, rows), axis=(-2, -1))
    check_line_memory(rows, columns)
    row_sums, shares, schur = _without_rows(conductance, ties)
    # Z_kk' = S⁻¹, Z_jk = diag(a)⁻¹ G S⁻¹, Z_jj' = diag(a)⁻¹ + diag(a)⁻¹ G S⁻¹ Gᵀ diag(a)⁻¹
    within: Array = np.linalg.inv(schur)
    inverse = np.empty((*ties.shape, rows + columns), dtype=within.dtype)
    between = shares @ within
    inverse[..., rows:, rows:] = within
    inverse[..., :rows, rows:] = between
    inverse[..., rows:, :rows] = between.swapaxes(-1, -2)
    inverse[..., :rows, :rows] = between @ shares.swapaxes(-1, -2)
    np.einsum("...ii->...i", inverse)[..., :rows] += 1 / row_sums
    return inverse


def log_determinant(conductance: Array, ties: Array) -> float:
    """Return ln det(L(g) + diag(t)) of a single network.

    Raises LinAlgError if a line is not connected.
    """
    if conductance.shape[0] < conductance.shape[1]:
        conductance, ties = _exchanged(conductance, ties)
    row_sums, _, schur = _without_rows(conductance, ties)
    return float(np.log(row_sums).sum() + np.linalg.slogdet(schur)[1])


def _exchanged(conductance: Array, ties: Array) -> tuple[Array, Array]:
    """Return the conductances and ties of a network whose rows are columns."""
    rows = conductance.shape[-2]
    return conductance.swapaxes(-1, -2), np.concatenate(
        [ties[..., rows:], ties[..., :rows]], axis=-1
    )


def _without_rows(conductance: Array, ties: Array) -> tuple[Array, Array, Array]:
    """Return a, diag(a)⁻¹ G, and the matrix of the columns' network without rows.

    See `inverse_of`.
    """
    total = line_sums(conductance) + ties
    if not total.all():
        raise np.linalg.LinAlgError("a line is not connected")
    rows = conductance.shape[-2]
    row_sums = total[..., :rows]
    shares = conductance / row_sums[..., None]
    meshed = shares.swapaxes(-1, -2) @ conductance
    np.einsum("...ii->...i", meshed)[...] = 0.0
    tied = ties[..., rows:] + np.einsum("...jk,...j->...k", shares, ties[..., :rows])
    schur = -meshed
    np.einsum("...ii->...i", schur)[...] = meshed.sum(axis=-1) + tied
    return row_sums, shares, schur
