"""Kirchhoff's current law for a matrix of cells, and matrices over its lines with their inverses.

Symbols: g (rows, columns) cell conductance in siemens; V potentials of the nodes in volt, rows
before columns. Rows are tied to columns alone, so that one side is eliminated without an inverse.
The crosstalk of two-point readings is approximated by such matrices, for preconditioners.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lampest.panel.panel import Array, Mask, check_line_memory

# Smallest diagonal of the stencil, relative to R², for cells whose own response is due to their
# lines alone.
MIN_DIAGONAL_SHARE = 0.05


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


def bipartite_matrix(diagonal: Array, between: Array) -> Array:
    """Return diag(d) + [[0, A], [Aᵀ, 0]], (…, lines, lines).

    d is (…, lines), and A is (…, rows, columns).
    """
    rows = between.shape[-2]
    matrix = np.zeros((*diagonal.shape, diagonal.shape[-1]), dtype=between.dtype)
    matrix[..., :rows, rows:] = between
    matrix[..., rows:, :rows] = between.swapaxes(-1, -2)
    np.einsum("...ii->...i", matrix)[...] = diagonal
    return matrix


def bipartite(diagonal: Array, between: Array, values: Array) -> Array:
    """Return the product of bipartite_matrix(d, A) and V (…, lines, patterns)."""
    rows = between.shape[-2]
    product = diagonal[..., None] * values
    product[..., :rows, :] += between @ values[..., rows:, :]
    product[..., rows:, :] += between.swapaxes(-1, -2) @ values[..., :rows, :]
    return product


def line_sums(values: Array, of_columns: Array | None = None) -> Array:
    """Return the sums of values (…, rows, columns) over every row, then over every column.

    Columns may have values of their own. Shape (…, rows + columns).
    """
    if of_columns is None:
        of_columns = values
    return np.concatenate([np.add.reduce(values, -1), np.add.reduce(of_columns, -2)], axis=-1)


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
        return np.roll(inverse_of(*_exchanged(conductance, ties)), rows, axis=(-2, -1))
    check_line_memory(rows, columns)
    row_sums, shares, schur = _without_rows(conductance, ties)
    # Z_kk' = S⁻¹, Z_jk = diag(a)⁻¹ G S⁻¹, Z_jj' = diag(a)⁻¹ + diag(a)⁻¹ G S⁻¹ Gᵀ diag(a)⁻¹
    within = np.linalg.inv(schur)
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
    return conductance.swapaxes(-1, -2), np.roll(ties, -conductance.shape[-2], axis=-1)


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


@dataclass(frozen=True, eq=False)
class LineBlocks:
    """Symmetric matrix with a block for values a and b of every line.

    The block is diag(d_ab) + [[0, A_ab], [A_abᵀ, 0]].

    Attributes
    ----------
    diagonal : array, shape (k, k, lines)
        d, symmetric in a and b.
    between : array, shape (k, k, rows, columns)
        A, symmetric in a and b.
    """

    diagonal: Array
    between: Array

    def __add__(self, other: "LineBlocks") -> "LineBlocks":
        return LineBlocks(self.diagonal + other.diagonal, self.between + other.between)

    def matrix(self) -> Array:
        """Return the matrix, (k·lines, k·lines)."""
        count, _, lines = self.diagonal.shape
        blocks = bipartite_matrix(self.diagonal, self.between).swapaxes(1, 2)
        return blocks.reshape(count * lines, count * lines)

    def inverse(self) -> Callable[[Array], Array]:
        """Return the product with the inverse, (k·lines,).

        The lines of the longer side are eliminated one by one, so that the cost is that of an
        inverse over the shorter side and of the entries of A. Raises LinAlgError if a pivot is
        singular, ValueError if one is not finite.
        """
        count = len(self.diagonal)
        rows, columns = self.between.shape[-2:]
        short = slice(rows)
        long = slice(rows, None)
        between = self.between
        if rows > columns:
            short = slice(rows, None)
            long = slice(rows)
            between = between.swapaxes(-1, -2)
        # E = A P⁻¹ with the pivots P of the eliminated lines, and the Schur complement S = D − E Aᵀ
        # of the others
        pivots = np.linalg.inv(np.asarray_chkfinite(self.diagonal[..., long].transpose(2, 0, 1)))
        eliminated = max(rows, columns)
        remaining = count * min(rows, columns)
        ties = between.transpose(0, 2, 3, 1).reshape(remaining, eliminated, count)
        shares = np.einsum("tlb,lbc->tlc", ties, pivots).reshape(remaining, eliminated * count)
        flat = ties.reshape(remaining, eliminated * count)
        schur = -shares @ flat.T
        blocks = schur.reshape(count, remaining // count, count, remaining // count)
        np.einsum("ajbj->abj", blocks)[...] += self.diagonal[..., short]
        within = np.linalg.inv(np.asarray_chkfinite(schur))

        def solve(values: Array) -> Array:
            on_lines = values.reshape(count, rows + columns)
            outer = on_lines[:, long].T
            solution = np.empty_like(on_lines)
            inner = within @ (on_lines[:, short].ravel() - shares @ outer.ravel())
            solution[:, short] = inner.reshape(count, -1)
            solution[:, long] = np.einsum(
                "lab,lb->al", pivots, outer - (inner @ flat).reshape(outer.shape)
            )
            return solution.ravel()

        return solve


@dataclass(frozen=True, eq=False)
class NormalByLines:
    """Matrix diag(own) + V·mixed·Vᵀ over cells.

    V = [diag(v)·U for v in along], and U is the incidence of cells and lines.

    Attributes
    ----------
    own : array, shape (rows, columns)
    along : array, shape (k, rows, columns)
    mixed : LineBlocks of k values
    mixed_inverse : LineBlocks of k values
    """

    own: Array
    along: Array
    mixed: LineBlocks
    mixed_inverse: LineBlocks


@dataclass(frozen=True, eq=False)
class Stencil:
    """Preconditioner of D∘D, inverted through one matrix over the lines (Woodbury).

    (D∘D)_il ≈ 1/A_j² for cells i, l of one row j, 1/B_k² for cells of one column k, and R_l² for i
    = l. A and B are the total conductances of the lines.

    Attributes
    ----------
    diagonal : array, shape (rows, columns)
        1/d; zero for excluded cells.
    inner : callable
        Product with (S⁻¹ + Uᵀ diag(1/d) U)⁻¹ over the lines, U the incidence of cells and lines, S
        the diagonal matrix of 1/A² and 1/B².
    """

    diagonal: Array
    inner: Callable[[Array], Array]

    @classmethod
    def of(cls, conductance: Array, two_point_resistance: Array, free: Mask) -> "Stencil":
        """Return the stencil over the free cells of a network.

        All arrays are (rows, columns), siemens and ohm.
        """
        cells, lines = _parts(conductance, two_point_resistance)
        diagonal = np.where(free, 1 / cells, 0.0)
        of_lines = LineBlocks((1 / lines + line_sums(diagonal))[None, None], diagonal[None, None])
        return cls(diagonal, of_lines.inverse())

    def solve(self, values: Array) -> Array:
        """Return the inverse of the stencil times x, (rows, columns), zero for excluded cells."""
        first = self.diagonal * values
        # (diag(d) + U S Uᵀ)⁻¹ x = x/d − (1/d)·U (S⁻¹ + Uᵀ diag(1/d) U)⁻¹ Uᵀ (x/d)
        lines = self.inner(line_sums(first))
        rows = len(first)
        return first - self.diagonal * (lines[:rows, None] + lines[None, rows:])


def square_by_lines(
    conductance: Array, two_point_resistance: Array, weight: Array
) -> NormalByLines:
    """Return JᵀWJ of two-point readings with the stencil in place of D∘D.

    J = (diag(d) + U K Uᵀ)·diag(g). JᵀWJ = diag(g²d²w) + V M Vᵀ with V = [g·dwU, g·U], M = [[0, K],
    [K, K UᵀwU K]], M⁻¹ = [[−UᵀwU, K⁻¹], [K⁻¹, 0]].

    Parameters
    ----------
    conductance : array, shape (rows, columns)
        g in siemens.
    two_point_resistance : array, shape (rows, columns)
        R in ohm.
    weight : array, shape (rows, columns)
        w ≥ 0.
    """
    cells, lines = _parts(conductance, two_point_resistance)
    heavy = conductance * cells * weight
    of_lines = line_sums(weight)
    no_lines = np.zeros_like(lines)
    of_rows, of_columns = np.split(lines, [len(weight)])
    # Between rows and columns one of the blocks of each matrix is not zero
    between, between_inverse = np.zeros((2, 2, 2, *weight.shape))
    between[1, 1] = of_rows[:, None] * weight * of_columns
    between_inverse[0, 0] = -weight
    mixed = LineBlocks(np.array([[no_lines, lines], [lines, lines * of_lines * lines]]), between)
    inverse = LineBlocks(np.array([[-of_lines, 1 / lines], [1 / lines, no_lines]]), between_inverse)
    return NormalByLines(
        heavy * conductance * cells, np.stack([heavy, conductance]), mixed, inverse
    )


def _parts(conductance: Array, two_point_resistance: Array) -> tuple[Array, Array]:
    """Return the diagonal d of the stencil, (rows, columns), and K, 1/A² and 1/B² of the lines.

    The latter are (lines,).
    """
    of_rows = conductance.sum(axis=1) ** -2.0
    of_columns = conductance.sum(axis=0) ** -2.0
    square = two_point_resistance**2
    # d = R² − 1/A_j² − 1/B_k², because a cell is in both its row and its column
    diagonal = np.maximum(square - of_rows[:, None] - of_columns, MIN_DIAGONAL_SHARE * square)
    return diagonal, np.concatenate([of_rows, of_columns])
