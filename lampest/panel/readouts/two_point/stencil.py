"""What the response of a floating network looks like from afar: a cell sees itself, its row and its column.

(D∘D)_il ≈ 1/A_j² for cells of one row j, 1/B_k² for cells of one column k, R_l² for a cell itself, 0 otherwise, where
A and B are the lines' total conductances; exact up to 1/(rows + columns) on even panels. As diagonal + rows + columns
it is inverted through one matrix of lines × lines (Woodbury): a preconditioner for the curvature of the misfit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

LEAST_SHARE = 0.05  # of R²: where the lines alone explain a cell's own response, the diagonal must not vanish


@dataclass(frozen=True, eq=False)
class Stencil:
    """diagonal : (rows, columns) 1/d of the diagonal d, zero at cells that are left out. inner : (lines)², the inverse
    of S⁻¹ + Uᵀ diag(1/d) U, where U has a column for every line and S its 1/A² or 1/B².
    """

    diagonal: Array
    inner: Array

    @classmethod
    def of(cls, conductance: Array, two_point_resistance: Array, free: NDArray[np.bool_]) -> "Stencil":
        """The stencil over the free cells of a network; all (rows, columns), siemens and ohm."""
        across, along = conductance.sum(axis=1) ** -2.0, conductance.sum(axis=0) ** -2.0
        square = two_point_resistance**2
        cells = np.maximum(square - across[:, None] - along, LEAST_SHARE * square)
        diagonal = np.where(free, 1 / cells, 0.0)
        rows = len(across)
        matrix = np.diag(np.concatenate([1 / across + diagonal.sum(axis=1), 1 / along + diagonal.sum(axis=0)]))
        matrix[:rows, rows:] = diagonal
        matrix[rows:, :rows] = diagonal.T
        return cls(diagonal, np.linalg.inv(matrix))

    def solve(self, values: Array) -> Array:
        """(stencil of D∘D)⁻¹·x over the free cells, (rows, columns)."""
        first = self.diagonal * values
        lines = self.inner @ np.concatenate([first.sum(axis=1), first.sum(axis=0)])
        rows = len(first)
        solved: Array = first - self.diagonal * (lines[:rows, None] + lines[None, rows:])
        return solved


@dataclass(frozen=True, eq=False)
class StencilInverse:
    """J⁻¹ ≈ r·S⁻¹ with the stencil S in place of D∘D; cell_resistance : r (rows, columns) ohm."""

    stencil: Stencil
    cell_resistance: Array

    def solve(self, values: Array) -> Array:
        """r·S⁻¹ x."""
        solved: Array = self.stencil.solve(values) * self.cell_resistance
        return solved

    def solve_transposed(self, values: Array) -> Array:
        """S⁻¹ (r x)."""
        return self.stencil.solve(values * self.cell_resistance)
