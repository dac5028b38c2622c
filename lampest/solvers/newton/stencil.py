"""What the response of a network looks like from afar: a cell sees itself, its row and its column.

(D∘D)_il ≈ 1/A_j² for cells of one row j, 1/B_k² for cells of one column k, R_l² for a cell itself, 0 otherwise, where
A and B are the lines' total conductances; exact up to 1/(rows + columns) on even panels. As diagonal + rows + columns
it is inverted through one matrix of lines × lines (Woodbury): a preconditioner for the curvature of the misfit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

LEAST_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Stencil:
    """own : (rows, columns) 1/d of the diagonal d, zero at cells that are left out. inner : (lines)², the inverse of
    S⁻¹ + Uᵀ diag(own) U, where U has a column for every line and S its 1/A² or 1/B².
    """

    own: Array
    inner: Array

    @classmethod
    def of(cls, conductance: Array, two_point_resistance: Array, free: NDArray[np.bool_]) -> "Stencil":
        """The stencil over the free cells of a network; all (rows, columns), siemens and ohm."""
        across, along = conductance.sum(axis=1) ** -2.0, conductance.sum(axis=0) ** -2.0
        square = two_point_resistance**2
        diagonal = np.maximum(square - across[:, None] - along, LEAST_SHARE * square)
        own = np.where(free, 1 / diagonal, 0.0)
        rows = len(across)
        matrix = np.diag(np.concatenate([1 / across + own.sum(axis=1), 1 / along + own.sum(axis=0)]))
        matrix[:rows, rows:] = own
        matrix[rows:, :rows] = own.T
        return cls(own, np.linalg.inv(matrix))

    def solve(self, values: Array) -> Array:
        """(stencil of D∘D)⁻¹·x over the free cells, (rows, columns)."""
        first = self.own * values
        lines = self.inner @ np.concatenate([first.sum(axis=1), first.sum(axis=0)])
        rows = len(first)
        solved: Array = first - self.own * (lines[:rows, None] + lines[None, rows:])
        return solved
