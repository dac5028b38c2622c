"""The network of a panel with wire, seen from its terminals.

With C = K⁻¹Bᵀ (`lampest.panel.readouts.wiring.Ladder`) the terminals' currents are BC·p; Z = (BC + diag t)⁻¹, lines
that touch taken as one, and D = (r C Z)ᵀ are the potential differences across the cells for a unit current into every
terminal. Then ∂Z_ab/∂g_c = −D_ac D_bc as without wire, and with X = diag(r) − r K⁻¹ r + DᵀCᵀ r, the potential
differences for a unit current through every cell, ∂D_ac/∂g_d = −D_ad X_dc. Without wire X = BᵀZB.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.panel.network import Block, Network, ReadCircuit, SecondOrder
from lampest.panel.panel import Array
from lampest.panel.readouts.tied import TiedNetwork, TiedSecondOrder
from lampest.panel.readouts.wiring import Ladder, Wiring


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
    def solve(cls, cell_resistance: Array, ties: Array, readout: ReadCircuit, wiring: Wiring) -> "WiredNetwork":
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

    def _own_differences(self) -> tuple[Array, Array]:
        """(D_jc, D_kc) of every cell c at its own row j and column k."""
        rows, columns = self.conductance.shape
        row, column = np.indices((rows, columns))
        across = self.potential_differences.reshape(-1, rows, columns)
        return across[row, row, column], across[rows + column, row, column]

    def driven_through(self, sources: Array) -> Array:
        """X·s (cells, patterns) volt of currents s (cells, patterns) that are driven through cells."""
        shape = self.conductance.shape
        resistance = self.cell_resistance.reshape(-1, 1)
        pushed = resistance * sources
        drawn = self.ladder.solve(pushed.reshape(*shape, -1)).reshape(pushed.shape)
        return np.asarray(pushed - resistance * drawn + self.potential_differences.T @ (self.currents.T @ pushed))

    def contact_response(self) -> Array:
        """∂y/∂c of the lines' contacts c, (rows, columns, lines): ∂Z_ab/∂c_l = X_la X_lb with X = 1 − diag(t) Z.

        X_la is the current that enters line l while a unit current enters terminal a.
        """
        entering = np.eye(len(self.ties)) - self.ties[:, None] * self._impedance
        return np.stack([self.read_change(np.outer(line, line)) for line in entering], axis=-1)

    def second_order(self, weights: Array) -> SecondOrder:
        """Through D twice, and through the curvature of h."""
        return WiredSecondOrder(self, weights)

    def changed(self, block: Block, conductance: Array) -> "WiredNetwork":
        """Solved anew: Z alone, which terminals show, does not tell cells inside a wired panel apart."""
        cells = self.cell_resistance.copy()
        cells[block] = 1 / conductance
        return WiredNetwork.solve(cells, self.ties, self.readout, self.wiring)


@dataclass(frozen=True, eq=False)
class WiredSecondOrder(TiedSecondOrder):
    """H of weights at a network with wire."""

    network: WiredNetwork

    @cached_property
    def _loading(self) -> Array:
        """W (lines, lines)."""
        return self.network.loading(self.weights)

    def products(self, step: Array) -> tuple[Array, Array]:
        """(J·p, g·(2 diag(Dᵀ W dD) + diag(Dᵀ W' D))), dDᵀ = X·(g·p·Dᵀ), W' from what p does to the slopes of h."""
        network = self.network
        across, change = network.potential_differences, network.changes(step)
        moved = network.driven_through((across * (network.conductance * step).ravel()).T).T
        twice = 2 * np.sum(moved * (self._loading @ across), axis=0).reshape(step.shape)
        return network.read_change(change), network.conductance * (twice + network.drawn(self.loading_change(change)))

    def adjoint(self) -> Array:
        """g·diag(Dᵀ W D)."""
        return self.network.conductance * self.network.drawn(self._loading)

    def matrix(self) -> Array:
        """2 g (X ∘ Dᵀ W D) g, and what the curvature of h adds."""
        conductance, across = self.network.conductance.ravel(), self.network.potential_differences
        matrix = 2 * self.network.driven_through(np.eye(len(conductance))) * (across.T @ self._loading @ across)
        matrix *= conductance[:, None] * conductance
        return self.with_curvature(matrix)


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
