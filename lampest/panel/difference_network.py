"""Networks whose derivatives follow from potential differences across their cells.

A line that is held at ground without any resistance has a tie of infinite conductance, and Z does
not exist. The potential differences do. `DifferenceNetwork` has the equations.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.panel.kirchhoff import laplacian, line_sums
from lampest.panel.network import Entries, Loading, Network, SecondOrder, loading_of
from lampest.panel.panel import Array
from lampest.panel.tied_network import ReadCircuit, TiedNetwork


@dataclass(frozen=True, eq=False)
class DifferenceNetwork(TiedNetwork):
    """Network whose derivatives follow from the potential differences D across its cells.

    A line with a tie of infinite conductance is held at ground. A held line is excited by a unit
    potential, any other line by a unit current. With C the conductances between lines that are not
    held (ties included), −G those between held and other lines, and A those between held lines, K =
    [[−(A − G C⁻¹ Gᵀ), G C⁻¹], [C⁻¹ Gᵀ, C⁻¹]] and the potentials of all lines for each excitation
    are P = [[1, G C⁻¹], [0, C⁻¹]], held lines first. Without held lines K = P = Z. In every case D
    = P·B and ∂K_ab/∂g_c = −D_ac D_bc. Nothing is lost to a tie that is only nearly infinite.

    Attributes
    ----------
    ties : array, shape (lines,)
        Ties t of the terminals to ground, siemens; infinite where a line is held.
    excited : array, shape (lines, lines)
        P; row a is the excitation of line a.
    """

    ties: Array
    excited: Array

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether a line is held at ground, (lines,)."""
        return np.isinf(self.ties)

    @abstractmethod
    def driven_through(self, sources: Array) -> Array:
        """Return X·s, (cells, patterns) volt, for currents driven through cells.

        The currents s are (cells, patterns) ampere.
        """

    def potentials(self) -> Array:
        """Return the potential of every line, (lines, patterns).

        Pattern k is the excitation of line k.
        """
        return self.excited.T

    def leaking(self, across: Array, siemens: float) -> Network:
        """Return the network with conductances between lines; see `Network.leaking`."""
        towards = self.excited @ across
        # Bᵀ Z B with Z the impedance of the lines that are not held
        core = np.linalg.inv(
            np.eye(across.shape[1])
            + siemens * across.T @ np.where(self.held[:, None], 0.0, towards)
        )
        return replace(self, _impedance=self._impedance - siemens * towards @ core @ towards.T)

    def condition(self) -> float:
        """Return Σ_l |L_ll Z_ll| over the lines that are not held; see `Network.condition`."""
        driving_point = np.where(self.held, 0.0, self._impedance.diagonal())
        return float(np.abs(line_sums(self.conductance) * driving_point).sum())

    def changes(self, step: Array) -> Entries:
        """Return the entries of dK = D·diag(g·p)·Dᵀ."""
        differences = self.potential_differences
        return self.entries((differences * (self.conductance * step).ravel()) @ differences.T)

    def drawn(self, loading: Loading) -> Array:
        """Return diag(Dᵀ W D), (rows, columns)."""
        differences = self.potential_differences
        drawn = np.sum(differences * self.loaded(loading, differences), axis=0)
        return np.asarray(drawn.reshape(self.conductance.shape))

    def _own_differences(self) -> tuple[Array, Array]:
        rows, columns = self.conductance.shape
        row, column = np.indices((rows, columns))
        differences = self.potential_differences.reshape(-1, rows, columns)
        return differences[row, row, column], differences[rows + column, row, column]

    @cached_property
    def source_differences(self) -> Array:
        """Difference across every cell by the sources, (rows, columns)."""
        assert self.sources is not None
        return np.asarray(self.sources @ self.potential_differences).reshape(self.conductance.shape)

    @cached_property
    def transfer(self) -> Array:
        """X (cells, cells), the potential differences for a unit current through every cell.

        See `SecondOrder`.
        """
        return self.driven_through(np.eye(self.conductance.size))

    def second_order(self, weights: Array) -> SecondOrder:
        return DifferenceSecondOrder(self, weights)


@dataclass(frozen=True, eq=False)
class DifferenceSecondOrder(SecondOrder):
    """Second derivatives H of a network of potential differences; see `SecondOrder`."""

    network: DifferenceNetwork

    def adjoint(self) -> Array:
        """Return Jᵀ·w = g·diag(Dᵀ W D), (rows, columns)."""
        return np.asarray(self.network.conductance * self.network.drawn(self.loading))

    def products(self, step: Array) -> tuple[Array, Array]:
        """Return the products with the Jacobian and the Hessian, from dDᵀ = X·(g·p·Dᵀ).

        Returns
        -------
        change : array, shape (rows, columns)
            J·p.
        second : array, shape (rows, columns)
            H·p = g·(2 diag(Dᵀ W dD) + diag(Dᵀ W' D)), W' the change of W by that of the slopes of
            h.
        """
        network = self.network
        change = self.network.changes(step)
        differences = network.potential_differences
        moved = network.driven_through((differences * (network.conductance * step).ravel()).T).T
        loaded = network.loaded(self.loading, differences)
        by_potentials = 2 * np.sum(moved * loaded, axis=0).reshape(step.shape)
        by_slopes = network.drawn(loading_of(*self.change_of_slopes(change)))
        return network.read_change(change), network.conductance * (by_potentials + by_slopes)

    @property
    def _between(self) -> Array:
        """Dᵀ W D, (cells, cells)."""
        differences = self.network.potential_differences
        return np.asarray(differences.T @ self.network.loaded(self.loading, differences))


@dataclass(frozen=True, eq=False)
class HeldNetwork(DifferenceNetwork):
    """Network of which some lines are held at ground; see `DifferenceNetwork`."""

    @classmethod
    def solve(
        cls,
        cell_resistance: Array,
        ties: Array,
        readout: ReadCircuit,
        sources: Array | None = None,
    ) -> "HeldNetwork":
        """Return the solved network of cells (rows, columns) ohm.

        Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        entries, potentials = excitations(laplacian(1 / cell_resistance), ties)
        return cls(cell_resistance, entries, readout, ties, potentials, sources=sources)

    @cached_property
    def potential_differences(self) -> Array:
        """D = P·B, (lines, cells): across every cell for the excitation of every line."""
        differences = self.excited[:, : self.rows, None] - self.excited[:, None, self.rows :]
        return differences.reshape(len(differences), -1)

    def driven_through(self, sources: Array) -> Array:
        """Return BᵀZB·s, Z the impedance of the lines that are not held."""
        currents = sources.reshape(*self.conductance.shape, -1)
        entering = np.concatenate([currents.sum(axis=1), -currents.sum(axis=0)])
        potentials = np.where(self.held[:, None], 0.0, self.excited) @ entering
        return np.asarray(potentials[: self.rows, None] - potentials[None, self.rows :]).reshape(
            sources.shape
        )


def excitations(admittance: Array, ties: Array) -> tuple[Array, Array]:
    """Return K and P of `DifferenceNetwork`.

    Raises numpy.linalg.LinAlgError if a line is not connected.

    Parameters
    ----------
    admittance : array, shape (lines, lines)
        Admittance of the lines without ties, siemens.
    ties : array, shape (lines,)
        Siemens; infinite where a line is held.

    Returns
    -------
    entries, potentials : arrays, shape (lines, lines)
        K and P.
    """
    held = np.isinf(ties)
    free = ~held
    within = np.linalg.inv(admittance[np.ix_(free, free)] + np.diag(ties[free]))
    # Current into held lines from the free ones: −G = admittance between them
    between = -admittance[np.ix_(held, free)] @ within
    of_held = admittance[np.ix_(held, held)] + between @ admittance[np.ix_(free, held)]
    entries = np.zeros_like(admittance)
    entries[np.ix_(free, free)] = within
    entries[np.ix_(held, free)] = between
    entries[np.ix_(free, held)] = between.T
    entries[np.ix_(held, held)] = -of_held
    potentials = np.zeros_like(admittance)
    potentials[np.ix_(free, free)] = within
    potentials[np.ix_(held, free)] = between
    potentials[np.ix_(held, held)] = np.eye(int(held.sum()))
    return entries, potentials
