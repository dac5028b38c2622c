"""Least squares by orthogonal factorisation (QR): φ ≈ ½|b + A s|² near a point, with twice the digits of ∇²φ.

Row i of A is √κ_i·∂x_i/∂u and b_i = ρ'(x_i)/√κ_i, κ = ρ'(x)/x, so that Aᵀb is the gradient. A penalty may outweigh the
data by the square of what ∇²φ allows.
Source: Björck, Numerical Methods for Least Squares Problems, 1996, sections 4.4 (heavy rows) and 9.2 (Gauss, Newton).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from lampest.cost.problem import Evaluation, Part, residuals
from lampest.panel.panel import Array
from lampest.solvers.hessian import DENSE_STIFF_CELLS, Hessian, block_diagonal, slopes_of

EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Squares:
    """matrix : A (rows, free cells), its columns divided by `size`. right : b (rows)."""

    matrix: Array
    right: Array
    size: Array

    @classmethod
    def of(cls, hessian: Hessian, free: NDArray[np.intp]) -> "Squares":
        """Of a point, over its free cells."""
        matrices, rights = [], []
        for part, value, slope in sloped(hessian.at, free):
            pull, stiffness = slopes_of(hessian, part, value)
            root = np.sqrt(stiffness)
            matrices.append(slope * root[:, None])
            rights.append(pull / np.where(root > 0, root, 1.0))
        matrix = np.concatenate(matrices)
        size = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
        size = np.maximum(size, EPSILON * size.max(initial=1e-300))
        return cls(matrix / size, np.concatenate(rights), size)

    def step(self, damping: float) -> Array:
        """argmin |b + A s|² + damping·|s·size|²."""
        if not damping:
            upper, turned, order = self._orthogonal
        else:
            shift = np.sqrt(damping) * np.eye(len(self.size))
            rows, right = np.concatenate([self.matrix, shift]), np.concatenate([self.right, np.zeros(len(shift))])
            upper, turned, order = _factored(rows, right)
        rank = int(np.sum(np.abs(np.diag(upper)) > len(upper) * EPSILON * abs(upper[0, 0])))
        step = np.zeros(len(self.size))
        step[order[:rank]] = -linalg.solve_triangular(upper[:rank, :rank], turned[:rank])
        return np.asarray(step / self.size)

    @cached_property
    def _orthogonal(self) -> tuple[Array, Array, NDArray[np.intp]]:
        return _factored(self.matrix, self.right)

    def newton(self, matrix: Array) -> tuple[float, float, Array, float] | None:
        """(λ, δλ, s, decrement) of ∇²φ = `matrix` over the free cells; None where A has no full rank.

        λ : the least eigenvalue of M = R⁻ᵀ ∇²φ R⁻¹, near 1 where the residuals are nearly linear; it has ∇²φ's sign.
        δλ : what rounding of ∇²φ may make of it. s = −R⁻¹ M⁻¹ Qᵀb, the Newton step, and √(bᵀQ M⁻¹ Qᵀb).
        """
        upper, turned, order = self._orthogonal
        if abs(upper[-1, -1]) <= len(upper) * EPSILON * abs(upper[0, 0]):
            return None
        inverse = linalg.solve_triangular(upper, np.eye(len(upper)))
        square = self.matrix.T @ self.matrix
        rest = (matrix / self.size[:, None] / self.size - square)[np.ix_(order, order)]
        values, vectors = np.linalg.eigh(np.eye(len(upper)) + inverse.T @ rest @ inverse)
        lost = EPSILON * float(np.sum(inverse**2))
        if values[0] <= 0:
            return float(values[0]), lost, np.zeros(len(order)), float("inf")
        along = vectors.T @ turned
        step = np.zeros(len(order))
        step[order] = -inverse @ (vectors @ (along / values))
        return float(values[0]), lost, np.asarray(step / self.size), float(np.sqrt(np.sum(along**2 / values)))


def runs_off(hessian: Hessian, free: NDArray[np.intp]) -> bool:
    """Whether least squares, which bear more digits than second derivatives, would still move a cell tenfold."""
    if not 0 < len(free) <= DENSE_STIFF_CELLS:
        return False
    return bool(np.abs(Squares.of(hessian, free).step(0.0)).max() > np.log(10))


def _factored(matrix: Array, right: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """(R, Qᵀb, order) with matrix[:, order] = QR; heavy rows first, without which light ones lose their digits."""
    heavy = np.argsort(-np.abs(matrix).max(axis=1))
    turn, upper, order = linalg.qr(matrix[heavy], mode="economic", pivoting=True, check_finite=False)
    return upper, turn.T @ right[heavy], order


def sloped(at: Evaluation, free: NDArray[np.intp]) -> Iterator[tuple[Part, Array, Array]]:
    """(rows, x, ∂x/∂u (rows, free cells)) of the residuals that read readings, and of all others."""
    cells = sparse.diags_array(at.cell_resistance.ravel())
    sensitivity = block_diagonal([network.sensitivity() for network in at.networks])[:, free]
    found = residuals(at.cost)
    for part in (found.data, found.penalties):
        direct = sparse.csc_array(part.jacobian("by_cells", at) @ cells)[:, free].toarray()
        yield part, part.values(at), np.asarray(direct + part.jacobian("by_model", at) @ sensitivity)
