"""The network of a panel with wire, seen from its terminals.

With C = K⁻¹Bᵀ (`lampest.panel.readouts.ladder`) the terminals' currents are BC·p; Z = (BC + diag t)⁻¹, lines that touch
taken as one, and D = (r C Z)ᵀ are the potential differences across the cells for a unit current into every terminal.
Then ∂Z_ab/∂g_c = −D_ac D_bc as without wire, and with X = diag(r) − r K⁻¹ r + DᵀCᵀ r, the potential differences for a
unit current through every cell, ∂D_ac/∂g_d = −D_ad X_dc. Without wire X = BᵀZB.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Block, GridLinear, Network, SecondOrder
from lampest.panel.panel import Array
from lampest.panel.readouts.ladder import Ladder
from lampest.panel.readouts.tied import TiedNetwork, TiedSecondOrder
from lampest.panel.readouts.wiring import Wiring

if TYPE_CHECKING:
    from lampest.panel.readouts.readout import Readout


@dataclass(frozen=True, eq=False)
class WiredNetwork(TiedNetwork):
    """ties : (lines) siemens. wiring, ladder : what lies between terminals and cells, and its K⁻¹.

    currents : C (cells, lines) siemens, through the cells for a unit of potential at every terminal.
    """

    ties: Array
    wiring: Wiring
    ladder: Ladder
    currents: Array

    @classmethod
    def solve(cls, cell_resistance: Array, ties: Array, readout: "Readout", wiring: Wiring) -> "WiredNetwork":
        """Of cells (rows, columns) ohm. Raises numpy.linalg.LinAlgError where a line is not connected."""
        rows, columns = cell_resistance.shape
        ladder = wiring.factor(cell_resistance)
        currents = ladder.solve(incidence(rows, columns)).reshape(-1, rows + columns)
        through = currents.reshape(rows, columns, -1)
        admittance = np.concatenate([through.sum(axis=1), -through.sum(axis=0)])
        nodes = wiring.nodes(rows + columns)
        impedance = nodes @ np.linalg.inv(nodes.T @ (admittance + np.diag(ties)) @ nodes) @ nodes.T
        return cls(cell_resistance, 1 / cell_resistance, impedance, readout, ties, wiring, ladder, currents)

    @cached_property
    def potential_differences(self) -> Array:
        """D = (r C Z)ᵀ (lines, cells) ohm."""
        return np.asarray((self.cell_resistance.reshape(-1, 1) * (self.currents @ self._impedance)).T)

    def changes(self, step: Array) -> Array:
        """dZ = D·diag(g·p)·Dᵀ (lines, lines) ohm."""
        across = self.potential_differences
        return np.asarray((across * (self.conductance * step).ravel()) @ across.T)

    def forward(self, step: Array) -> Array:
        """What dZ does to the readings."""
        return self.read_change(self.changes(step))

    def adjoint(self, weights: Array) -> Array:
        """g·diag(Dᵀ W D)."""
        return self.conductance * self.drawn(self.loading(weights))

    def drawn(self, loading: Array) -> Array:
        """diag(Dᵀ W D) (rows, columns) of W (lines, lines)."""
        across = self.potential_differences
        return np.asarray(np.sum(across * (loading @ across), axis=0).reshape(self.conductance.shape))

    def own_response(self) -> Array:
        """J's diagonal, from what every cell shows of its own row and column."""
        rows, columns = self.conductance.shape
        across = self.potential_differences.reshape(-1, rows, columns)
        every_row, every_column = np.indices((rows, columns))
        at_row = across[every_row, every_row, every_column]
        at_column = across[rows + every_column, every_row, every_column]
        entries = (at_row**2, at_column**2, at_row * at_column)
        slopes = (self._equation[name] for name in ("p", "q", "t"))
        return np.asarray(self.conductance * sum(slope * part for slope, part in zip(slopes, entries, strict=True)))

    def driven_through(self, sources: Array) -> Array:
        """X·s (cells, patterns) volt of currents s (cells, patterns) that are driven through cells."""
        shape = self.conductance.shape
        resistance = self.cell_resistance.reshape(-1, 1)
        pushed = resistance * sources
        held = self.ladder.solve(pushed.reshape(*shape, -1)).reshape(pushed.shape)
        return np.asarray(pushed - resistance * held + self.potential_differences.T @ (self.currents.T @ pushed))

    def contact_response(self) -> Array:
        """∂y/∂c of the lines' contacts c, (rows, columns, lines): ∂Z_ab/∂c_l = X_la X_lb with X = 1 − diag(t) Z.

        X_la is the current that enters line l while a unit current enters terminal a.
        """
        entering = np.eye(len(self.ties)) - self.ties[:, None] * self._impedance
        return np.stack([self.read_change(np.outer(line, line)) for line in entering], axis=-1)

    def second_order(self, weights: Array) -> SecondOrder:
        """Through D twice, and through the bends of h."""
        return WiredSecondOrder(self, TiedSecondOrder(self, weights), self.loading(weights))

    def normal_inverse(self, weight: Array, diagonal: Array, free: NDArray[np.bool_]) -> GridLinear:
        """Of the same cells without wire, which is near enough for a preconditioner."""
        return self.readout.network(self.cell_resistance, self.ties).normal_inverse(weight, diagonal, free)

    def changed(self, block: Block, conductance: Array) -> "WiredNetwork":
        """Solved anew: cells inside a wired panel cannot be told from its terminals."""
        cells = self.cell_resistance.copy()
        cells[block] = 1 / conductance
        return WiredNetwork.solve(cells, self.ties, self.readout, self.wiring)


@dataclass(frozen=True, eq=False)
class WiredSecondOrder:
    """H of weights at a network. bends : what the equation's second derivatives add. loading : W (lines, lines)."""

    network: WiredNetwork
    bends: TiedSecondOrder
    loading: Array

    def products(self, step: Array) -> tuple[Array, Array]:
        """(J·p, g·(2 diag(Dᵀ W dD) + diag(Dᵀ W' D))), dDᵀ = X·(g·p·Dᵀ), W' from what p does to the slopes of h."""
        network = self.network
        across, change = network.potential_differences, network.changes(step)
        moved = network.driven_through((across * (network.conductance * step).ravel()).T).T
        twice = 2 * np.sum(moved * (self.loading @ across), axis=0).reshape(step.shape)
        return network.read_change(change), network.conductance * (twice + network.drawn(self.bends.moved(change)))

    def adjoint(self) -> Array:
        """g·diag(Dᵀ W D)."""
        return self.network.conductance * self.network.drawn(self.loading)

    def matrix(self) -> Array:
        """2 g (X ∘ Dᵀ W D) g, and what the bends of h add."""
        network = self.network
        conductance, across = network.conductance.ravel(), network.potential_differences
        between = network.driven_through(np.eye(len(conductance)))
        matrix = 2 * between * (across.T @ self.loading @ across)
        matrix *= conductance[:, None] * conductance
        return self.bends.bent(matrix)


def contact_responses(networks: Sequence[Network]) -> Array:
    """∂y/∂c (networks · cells, lines) of wired networks, one after the other."""
    wired = [network for network in networks if isinstance(network, WiredNetwork)]
    return np.concatenate([network.contact_response().reshape(network.conductance.size, -1) for network in wired])


def incidence(rows: int, columns: int) -> Array:
    """Bᵀ (rows, columns, lines): +1 at a cell's row, −1 at its column."""
    matrix = np.zeros((rows, columns, rows + columns))
    row, column = np.indices((rows, columns))
    matrix[row, column, row], matrix[row, column, rows + column] = 1.0, -1.0
    return matrix
