"""Preconditioners M ≈ ∇²φ of conjugate gradients, kept from frame to frame while they serve.

Small problems: the Cholesky factor of ∇²φ, or of Gauss–Newton's matrix. Large ones: A = T + diag(c) + V S Vᵀ, in ohm, T
of the penalties, c of each cell's own reading, V two columns for every line; with the coarse space Q = V (VᵀAV)⁻¹ Vᵀ,
M⁻¹ = Q + (1 − QA) (T + diag(c))⁻¹ (1 − AQ).
Source: Nabben & Vuik, SIAM J. Numer. Anal. 42, 2004 (balancing).
"""

from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.linalg import lapack
from scipy.sparse.linalg import splu

from lampest.panel.kirchhoff import bipartite_matrix, line_sums
from lampest.panel.panel import Array
from lampest.panel.trust_region import Linear, restricted
from lampest.solvers.hessian import Hessian

# Of the largest entry of a diagonal: double precision does not distinguish a smaller one from zero.
MIN_DIAGONAL = 1e-12
SHIFTS = (1e-10, 1e-6, 1e-3)  # of a unit diagonal: where rounding makes Gauss–Newton's matrix indefinite
WEAK_WEIGHT = 1e-3  # of the largest weight: readings beyond a loss's corner, which still tie a line together
Numbers = NDArray[np.intp]
Free = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Preconditioner(ABC):
    """M, and the cell resistance (frames, rows, columns) ohm where it was made."""

    cell_resistance: Array

    def distance(self, cell_resistance: Array) -> float:
        """Return the largest change of log r since; infinite for another panel."""
        if cell_resistance.shape != self.cell_resistance.shape:
            return float("inf")
        return float(np.abs(np.log(cell_resistance / self.cell_resistance)).max())

    @abstractmethod
    def over(self, free: Free, cell_resistance: Array) -> Linear:
        """M⁻¹·p in u = log r between the free cells, flat; symmetric and positive definite."""


@dataclass(frozen=True, eq=False)
class Cholesky(Preconditioner):
    """UᵀU = D⁻¹MD⁻¹ over some cells (numbers).

    Below its diagonal, `triangle` holds what nobody reads.

    Attributes
    ----------
    diagonal : array
        Of M, for the other cells.
    norm : float
        ‖UᵀU‖₁.
    """

    cells: Numbers
    triangle: Array
    size: Array
    diagonal: Array
    norm: float

    @classmethod
    def of(cls, cell_resistance: Array, cells: Numbers, matrix: Array, least: float = 0.0) -> "Cholesky | None":
        """Return the factor of a matrix over some cells with `least` added to its unit diagonal; None if indefinite."""
        own = matrix.diagonal()
        if not own.min() > 0:
            return None
        size = np.sqrt(own)
        unit = matrix / size
        unit /= size[:, None]
        unit.flat[:: len(size) + 1] += least
        norm = float(np.abs(unit).sum(axis=0).max())
        triangle, failed = lapack.dpotrf(unit.T, clean=0, overwrite_a=1)  # symmetric, and in LAPACK's order
        if failed or not np.isfinite(norm):
            return None
        diagonal = np.full(cell_resistance.size, float(np.mean(own)))
        diagonal[cells] = own
        return cls(cell_resistance, cells, triangle, size, diagonal, norm)

    def solve(self, values: Array) -> Array:
        """M⁻¹·p over its own cells."""
        return np.asarray(lapack.dpotrs(self.triangle, values / self.size)[0] / self.size)

    def inverse(self) -> Array:
        """M⁻¹ between its own cells, (cells, cells)."""
        upper = np.triu(lapack.dpotri(self.triangle)[0])
        upper.flat[:: len(upper) + 1] /= 2
        return np.asarray((upper + upper.T) / self.size / self.size[:, None])

    def over(self, free: Free, cell_resistance: Array) -> Linear:
        chosen = np.flatnonzero(free)
        if np.array_equal(chosen, self.cells):
            return self.solve
        place = np.full(free.size, -1)
        place[self.cells] = np.arange(len(self.cells))
        known = place[chosen] >= 0
        inner, outer, whole = place[chosen][known], 1 / self.diagonal[chosen], np.zeros(len(self.cells))

        def solve(values: Array) -> Array:
            whole[inner] = values[known]
            solution = outer * values
            solution[known] = self.solve(whole)[inner]
            return solution

        return solve


@dataclass(frozen=True, eq=False)
class TwoLevel(Preconditioner):
    """local : T + diag(c), solve : its inverse. lines : V, or None where they are not worth their cost."""

    solve: Linear
    lines: "CoarseLines | None" = None

    @classmethod
    def of(cls, hessian: Hessian, stiffness: Array | None = None) -> "TwoLevel | Woodbury":
        """Return the preconditioner at a point; Woodbury's where T is diagonal."""
        cells = hessian.at.cell_resistance
        inverse = sparse.diags_array(1 / cells.ravel())

        def local(own: Array) -> sparse.csr_array:
            added = sparse.diags_array(own if stiffness is None else own + stiffness)
            return sparse.csr_array(inverse @ (hessian.penalty_matrix + added) @ inverse)

        if len(cells) == 1:
            weight = np.maximum(
                hessian.reading_weight[0], WEAK_WEIGHT * (hessian.reading_weight.max(initial=0.0) or 1.0)
            )
            parts = hessian.at.networks[0].normal_by_lines(weight)
            level = local(parts.own.ravel())
            level_parts = (level, parts.along / cells, parts.mixed)
            lone = hessian.only_data and parts.along.size > 0
            lines = CoarseLines(*level_parts, np.zeros((0, 0))) if lone else CoarseLines.of(*level_parts)
            if lines is not None and level.nnz <= level.shape[0]:
                return Woodbury(cells, floored(level.diagonal()).reshape(cells.shape[1:]), lines)
            if lines is not None:
                return cls(cells, sparse_inverse(level), lines)
        return cls(cells, sparse_inverse(local(hessian.own)))

    def over(self, free: Free, cell_resistance: Array) -> Linear:
        chosen = np.flatnonzero(free)
        size, part = cell_resistance.ravel()[chosen], restricted(self._solved, chosen, free.size)
        return lambda values: np.asarray(part(values / size) / size)

    def _solved(self, values: Array) -> Array:
        if self.lines is None:
            return self.solve(values)
        first = self.lines.solve(values)
        between = self.solve(values - self.lines.product(first))
        return np.asarray(first + between - self.lines.solve(self.lines.product(between)))


@dataclass(frozen=True, eq=False)
class Woodbury(Preconditioner):
    """A⁻¹ between any cells, exactly, where T + diag(c) is `diagonal`, in ohm (rows, columns)."""

    diagonal: Array
    lines: "CoarseLines"

    def over(self, free: Free, cell_resistance: Array) -> Linear:
        """(D + V S Vᵀ)⁻¹ = D⁻¹ − D⁻¹V (S⁻¹ + VᵀD⁻¹V)⁻¹ VᵀD⁻¹ over the free cells."""
        shape = self.diagonal.shape
        inverse = np.where(free.reshape(shape), 1 / self.diagonal, 0.0)
        inner = np.zeros_like(self.lines.mixed)  # the diagonal alone, where contrasts are beyond double precision
        with catch_warnings(), suppress(np.linalg.LinAlgError):
            simplefilter("ignore", linalg.LinAlgWarning)
            inner = linalg.inv(linalg.inv(self.lines.mixed) + self.lines.between(inverse))
        chosen, flat = np.flatnonzero(free), inverse.ravel()

        def solve(values: Array) -> Array:
            return flat * (values - self.lines.back(inner @ self.lines.sums(flat * values)))

        size, part = cell_resistance.ravel()[chosen], restricted(solve, chosen, free.size)
        return lambda values: np.asarray(part(values / size) / size)


@dataclass(frozen=True, eq=False)
class CoarseLines:
    """V = [diag(v)·U for v in along], U the incidence of cells and lines.

    Attributes
    ----------
    local : sparse.csr_array
        T + diag(c).
    mixed : array
        S.
    coarse : array
        (VᵀAV)⁻¹.
    """

    local: sparse.csr_array
    along: Array
    mixed: Array
    coarse: Array

    @classmethod
    def of(cls, local: sparse.csr_array, along: Array, mixed: Array) -> "CoarseLines | None":
        """Return the lines' correction; None where most lines add less than what they cross."""
        if not len(along):
            return None
        row, column = np.indices(along.shape[1:]).reshape(2, -1)
        number, places = np.tile(np.arange(len(row)), 2), np.concatenate([row, along.shape[1] + column])
        incidence = sparse.csr_array((np.ones(len(places)), (number, places)))
        columns = sparse.csr_array(sparse.hstack([sparse.diags_array(side.ravel()) @ incidence for side in along]))
        length = np.sqrt(np.maximum(columns.multiply(columns).sum(axis=0), 1e-300))
        columns = sparse.csr_array(columns @ sparse.diags_array(1 / length))
        crossed, square = (columns.T @ (local @ columns)).toarray(), (columns.T @ columns).toarray()
        added = square @ (mixed * length[:, None] * length) @ square
        if np.quantile(added.diagonal() / crossed.diagonal(), 0.75) < 1:
            return None
        whole = crossed + added
        size = np.sqrt(np.maximum(np.abs(whole.diagonal()), 1e-300))
        whole = whole / size[:, None] / size
        whole.flat[:: len(whole) + 1] += SHIFTS[0]  # columns that are alike on even panels
        scale = 1 / (size * length)
        inverse = np.linalg.inv(whole) * scale[:, None] * scale
        return cls(local, along, mixed, (inverse + inverse.T) / 2)

    def solve(self, values: Array) -> Array:
        """Q·x."""
        return self.back(self.coarse @ self.sums(values))

    def product(self, values: Array) -> Array:
        """A·x."""
        return np.asarray(self.local @ values + self.back(self.mixed @ self.sums(values)))

    def between(self, values: Array) -> Array:
        """Vᵀ diag(x) V of x (rows, columns)."""
        grids = [[first * second * values for second in self.along] for first in self.along]
        return np.block([[bipartite_matrix(line_sums(grid), grid) for grid in row] for row in grids])

    def sums(self, values: Array) -> Array:
        """Vᵀ·x."""
        return line_sums(self.along * values.reshape(self.along.shape[1:])).ravel()

    def back(self, lines: Array) -> Array:
        """V·y."""
        of_rows, of_columns = np.split(lines.reshape(len(self.along), -1), [self.along.shape[1]], axis=1)
        return np.asarray((self.along * (of_rows[:, :, None] + of_columns[:, None])).sum(axis=0)).ravel()


def preconditioner(hessian: Hessian, free: Free) -> Preconditioner:
    """Return a new one at a point, over the free cells or over all."""
    if not hessian.dense:
        return TwoLevel.of(hessian)
    cells, chosen = hessian.at.cell_resistance, np.flatnonzero(free)
    factor = Cholesky.of(cells, chosen, hessian.between(chosen))
    return factor or gauss_newton_factor(hessian, free) or TwoLevel.of(hessian)


def gauss_newton_factor(hessian: Hessian, free: Free, damping: float = SHIFTS[0]) -> Cholesky | None:
    """Cholesky factor of Gauss–Newton's matrix over the free cells, with `damping` or more on its unit diagonal.

    None on large problems, or where rounding leaves no positive pivot.
    """
    if not hessian.dense:
        return None
    chosen, cells = np.flatnonzero(free), hessian.at.cell_resistance
    matrix = hessian.gauss_newton_between(chosen).copy()
    matrix.flat[:: len(matrix) + 1] = floored(np.diag(matrix))
    tried = (Cholesky.of(cells, chosen, matrix, shift) for shift in (damping, *SHIFTS) if shift >= damping)
    return next((factor for factor in tried if factor is not None), None)


def floored(diagonal: Array) -> Array:
    """Return the diagonal, nowhere below MIN_DIAGONAL of its largest entry."""
    return np.asarray(np.maximum(diagonal, MIN_DIAGONAL * (float(diagonal.max(initial=0.0)) or 1.0)))


def sparse_inverse(matrix: sparse.csr_array) -> Linear:
    """Return the inverse of a symmetric matrix whose diagonal may span decades, by sparse LU in symmetric order."""
    diagonal = floored(matrix.diagonal())
    if matrix.nnz <= len(diagonal):
        inverse = 1 / diagonal
        return lambda values: inverse * values
    size = np.sqrt(diagonal)
    scale = sparse.diags_array(1 / size)
    unit = sparse.csc_array(scale @ matrix @ scale + 1e-9 * sparse.eye_array(len(size)))
    options = {"SymmetricMode": True}
    solve = splu(unit, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve
    return lambda values: np.asarray(solve(values / size) / size)
