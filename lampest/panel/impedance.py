"""Impedance Z = (L(g) + diag(t))⁻¹ of a panel's lines, and ln det of its inverse.

The lines of the longer side are eliminated first. What remains is a network of the other side's
lines, whose matrix is inverted. All sums have positive summands, so that no digits are lost where
cells are decades apart.
"""

import numpy as np

from lampest.panel.kirchhoff import line_sums
from lampest.panel.panel import Array, check_line_memory


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
