"""Kirchhoff's current law for a matrix of cells, stated once, and what follows from it in closed form.

Symbols: g (rows, columns) cell conductance in siemens; u, v potentials of row and column lines in volt.
"""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.starmesh import exact_two_point_resistance

SAFE_CONDITION = 1e4  # rounding times that leaves 11 digits; ordinary panels have about 3·(rows + columns)


def current_balance(conductance: Any, row_potential: Any, column_potential: Any) -> tuple[Any, Any]:
    """Net current out of every line: I_j = Σ_k g_jk (u_j − v_k) and I_k = Σ_j g_jk (v_k − u_j).

    Parameters
    ----------
    conductance : (rows, columns) siemens.
    row_potential, column_potential : (rows, patterns) and (columns, patterns) volt, one column for each pattern.

    Returns the two balances in ampere, same shapes as the potentials. numpy arrays and CasADi matrices alike.
    Source: paper, equation (2).
    """
    rows, columns = conductance.shape
    from_rows = (conductance @ np.ones((columns, 1))) * row_potential - conductance @ column_potential
    from_columns = (conductance.T @ np.ones((rows, 1))) * column_potential - conductance.T @ row_potential
    return from_rows, from_columns


def laplacian(conductance: Array) -> Array:
    """L with L·(u, v) = current_balance(g, u, v): (rows + columns)² siemens, singular; paper, equation (3)."""
    rows = conductance.shape[0]
    unit = np.eye(sum(conductance.shape))
    return np.vstack(current_balance(conductance, unit[:rows], unit[rows:]))


def grounding(two_point_resistance: Array) -> Array:
    """Tie to ground: the line with the largest Σ 1/R gets a conductance of that size, all others none.

    (rows, columns) ohm → (rows + columns) siemens. A tie at a single line carries no current, so potential differences
    are those of the paper's grounded line, equation (5), while the line can be chosen by the data.
    """
    admittance = 1 / two_point_resistance
    total = np.concatenate([admittance.sum(axis=1), admittance.sum(axis=0)])
    tie = np.zeros_like(total)
    tie[np.argmax(total)] = total.max()
    return tie


@dataclass(frozen=True)
class Network:
    """A solved network: impedance Z = (L + diag(tie))⁻¹ (lines, lines) in ohm, of a conductance (rows, columns)."""

    conductance: Array
    impedance: Array

    @classmethod
    def solve(cls, conductance: Array, tie: Array) -> "Network":
        """Invert the tied Laplacian. Raises numpy.linalg.LinAlgError where a line is not connected."""
        return cls(conductance, np.linalg.inv(laplacian(conductance) + np.diag(tie)))

    @property
    def rows(self) -> int:
        """Number of row lines."""
        return int(self.conductance.shape[0])

    def two_point_resistance(self) -> Array:
        """R_jk = Z_jj + Z_kk − 2 Z_jk, (rows, columns) ohm: what is measured between a row and a column."""
        diagonal, rows = np.diag(self.impedance), self.rows
        resistance: Array = diagonal[:rows, None] + diagonal[None, rows:] - 2 * self.impedance[:rows, rows:]
        return resistance

    def condition(self) -> float:
        """Σ_l |L_ll Z_ll| over the lines: how many times the rounding of L can reappear in any two-point resistance.

        With v = Z·b the potentials of a cell's unit current, an error ε_l of L_ll moves R = bᵀZb by ε_l·v_l², and
        v_l² ≤ Z_ll·R (Cauchy and Schwarz). Infinite or no number where the inverse is spoilt altogether.
        """
        own = np.concatenate([self.conductance.sum(axis=1), self.conductance.sum(axis=0)])
        return float(np.sum(np.abs(own * np.diag(self.impedance))))

    def injected(self, weights: Array, potentials: Array) -> Array:
        """L_w·V: currents (lines, patterns) that conductances w (rows, columns) draw at potentials V."""
        return np.vstack(current_balance(weights, potentials[: self.rows], potentials[self.rows :]))

    def differences(self, left: Array, right: Array, symmetric: bool) -> Array:
        """b_iᵀ ½(P + Pᵀ) b_i of P = left·right for all cells i at once, b_i = the cell's ±1 incidence vector.

        Only what is read is multiplied out: the diagonal and the blocks between rows and columns, one where P is known
        to be symmetric.
        """
        rows = self.rows
        diagonal = np.einsum("ij,ji->i", left, right)
        across = left[:rows] @ right[:, rows:]
        across = 2 * across if symmetric else across + (left[rows:] @ right[:, :rows]).T
        differences: Array = diagonal[:rows, None] + diagonal[None, rows:] - across
        return differences

    def conductance_product(self, weights: Array) -> Array:
        """(∂R/∂g)·w = −bᵀ Z L_w Z b, which is also (∂R/∂g)ᵀ·w; w (rows, columns), result likewise.

        Costs (rows + columns)³ and never forms the matrix of cells × cells.
        """
        return -self.differences(self.impedance, self.injected(weights, self.impedance), symmetric=True)

    def transfer(self) -> Array:
        """D = Bᵀ Z B (cells, cells) ohm: ∂R_i/∂g_l = −D_il² and ∂R_i/∂r_l = (D_il/r_l)²."""
        return self.between_cells(self.impedance)

    def bend(self, weights: Array) -> Array:
        """Z L_w Z (lines, lines): what second derivatives weighted by w (rows, columns) are made of."""
        return self.impedance @ self.injected(weights, self.impedance)

    def bent_products(self, weights: Array, bend: Array) -> tuple[Array, Array]:
        """−(∂R/∂g)·p and ½ Σ_i w_i ∂²R_i/∂g² · p for p = `weights` and bend = Z L_w Z, both (rows, columns)."""
        injected = self.injected(weights, self.impedance)
        through = self.differences(self.impedance, injected, symmetric=True)
        return through, self.differences(bend, injected, symmetric=False)

    def between_cells(self, matrix: Array) -> Array:
        """Bᵀ K B (cells, cells), B = the incidence vectors of all cells; K (lines, lines)."""
        rows, cells = self.rows, self.conductance.size
        at_cells = matrix[:, :rows][:, :, None] - matrix[:, rows:][:, None, :]
        return (at_cells[:rows, None] - at_cells[None, rows:]).reshape(cells, cells)


def two_point_resistance(cell_resistance: Array) -> Array:
    """R = f(r): two-point resistances of a panel, (rows, columns) or (frames, rows, columns) ohm → the same shape.

    At least ten digits of every entry are right: where an inverse does not promise them, it is not used, but
    exact_two_point_resistance. That also knows open cells (infinite), shorts (zero) and lines that nothing connects
    (R infinite). Raises ValueError where a cell is negative or no number.
    Source: paper, equations (5)-(10).
    """
    if cell_resistance.ndim == 3:
        return np.stack([two_point_resistance(frame) for frame in cell_resistance])
    if not np.all(cell_resistance >= 0):
        raise ValueError("cell resistances must be zero or positive, and numbers")
    with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
        network = Network.solve(1 / cell_resistance, grounding(cell_resistance))
        if network.condition() <= SAFE_CONDITION:
            return network.two_point_resistance()
    return exact_two_point_resistance(cell_resistance)


def uniform_factor(rows: int, columns: int) -> float:
    """R/r = (M + N − 1)/(MN) on a panel of equal cells."""
    return (rows + columns - 1) / (rows * columns)
