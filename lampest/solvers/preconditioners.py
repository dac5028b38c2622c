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
        diagonal = np.full(cell_resistance.size, np.mean(pivots))
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
    local : sparse.csr_array, shape (cells, cells)
        T + diag(c).
    lines : sparse.csr_array, shape (cells, vectors · lines)
        Coarse space V of rows and columns; without columns where it does not repay its cost.
    mixed : array, shape (vectors · lines, vectors · lines)
        S.
    coarse : array, shape (vectors · lines, vectors · lines)
        (VᵀAV)⁻¹.
    """

    solve: Linear
    local: sparse.csr_array
    lines: sparse.csr_array
    mixed: Array
    coarse: Array

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
            weight = hessian.reading_weight[0]
            weight = np.maximum(weight, WEAK_WEIGHT * (weight.max(initial=0.0) or 1.0))
            parts = hessian.at.networks[0].normal_by_lines(weight)
            level = local(parts.own.ravel())
            along = parts.along / cells
            if len(along) and level.nnz <= level.shape[0]:
                diagonal = floored(level.diagonal()).reshape(cells.shape[1:])
                return Woodbury(cells, diagonal, along, parts.mixed_inverse)
            if len(along):
                lines = _columns(along)
                mixed = parts.mixed.matrix()
                # VᵀAV = Vᵀ(T + diag(c))V + (VᵀV) S (VᵀV)
                crossed = (lines.T @ (level @ lines)).toarray()
                square = (lines.T @ lines).toarray()
                added = square @ mixed @ square
                if np.quantile(added.diagonal() / crossed.diagonal(), WEAK_LINE_SHARE) >= 1:
                    coarse = _scaled_inverse(crossed + added)
                    return cls(cells, sparse_inverse(level), level, lines, mixed, coarse)
        level = local(hessian.own)
        nothing = np.zeros((0, 0))
        none = sparse.csr_array((cells.size, 0))
        return cls(cells, sparse_inverse(level), level, none, nothing, nothing)

    def over(self, free: Mask, cell_resistance: Array) -> Linear:
        return _by_log(self._solved, free, cell_resistance)

    def _solved(self, values: Array) -> Array:
        """Return the product Q v + b − Q A b, b = (T + diag(c))⁻¹ (v − A Q v)."""

        def coarse(values: Array) -> Array:
            return np.asarray(self.lines @ (self.coarse @ (self.lines.T @ values)))

        def product(values: Array) -> Array:
            return np.asarray(
                self.local @ values + self.lines @ (self.mixed @ (self.lines.T @ values))
            )

        first = coarse(values)
        between = self.solve(values - product(first))
        return first + between - coarse(product(between))


def _columns(along: Array) -> sparse.csr_array:
    """Return V = [diag(v)·U for v in along], U the incidence of cells and lines, sparse."""
    row, column = np.indices(along.shape[1:]).reshape(2, -1)
    places = np.concatenate([row, along.shape[1] + column])
    incidence = sparse.csr_array((np.ones(len(places)), (np.tile(np.arange(len(row)), 2), places)))
    return sparse.csr_array(
        sparse.hstack([sparse.diags_array(v.ravel()) @ incidence for v in along])
    )


def _scaled_inverse(matrix: Array) -> Array:
    """Return the inverse of a matrix scaled to a unit diagonal.

    A shift serves columns of V that coincide, as they do on even panels.
    """
    size = np.sqrt(np.maximum(np.abs(matrix.diagonal()), TINY))
    unit = matrix / size[:, None] / size
    unit.flat[:: len(unit) + 1] += SHIFTS[0]
    inverse = np.linalg.inv(unit) / size[:, None] / size
    return (inverse + inverse.T) / 2


@dataclass(frozen=True, eq=False)
class Woodbury(Preconditioner):
    """A⁻¹ between any cells, exactly, where T + diag(c) is diagonal.

    Attributes
    ----------
    diagonal : array, shape (rows, columns)
        T + diag(c), by ohm.
    along : array, shape (vectors, rows, columns)
        Columns V = [diag(v)·U for v in along], U the incidence of cells and lines.
    mixed_inverse : LineBlocks
        S⁻¹.
    """

    diagonal: Array
    along: Array
    mixed_inverse: LineBlocks

    def over(self, free: Mask, cell_resistance: Array) -> Linear:
        """Return (D + V S Vᵀ)⁻¹ = D⁻¹ − D⁻¹V (S⁻¹ + VᵀD⁻¹V)⁻¹ VᵀD⁻¹ over the free cells."""
        along = self.along
        inverse = np.where(free.reshape(self.diagonal.shape), 1 / self.diagonal, 0.0)
        inner: Linear = np.zeros_like  # D⁻¹ alone remains if contrasts exceed double precision
        with suppress(np.linalg.LinAlgError):
            grids = along[:, None] * along * inverse
            inner = (self.mixed_inverse + LineBlocks(line_sums(grids), grids)).inverse()

        def solve(values: Array) -> Array:
            scaled = inverse * values.reshape(inverse.shape)
            on_lines = inner(line_sums(along * scaled).ravel()).reshape(len(along), -1)
            rows, columns = np.split(on_lines, [along.shape[1]], axis=1)
            back = (along * (rows[:, :, None] + columns[:, None])).sum(axis=0)
            return np.asarray((scaled - inverse * back).ravel())

        return _by_log(solve, free, cell_resistance)


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
    return lambda values: part(values / size) / size


def floored(diagonal: Array) -> Array:
    """Return a diagonal with entries raised to at least MIN_DIAGONAL of the largest."""
    return np.maximum(diagonal, MIN_DIAGONAL * (diagonal.max(initial=0.0) or 1.0))


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
    return lambda values: solve(values / size) / size
