"""The network of a panel of which all lines but two float: R = Z_jj + Z_kk − 2 Z_jk, whichever line is the ground.

Here W of `lampest.panel.readouts.tied` is the Laplacian of the weights and the reading is linear in Z, so that
∂R_i/∂u_c = g_c D_ic² with D = BᵀZB, the transfer resistances: one operator is both forward and adjoint.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Afar, Block, Network, Numbers, SecondOrder, inverse_of
from lampest.panel.panel import Array
from lampest.panel.readouts.two_point.stencil import StencilSquare, square_from_afar


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


def uniform_factor(rows: int, columns: int) -> float:
    """R/r = (M + N − 1)/(MN) on a panel of equal cells."""
    return (rows + columns - 1) / (rows * columns)


@dataclass(frozen=True, eq=False)
class FloatingNetwork(Network):
    """The readings are two-point resistances in ohm."""

    @classmethod
    def solve(cls, conductance: Array, tie: Array) -> "FloatingNetwork":
        """Of cells (rows, columns) siemens. Raises numpy.linalg.LinAlgError where a line is not connected."""
        with np.errstate(divide="ignore"):
            return cls(1 / conductance, conductance, inverse_of(conductance, tie))

    def reading(self) -> Array:
        """R_jk = Z_jj + Z_kk − 2 Z_jk."""
        return self._across(self._impedance)

    def conductance_product(self, weights: Array) -> Array:
        """(∂R/∂g)·w = −bᵀ Z L_w Z b, which is also (∂R/∂g)ᵀ·w; w (rows, columns), result likewise.

        Costs (rows + columns)³ and never forms the matrix of cells × cells.
        """
        return -self._differences(self._impedance, self._injected(weights, self._impedance), symmetric=True)

    def forward(self, step: Array) -> Array:
        """−(∂R/∂g)·(g·p)."""
        return -self.conductance_product(step / self.cell_resistance)

    def adjoint(self, weights: Array) -> Array:
        """−g·(∂R/∂g)ᵀ·w."""
        return -self.conductance_product(weights) / self.cell_resistance

    @cached_property
    def transfer(self) -> Array:
        """D = BᵀZB (cells, cells) ohm."""
        return self._between_cells(self._impedance)

    def sensitivity(self, cells: Numbers | None = None, readings: Numbers | None = None) -> Array:
        """D∘D·diag(g)."""
        conductance = self.conductance.ravel()
        if cells is None:
            transfer = self.transfer if readings is None else self.transfer[readings]
            response: Array = transfer * transfer
            response *= conductance
            return response
        columns = self.conductance.shape[1]
        lines = self._impedance[:, cells // columns] - self._impedance[:, self.rows + cells % columns]
        if readings is None:
            across = (lines[: self.rows, None] - lines[None, self.rows :]).reshape(conductance.size, len(cells))
        else:
            across = lines[readings // columns] - lines[self.rows + readings % columns]
        chosen: Array = across**2 * conductance[cells]
        return chosen

    def own_response(self) -> Array:
        """R²·g: D_ii = R_i."""
        return self.reading() ** 2 / self.cell_resistance

    def second_order(self, weights: Array) -> SecondOrder:
        """With Z L_w Z."""
        return FloatingSecondOrder(self, self._impedance @ self._injected(weights, self._impedance))

    def normal_inverse(self, weight: Array, diagonal: Array, free: NDArray[np.bool_]) -> StencilSquare:
        """From what a network looks like from afar."""
        return StencilSquare.of(self.conductance, self.reading(), weight, diagonal, free)

    def normal_from_afar(self, weight: Array) -> Afar:
        """Diagonal, rows and columns; see `square_from_afar`."""
        return square_from_afar(self.conductance, self.reading(), weight)

    def log_determinant(self) -> float:
        """log det Z."""
        return float(np.linalg.slogdet(self._impedance)[1])

    def within(self, block: Block) -> "FloatingNetwork":
        """What a block's lines show of the network between themselves; the cells of the block alone can be changed."""
        lines = self.lines_of(block)
        impedance = self._impedance[np.ix_(lines, lines)]
        return FloatingNetwork(self.cell_resistance[block], self.conductance[block], impedance)


@dataclass(frozen=True, eq=False)
class FloatingSecondOrder:
    """H at a network, with K = Z L_w Z (lines, lines)."""

    network: FloatingNetwork
    twice: Array

    def products(self, step: Array) -> tuple[Array, Array]:
        """(J·p, 2 g·bᵀ K L_{g·p} Z b)."""
        network = self.network
        injected = network._injected(step / network.cell_resistance, network._impedance)
        change = network._differences(network._impedance, injected, symmetric=True)
        return change, 2 * network._differences(self.twice, injected, symmetric=False) / network.cell_resistance

    def adjoint(self) -> Array:
        """g·bᵀ K b."""
        return self.network._across(self.twice) / self.network.cell_resistance

    def matrix(self) -> Array:
        """2 g (D ∘ BᵀKB) g."""
        conductance = self.network.conductance.ravel()
        matrix: Array = self.network.transfer * (2 * conductance[:, None])
        matrix *= self.network._between_cells(self.twice)
        matrix *= conductance
        return matrix
