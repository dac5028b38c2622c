"""What the response of a floating network looks like from afar: a cell sees itself, its row and its column.

(D∘D)_il ≈ 1/A_j² for cells of one row j, 1/B_k² for cells of one column k, R_l² for a cell itself, 0 otherwise, where
A and B are the lines' total conductances; exact up to 1/(rows + columns) on even panels. As diagonal + rows + columns
it is inverted through one matrix of lines × lines (Woodbury): a preconditioner for the curvature of the misfit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.kirchhoff import line_sums
from lampest.panel.network import Afar
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
        cells, lines = _parts(conductance, two_point_resistance)
        diagonal = np.where(free, 1 / cells, 0.0)
        return cls(diagonal, np.linalg.inv(np.diag(1 / lines) + _between_lines(diagonal)))

    def solve(self, values: Array) -> Array:
        """(stencil of D∘D)⁻¹·x over the free cells, (rows, columns)."""
        first = self.diagonal * values
        lines = self.inner @ np.concatenate([first.sum(axis=1), first.sum(axis=0)])
        rows = len(first)
        solved: Array = first - self.diagonal * (lines[:rows, None] + lines[None, rows:])
        return solved


@dataclass(frozen=True, eq=False)
class StencilSquare:
    """(JᵀWJ + diag(c))⁻¹ with J = S·diag(g), S = diag(d) + U K Uᵀ the stencil of D∘D, W = diag(w).

    (JᵀWJ + diag(c)) = G(diag(d²w + r²c) + [dwU, U]·M·[dwU, U]ᵀ)G, M = [[0, K], [K, K UᵀwU K]], so that Woodbury's
    formula takes one inverse of twice as many lines. inverse : (rows, columns) 1/(d²w + r²c), zero at cells that are
    left out. heavy : d·w. inner : (2·lines)², (M⁻¹ + [dwU, U]ᵀ·inverse·[dwU, U])⁻¹. cell_resistance : r, ohm.
    """

    inverse: Array
    heavy: Array
    inner: Array
    cell_resistance: Array

    @classmethod
    def of(
        cls, conductance: Array, two_point_resistance: Array, weight: Array, diagonal: Array, free: NDArray[np.bool_]
    ) -> "StencilSquare":
        """w > 0 : `weight`, c ≥ 0 : `diagonal`; all (rows, columns), siemens and ohm."""
        cells, lines = _parts(conductance, two_point_resistance)
        inverse = np.where(free, 1 / (cells**2 * weight + diagonal / conductance**2), 0.0)
        heavy = cells * weight
        mixed = np.diag(1 / lines) + _between_lines(heavy * inverse)
        outer = _between_lines(heavy**2 * inverse - weight)
        inner = np.linalg.inv(np.block([[outer, mixed], [mixed, _between_lines(inverse)]]))
        return cls(inverse, heavy, inner, 1 / conductance)

    def __call__(self, values: Array) -> Array:
        """Of values (rows, columns) at the free cells; likewise."""
        first = self.inverse * values * self.cell_resistance
        heavy = self.heavy * first
        sums = (heavy.sum(axis=1), heavy.sum(axis=0), first.sum(axis=1), first.sum(axis=0))
        above, below = np.split(self.inner @ np.concatenate(sums), 2)
        rows = len(first)
        back = self.heavy * (above[:rows, None] + above[rows:]) + (below[:rows, None] + below[rows:])
        solved: Array = (first - self.inverse * back) * self.cell_resistance
        return solved


def square_from_afar(conductance: Array, two_point_resistance: Array, weight: Array) -> Afar:
    """JᵀWJ with J = S·diag(g), as its parts: diag(g²d²w), [g·dwU, g·U] and M of `StencilSquare`; w ≥ 0 (rows, columns).

    conductance, two_point_resistance : (rows, columns) siemens and ohm.
    """
    cells, lines = _parts(conductance, two_point_resistance)
    heavy = conductance * cells * weight
    mixed = lines[:, None] * _between_lines(weight) * lines
    inner = np.block([[np.zeros_like(mixed), np.diag(lines)], [np.diag(lines), mixed]])
    return Afar(heavy * conductance * cells, np.stack([heavy, conductance]), inner)


def _parts(conductance: Array, two_point_resistance: Array) -> tuple[Array, Array]:
    """(d, K): the diagonal (rows, columns) of the stencil, and 1/A², 1/B² of the lines."""
    across, along = conductance.sum(axis=1) ** -2.0, conductance.sum(axis=0) ** -2.0
    square = two_point_resistance**2
    return np.maximum(square - across[:, None] - along, LEAST_SHARE * square), np.concatenate([across, along])


def _between_lines(values: Array) -> Array:
    """Uᵀ diag(x) U, (lines)², of x (rows, columns)."""
    rows, columns = values.shape
    matrix = np.zeros((rows + columns, rows + columns))
    matrix[:rows, rows:], matrix[rows:, :rows] = values, values.T
    matrix.flat[:: rows + columns + 1] = line_sums(values)
    return matrix
