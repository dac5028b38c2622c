"""Preconditioners M ≈ ∇²φ of conjugate gradients, reused from frame to frame while accurate enough.

Small problems use the Cholesky factor of ∇²φ, or of the Gauss–Newton matrix. Large problems use
derivatives by ohm, A = T + diag(c) + V S Vᵀ: T contains the penalties, c the response of each
cell's own reading, and V two columns for every line. With the coarse space Q = V (VᵀAV)⁻¹ Vᵀ, M⁻¹ =
Q + (1 − QA) (T + diag(c))⁻¹ (1 − AQ).
Source: Nabben & Vuik, SIAM J. Numer. Anal. 42, 2004 (balancing).
"""

from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import lapack

from lampest.files.typed import ReadOnlyArrays
from lampest.panel.kirchhoff import LineBlocks, line_sums
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import Linear, restricted
from lampest.solvers.hessian import Hessian

# Entry over the largest one of a diagonal; double precision takes a smaller one for zero.
MIN_DIAGONAL = 1e-12
# Added in turn to a unit diagonal: rounding can make Gauss–Newton's matrix indefinite.
SHIFTS = (1e-10, 1e-6, 1e-3)
# Weight of readings beyond a loss's corner, over the largest one; they still tie a line.
WEAK_WEIGHT = 1e-3
# Share of the lines that add too little for a coarse space to repay its cost.
WEAK_LINE_SHARE = 0.75
SPARSE_SHIFT = 1e-9  # added to a unit diagonal before sparse LU
TINY = 1e-300  # least square of a length, so that nothing is divided by zero


@dataclass(frozen=True, eq=False)
class Preconditioner(ReadOnlyArrays, ABC):
    """Preconditioner M.

    Attributes
    ----------
    cell_resistance : array, shape (frames, rows, columns)
        Point at which M was made, ohm.
    """

    cell_resistance: Array

    def distance(self, cell_resistance: Array) -> float:
        """Return the largest |δ log r| between this point and the one of M.

        The distance is infinite for a panel of another shape.
        """
        if cell_resistance.shape != self.cell_resistance.shape:
            return float("inf")
        return float(np.abs(np.log(cell_resistance / self.cell_resistance)).max())

    @abstractmethod
    def over(self, free: Mask, cell_resistance: Array) -> Linear:
        """Return the product M⁻¹·p in u = log r over the free cells, flat.

        M⁻¹ is symmetric and positive definite.
        """


@dataclass(frozen=True, eq=False)
class Cholesky(Preconditioner):
    """Cholesky factor UᵀU = D⁻¹MD⁻¹ of a matrix over chosen cells, scaled to a unit diagonal.

    Attributes
    ----------
    cells : array of int
        Numbers of the n chosen cells.
    triangle : array, shape (n, n)
        U; the entries below its diagonal have no meaning.
    size : array, shape (n,)
        D, the roots of the diagonal of M.
    diagonal : array, shape (cells,)
        Diagonal of M; its mean for cells that were not chosen.
    norm : float
        ‖UᵀU‖₁.
    """

    cells: Numbers
    triangle: Array
    size: Array
    diagonal: Array
    norm: float

    @classmethod
    def of(
        cls, cell_resistance: Array, cells: Numbers, matrix: Array, least: float = 0.0
    ) -> "Cholesky | None":
        """Return the factor of a matrix over the chosen cells; None if it is not positive definite.

        The matrix is over all cells, or over the chosen ones. `least` is added to the unit diagonal
        of the scaled matrix.
        """
        if len(matrix) > len(cells):
            matrix = matrix[np.ix_(cells, cells)]
        pivots = matrix.diagonal()
        if not pivots.min() > 0:
            return None
        size = np.sqrt(pivots)
        unit = matrix / size
        unit /= size[:, None]
        unit.flat[:: len(size) + 1] += least
        norm = float(np.abs(unit).sum(axis=0).max())
        # symmetric, and in LAPACK's order
        triangle, failed = lapack.dpotrf(unit.T, clean=0, overwrite_a=1)
        if failed or not np.isfinite(norm):
            return None
        diagonal = np.full(cell_resistance.size, float(np.mean(pivots)))
        diagonal[cells] = pivots
        return cls(cell_resistance, cells, triangle, size, diagonal, norm)

    def solve(self, values: Array) -> Array:
        """Return M⁻¹·p over the chosen cells."""
        return np.asarray(lapack.dpotrs(self.triangle, values / self.size)[0] / self.size)

    def inverse(self) -> Array:
        """Return M⁻¹ over the chosen cells, (n, n)."""
        upper = np.triu(lapack.dpotri(self.triangle)[0])
        # dpotri returns one triangle; the diagonal would count twice in upper + upperᵀ.
        upper.flat[:: len(upper) + 1] /= 2
        return np.asarray((upper + upper.T) / self.size / self.size[:, None])

    def over(self, free: Mask, cell_resistance: Array) -> Linear:
        chosen = np.flatnonzero(free)
        if np.array_equal(chosen, self.cells):
            return self.solve
        # Other free cells than those of the factor: its inverse where both agree, 1/diagonal
        # elsewhere.
        place = np.full(free.size, -1)
        place[self.cells] = np.arange(len(self.cells))
        in_factor = place[chosen] >= 0
        inner = place[chosen][in_factor]
        outer = 1 / self.diagonal[chosen]
        right = np.zeros(len(self.cells))

        def solve(values: Array) -> Array:
            right[inner] = values[in_factor]
            solution = outer * values
            solution[in_factor] = self.solve(right)[inner]
            return solution

        return solve


@dataclass(frozen=True, eq=False)
class TwoLevel(Preconditioner):
    """Balancing preconditioner of large problems.

    Attributes
    ----------
    solve : Linear
        (T + diag(c))⁻¹·x, derivatives by ohm.
    lines : CoarseLines or None
        Coarse space V of rows and columns; None where it does not repay its cost.
    """

    solve: Linear
    lines: "CoarseLines | None" = None

    @classmethod
    def of(
        cls, hessian: Hessian, penalties: sparse.csr_array | None = None
    ) -> "TwoLevel | Woodbury":
        """Return the preconditioner at a point, Woodbury's where T is diagonal.

        T is `penalties` in u, (cells, cells), or else the penalties' part of the Gauss–Newton
        matrix.
        """
        in_log_r = hessian.penalty_matrix if penalties is None else penalties
        cells = hessian.cells
        inverse = sparse.diags_array(1 / cells.ravel())

        # T + diag(c) by ohm: the matrix in u = log r divided by r on both sides
        def local(pivots: Array) -> sparse.csr_array:
            return sparse.csr_array(inverse @ (in_log_r + sparse.diags_array(pivots)) @ inverse)

        if len(cells) == 1:
            # JᵀWJ of a single frame ≈ diag(own) + V S Vᵀ; a floor of the weights keeps lines tied
            # together.
            weight = np.maximum(
                hessian.reading_weight[0],
                WEAK_WEIGHT * (hessian.reading_weight.max(initial=0.0) or 1.0),
            )
            parts = hessian.at.networks[0].normal_by_lines(weight)
            level = local(parts.own.ravel())
            along = parts.along / cells
            if len(along) and level.nnz <= level.shape[0]:
                diagonal = floored(level.diagonal()).reshape(cells.shape[1:])
                return Woodbury(cells, diagonal, LineColumns(along), parts.mixed_inverse)
            lines = CoarseLines.of(level, along, parts.mixed)
            if lines is not None:
                return cls(cells, sparse_inverse(level), lines)
        return cls(cells, sparse_inverse(local(hessian.own)))

    def over(self, free: Mask, cell_resistance: Array) -> Linear:
        return _by_log(self._solved, free, cell_resistance)

    def _solved(self, values: Array) -> Array:
        """Return the product with the preconditioner.

        S v without lines, else P v + b − P L b with b = S (v − L P v), for the solves P of the
        lines and S of the factor, and the product L of the lines.
        """
        if self.lines is None:
            return self.solve(values)
        first = self.lines.solve(values)
        between = self.solve(values - self.lines.product(first))
        return first + between - self.lines.solve(self.lines.product(between))


@dataclass(frozen=True, eq=False)
class Woodbury(Preconditioner):
    """A⁻¹ between any cells, exactly, where T + diag(c) is `diagonal`, in ohm (rows, columns)."""

    diagonal: Array
    lines: "LineColumns"
    mixed_inverse: LineBlocks

    def over(self, free: Mask, cell_resistance: Array) -> Linear:
        """Return (D + V S Vᵀ)⁻¹ = D⁻¹ − D⁻¹V (S⁻¹ + VᵀD⁻¹V)⁻¹ VᵀD⁻¹ over the free cells."""
        shape = self.diagonal.shape
        inverse = np.where(free.reshape(shape), 1 / self.diagonal, 0.0)
        inner: Linear = np.zeros_like  # D⁻¹ alone remains if contrasts exceed double precision
        with suppress(np.linalg.LinAlgError):
            inner = (self.mixed_inverse + self.lines.between(inverse)).inverse()
        flat = inverse.ravel()

        def solve(values: Array) -> Array:
            return flat * (values - self.lines.back(inner(self.lines.sums(flat * values))))

        return _by_log(solve, free, cell_resistance)


@dataclass(frozen=True, eq=False)
class LineColumns:
    """Columns V = [diag(v)·U for v in along] of rows and columns.

    U is the incidence of cells and lines.

    Attributes
    ----------
    along : array, shape (vectors, rows, columns)
        The vectors v.
    """

    along: Array

    def between(self, values: Array) -> LineBlocks:
        """Return Vᵀ diag(x) V for x (rows, columns)."""
        grids = self.along[:, None] * self.along * values
        return LineBlocks(line_sums(grids), grids)

    def sums(self, values: Array) -> Array:
        """Return Vᵀ·x, (vectors · lines,)."""
        return line_sums(self.along * values.reshape(self.along.shape[1:])).ravel()

    def back(self, lines: Array) -> Array:
        """Return V·y, flat."""
        of_rows, of_columns = np.split(
            lines.reshape(len(self.along), -1), [self.along.shape[1]], axis=1
        )
        return np.asarray(
            (self.along * (of_rows[:, :, None] + of_columns[:, None])).sum(axis=0)
        ).ravel()


@dataclass(frozen=True, eq=False)
class CoarseLines(LineColumns):
    """Coarse space V.

    Attributes
    ----------
    local : sparse.csr_array, shape (cells, cells)
        T + diag(c).
    mixed : array, shape (vectors · lines, vectors · lines)
        S.
    coarse : array, shape (vectors · lines, vectors · lines)
        (VᵀAV)⁻¹.
    """

    local: sparse.csr_array
    mixed: Array
    coarse: Array

    @classmethod
    def of(cls, local: sparse.csr_array, along: Array, blocks: LineBlocks) -> "CoarseLines | None":
        """Return the coarse space, or None if it does not repay its cost.

        The cost is not repaid if three quarters of the lines add less than T + diag(c) has along
        them.
        """
        if not len(along):
            return None
        mixed = blocks.matrix()
        # V with columns of unit length
        row, column = np.indices(along.shape[1:]).reshape(2, -1)
        number = np.tile(np.arange(len(row)), 2)
        places = np.concatenate([row, along.shape[1] + column])
        incidence = sparse.csr_array((np.ones(len(places)), (number, places)))
        columns = sparse.csr_array(
            sparse.hstack([sparse.diags_array(side.ravel()) @ incidence for side in along])
        )
        length = np.sqrt(np.maximum(columns.multiply(columns).sum(axis=0), TINY))
        columns = sparse.csr_array(columns @ sparse.diags_array(1 / length))
        # VᵀAV = Vᵀ(T + diag(c))V + (VᵀV) S (VᵀV)
        crossed = (columns.T @ (local @ columns)).toarray()
        square = (columns.T @ columns).toarray()
        added = square @ (mixed * length[:, None] * length) @ square
        if np.quantile(added.diagonal() / crossed.diagonal(), WEAK_LINE_SHARE) < 1:
            return None
        coarse = crossed + added
        # Inverse of the matrix scaled to a unit diagonal, shifted because columns of V can
        # coincide.
        size = np.sqrt(np.maximum(np.abs(coarse.diagonal()), TINY))
        coarse = coarse / size[:, None] / size
        coarse.flat[:: len(coarse) + 1] += SHIFTS[0]  # columns that are alike on even panels
        scale = 1 / (size * length)
        inverse = np.linalg.inv(coarse) * scale[:, None] * scale
        return cls(along, local, mixed, (inverse + inverse.T) / 2)

    def solve(self, values: Array) -> Array:
        """Return Q·x, flat."""
        return self.back(self.coarse @ self.sums(values))

    def product(self, values: Array) -> Array:
        """Return A·x, flat."""
        return np.asarray(self.local @ values + self.back(self.mixed @ self.sums(values)))


def preconditioner(hessian: Hessian, free: Mask) -> Preconditioner:
    """Return a new preconditioner at a point.

    The preconditioner acts on the free cells of small problems, and on all cells of large ones.
    """
    if not hessian.dense:
        return TwoLevel.of(hessian)
    cells = hessian.cells
    factor = Cholesky.of(cells, np.flatnonzero(free), hessian.matrix)
    return factor or gauss_newton_factor(hessian, free) or TwoLevel.of(hessian)


def gauss_newton_factor(
    hessian: Hessian, free: Mask, damping: float = SHIFTS[0]
) -> Cholesky | None:
    """Return the Cholesky factor of the Gauss–Newton matrix over the free cells.

    The matrix is scaled to a unit diagonal and regularised by `damping` on it; larger shifts are
    tried if the result is not positive definite. Returns None on large problems, or if no shift
    suffices.
    """
    if not hessian.dense:
        return None
    chosen = np.flatnonzero(free)
    cells = hessian.cells
    matrix = hessian.gauss_newton_matrix[np.ix_(chosen, chosen)]
    matrix.flat[:: len(matrix) + 1] = floored(np.diag(matrix))
    tried = (
        Cholesky.of(cells, chosen, matrix, shift)
        for shift in (damping, *SHIFTS)
        if shift >= damping
    )
    return next((factor for factor in tried if factor is not None), None)


def _by_log(product: Linear, free: Mask, cell_resistance: Array) -> Linear:
    """Return a product by ohm over all cells as one in u = log r over the free cells."""
    chosen = np.flatnonzero(free)
    size = cell_resistance.ravel()[chosen]
    part = restricted(product, chosen, free.size)
    return lambda values: np.asarray(part(values / size) / size)


def floored(diagonal: Array) -> Array:
    """Return a diagonal with entries raised to at least MIN_DIAGONAL of the largest."""
    return np.maximum(diagonal, MIN_DIAGONAL * (float(diagonal.max(initial=0.0)) or 1.0))


def sparse_inverse(matrix: sparse.csr_array) -> Linear:
    """Return x → K⁻¹·x for a symmetric matrix K whose diagonal may span decades.

    Sparse LU in symmetric order factors the matrix.
    """
    from scipy.sparse.linalg import splu  # for panels of many cells

    diagonal = floored(matrix.diagonal())
    size = np.sqrt(diagonal)
    scale = sparse.diags_array(1 / size)
    shift = SPARSE_SHIFT * sparse.eye_array(len(size))
    unit = sparse.csc_array(scale @ matrix @ scale + shift)
    options = {"SymmetricMode": True}
    solve = splu(unit, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve
    return lambda values: np.asarray(solve(values / size) / size)
