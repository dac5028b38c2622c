"""A solved network of cells: the only owner of the impedance Z = (L(g) + diag(t))⁻¹ of a panel's lines.

A readout ties lines to ground (t, siemens) and reads a function of a few entries of Z. Derivatives are in u = log r:
with D = Z·B, B the ±1 incidence vectors of the cells, ∂Z_ab/∂u_c = g_c D_ac D_bc.
"""

from abc import ABC, abstractmethod
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from lampest.panel.kirchhoff import laplacian, line_sums
from lampest.panel.panel import Array

Block = tuple[slice, slice]
Numbers = NDArray[np.intp]


class ReadCircuit(Hashable, Protocol):
    """What a network asks of the readout that it is read by; see `lampest.panel.readouts.readout.Readout`."""

    def ties(self, measured: Array) -> Array:
        """t (lines) siemens: what ties every line to ground, for readings (rows, columns)."""

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """y = h(Z_jj, Z_kk, Z_jk), element by element; numpy arrays and CasADi alike."""

    def network(self, cell_resistance: Array, ties: Array) -> "Network":
        """The solved network of cells (rows, columns) ohm, without wire."""


class SecondOrder(Protocol):
    """H = diag(g)·Σ_i w_i ∂²y_i/∂g²·diag(g) for given weights w; Σ_i w_i ∂²y_i/∂u² = H − diag(Jᵀw)."""

    def products(self, step: Array) -> tuple[Array, Array]:
        """(J·p, H·p) of a step p in u; all (rows, columns)."""

    def matrix(self, cells: Numbers | None = None) -> Array:
        """H, (cells, cells); between some cells, given by their numbers."""

    def adjoint(self) -> Array:
        """Jᵀ·w, (rows, columns), from what H needs anyway."""


@dataclass(frozen=True, eq=False)
class NormalByLines:
    """diag(own) + V·mixed·Vᵀ over cells, V = [diag(v)·U for v in along], U (cells, lines) whose columns are the lines.

    own (rows, columns), along (k, rows, columns), mixed (k·lines)².
    """

    own: Array
    along: Array
    mixed: Array


@dataclass(frozen=True, eq=False)
class Network(ABC):
    """cell_resistance, conductance : (rows, columns) ohm and siemens, each other's reciprocal; of floating lines also
    (…, rows, columns), many networks at once.

    The impedance Z (lines, lines) in ohm is the network's own affair.
    """

    cell_resistance: Array
    conductance: Array
    _impedance: Array

    @property
    def rows(self) -> int:
        """Number of row lines."""
        return int(self.conductance.shape[-2])

    @abstractmethod
    def reading(self) -> Array:
        """y (rows, columns): what is read between every row and every column."""

    @abstractmethod
    def forward(self, step: Array) -> Array:
        """J·p = ∂y/∂u·p for a step p of u = log r, (rows, columns); (rows + columns)³ operations."""

    @abstractmethod
    def adjoint(self, weights: Array) -> Array:
        """Jᵀ·w for weights w of the readings, (rows, columns); (rows + columns)³ operations."""

    @abstractmethod
    def sensitivity(self, cells: Numbers | None = None, readings: Numbers | None = None) -> Array:
        """J (readings, cells); for some cells, or some readings of these, given by their numbers."""

    @abstractmethod
    def own_response(self) -> Array:
        """The diagonal of J, (rows, columns): what a cell does to its own reading."""

    @abstractmethod
    def second_order(self, weights: Array) -> SecondOrder:
        """Second derivatives of Σ w·y, for weights w of the readings (rows, columns)."""

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        """What approximates JᵀWJ for weights w ≥ 0 of the readings (rows, columns): J's diagonal, and what lines add,
        where a kind knows that.
        """
        own: Array = weight * self.own_response() ** 2
        return NormalByLines(own, np.zeros((0, *own.shape)), np.zeros((0, 0)))

    def potentials(self) -> Array:
        """(lines, patterns) volt per ampere: what every line stands at while a unit current enters line `pattern`."""
        return self._impedance

    def condition(self) -> float:
        """Σ_l |L_ll Z_ll| over the lines: how many times the rounding of L can reappear in any reading, as an error ε_l
        of L_ll moves bᵀZb by ε_l·v_l², v = Z·b, and v_l² ≤ Z_ll·bᵀZb. Infinite or NaN where the inverse is spoilt.
        """
        return float(np.sum(np.abs(line_sums(self.conductance) * np.diag(self._impedance))))

    def changed(self, block: Block, conductance: Array) -> Self:
        """The network with other conductances in a block: Z − Z_S (1 + ΔL Z_SS)⁻¹ ΔL Z_Sᵀ, S the lines of the block."""
        lines = self.lines_of(block)
        change = laplacian(conductance - self.conductance[block])
        towards = self._impedance[:, lines]
        core = np.linalg.solve(np.eye(len(lines)) + change @ towards[lines], change)
        cells, whole = self.cell_resistance.copy(), self.conductance.copy()
        cells[block], whole[block] = 1 / conductance, conductance
        impedance = self._impedance - towards @ core @ towards.T
        return replace(self, cell_resistance=cells, conductance=whole, _impedance=impedance)

    def lines_of(self, block: Block) -> NDArray[np.intp]:
        """The numbers of a block's lines, rows first."""
        rows, columns = self.conductance.shape
        return np.concatenate([np.arange(rows)[block[0]], rows + np.arange(columns)[block[1]]])

    def _differences(self, left: Array, right: Array, symmetric: bool) -> Array:
        """b_iᵀ ½(P + Pᵀ) b_i of P = left·right for all cells i; only the diagonal and the blocks between rows and
        columns are multiplied out, one where P is symmetric.
        """
        rows = self.rows
        diagonal = np.einsum("...ij,...ji->...i", left, right)
        across = left[..., :rows, :] @ right[..., rows:]
        across = 2 * across if symmetric else across + (left[..., rows:, :] @ right[..., :rows]).swapaxes(-1, -2)
        differences: Array = diagonal[..., :rows, None] + diagonal[..., None, rows:] - across
        return differences

    def _across(self, matrix: Array) -> Array:
        """bᵀ K b of every cell's own b, (rows, columns); K (lines, lines), symmetric."""
        diagonal, rows = matrix.diagonal(axis1=-2, axis2=-1), self.rows
        across: Array = diagonal[..., :rows, None] + diagonal[..., None, rows:] - 2 * matrix[..., :rows, rows:]
        return across

    def _between_cells(self, matrix: Array) -> Array:
        """Bᵀ K B (…, cells, cells), B = the incidence vectors of all cells; K (…, lines, lines)."""
        *several, rows, columns = self.conductance.shape
        at_cells = matrix[..., :rows, None] - matrix[..., None, rows:]
        between = at_cells[..., :rows, None, :, :] - at_cells[..., None, rows:, :, :]
        return between.reshape(*several, rows * columns, rows * columns)


def inverse_of(conductance: Array, ties: Array) -> Array:
    """Z = (L(g) + diag(t))⁻¹, (…, lines, lines) ohm. Raises numpy.linalg.LinAlgError where a line is not connected."""
    if conductance.ndim > 2:
        return _inverses(conductance, ties)
    matrix = laplacian(conductance)
    np.einsum("...ii->...i", matrix)[...] += ties
    return np.linalg.inv(matrix)


def _inverses(conductance: Array, ties: Array) -> Array:
    """The same of many small networks in a third of the time: rows are eliminated, S = diag(b) − Gᵀ diag(a)⁻¹ G.

    S⁻¹ by Gauss and Jordan's elimination, which needs no pivots as S is positive definite, for all networks at once.
    """
    rows, columns = conductance.shape[-2:]
    of_rows, of_columns = np.split(line_sums(conductance) + ties, [rows], axis=-1)
    shares = conductance / of_rows[..., None]
    left = np.moveaxis(-conductance.swapaxes(-1, -2) @ shares, (-2, -1), (0, 1)).copy()
    np.einsum("ii...->i...", left)[...] += np.moveaxis(of_columns, -1, 0)
    for pivot in range(columns):
        if not (left[pivot, pivot] > 0).all():
            raise np.linalg.LinAlgError("a line is not connected")
        size = 1 / left[pivot, pivot]
        row, column = left[pivot] * size, left[:, pivot].copy()
        left -= column[:, None] * row
        left[pivot], left[:, pivot] = row, -column * size
        left[pivot, pivot] = size
    inverse = np.empty((*conductance.shape[:-2], rows + columns, rows + columns))
    within = inverse[..., rows:, rows:]
    within[...] = np.moveaxis(left, (0, 1), (-2, -1))
    across = shares @ within
    inverse[..., :rows, rows:], inverse[..., rows:, :rows] = across, across.swapaxes(-1, -2)
    inverse[..., :rows, :rows] = across @ shares.swapaxes(-1, -2)
    np.einsum("...ii->...i", inverse[..., :rows, :rows])[...] += 1 / of_rows
    return inverse
