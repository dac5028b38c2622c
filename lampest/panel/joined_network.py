"""Several networks, each of which gives some of a panel's readings.

Where several lines are loaded at once, each address of the readout has a network of its own, with
its own impedance Z, over all cells. Each module of a panel of modules has a network over its own
cells.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.panel.network import Network, SecondOrder, SolvedNetwork
from lampest.panel.panel import Array, Mask, Modules, Numbers


@dataclass(frozen=True, eq=False)
class NetworkPart:
    """Network of some cells of a panel, and the readings that it gives.

    Attributes
    ----------
    network : Network
        May have a leading axis, for many networks at once: those of modules, each with its own
        cells, or those of addresses, all with the same ones.
    cells : integer array, shape (…, rows, columns)
        Numbers of its cells on the panel, row by row; readings have the number of their cell.
    read : boolean array, shape (…, rows, columns)
        Readings that the network gives.
    """

    network: Network
    cells: Numbers
    read: Mask

    @property
    def addresses(self) -> "list[NetworkPart]":
        """Parts of one address each, whose large matrices are made one after the other."""
        if self.read.ndim == 2:
            return [self]
        assert isinstance(self.network, SolvedNetwork)
        networks = map(self.network.some, range(len(self.read)))
        return list(map(NetworkPart, networks, self.cells, self.read))

    @cached_property
    def given(self) -> Numbers:
        """Numbers of the readings that the network gives."""
        return self.cells[self.read]

    def weights(self, weights: Array) -> Array:
        """Return weights of the readings, zero where another network gives them."""
        return np.where(self.read, weights.reshape(-1)[self.cells], 0.0)


@dataclass(frozen=True, eq=False)
class JoinedNetwork(Network):
    """Several networks, each of which gives some of the readings.

    Every reading, and each of its derivatives, is that of the network that gives it.

    Attributes
    ----------
    parts : tuple of NetworkPart
    """

    parts: tuple[NetworkPart, ...]

    @classmethod
    def of(
        cls,
        cell_resistance: Array,
        networks: Sequence[Network],
        places: Modules | Mask,
    ) -> "JoinedNetwork":
        """Return the network of cells (rows, columns) ohm of all modules, or of all addresses.

        Parameters
        ----------
        cell_resistance : array, shape (rows, columns)
        networks : sequence of Network
            Those of the modules by their numbers, or of the addresses, or a single one with all of
            them as its leading axis.
        places : Modules, or boolean array, shape (addresses, rows, columns)
            Arrangement of the modules, or the readings of each address, all over the same cells.
        """
        cells = np.arange(cell_resistance.size).reshape(cell_resistance.shape)
        if isinstance(places, Modules):
            cells = places.split(cells)
            read = np.ones(cells.shape, dtype=bool)
        else:
            cells, read = np.broadcast_to(cells, places.shape), places
        if networks[0].cell_resistance.ndim > 2:
            return cls(cell_resistance, (NetworkPart(networks[0], cells, read),))
        return cls(cell_resistance, tuple(map(NetworkPart, networks, cells, read)))

    def reading(self) -> Array:
        return self._readings([part.network.reading() for part in self.parts])

    def forward(self, step: Array) -> Array:
        flat = step.reshape(-1)
        return self._readings([part.network.forward(flat[part.cells]) for part in self.parts])

    def adjoint(self, weights: Array) -> Array:
        return self._summed([part.network.adjoint(part.weights(weights)) for part in self.parts])

    def sensitivity(self, read: Mask | None = None) -> Array:
        sensitivity = np.zeros((self.cell_resistance.size, self.cell_resistance.size))
        for part in self._addresses:
            places = np.ix_(part.given, part.cells.ravel())
            sensitivity[places] = part.network.sensitivity(part.read)
        return sensitivity if read is None else sensitivity[read.ravel()]

    def own_response(self) -> Array:
        return self._readings([part.network.own_response() for part in self.parts])

    def second_order(self, weights: Array) -> SecondOrder:
        return JoinedSecondOrder(self, weights)

    def leaking(self, across: Array, siemens: float) -> Network:
        """Return the network with conductances between lines that all parts have."""
        parts = tuple(
            NetworkPart(part.network.leaking(across, siemens), part.cells, part.read)
            for part in self.parts
        )
        return JoinedNetwork(self.cell_resistance, parts)

    def response_of(self, response: Callable[[SolvedNetwork], Array]) -> Array:
        parts = self._addresses
        return self._readings([part.network.response_of(response) for part in parts], parts)

    @property
    def _addresses(self) -> list[NetworkPart]:
        """Parts of one address each; see `NetworkPart.addresses`."""
        return [address for part in self.parts for address in part.addresses]

    def _readings(
        self, of_parts: Sequence[Array], parts: Sequence[NetworkPart] | None = None
    ) -> Array:
        """Return the readings (rows, columns, …) of the networks that give them."""
        parts = self.parts if parts is None else parts
        behind = of_parts[0].shape[parts[0].cells.ndim :]
        readings = np.empty((self.cell_resistance.size, *behind))
        for part, of_part in zip(parts, of_parts, strict=True):
            readings[part.given] = of_part[part.read]
        return readings.reshape(*self.cell_resistance.shape, *behind)

    def _summed(self, of_parts: Iterable[Array]) -> Array:
        """Return the sums over the networks of values of their cells, (rows, columns)."""
        size = self.cell_resistance.size
        total = np.zeros(size)
        for part, of_part in zip(self.parts, of_parts, strict=True):
            # Networks of several addresses have the same cells, whose values add up
            total += np.bincount(part.cells.ravel(), of_part.ravel(), size)
        return total.reshape(self.cell_resistance.shape)


@dataclass(frozen=True, eq=False)
class JoinedSecondOrder(SecondOrder):
    """Second derivatives H of several networks; see `SecondOrder`."""

    network: JoinedNetwork

    @cached_property
    def _orders(self) -> list[SecondOrder]:
        return [
            part.network.second_order(part.weights(self.weights)) for part in self.network.parts
        ]

    def adjoint(self) -> Array:
        return self.network._summed(order.adjoint() for order in self._orders)

    def products(self, step: Array) -> tuple[Array, Array]:
        flat = step.reshape(-1)
        products = (
            order.products(flat[part.cells])
            for order, part in zip(self._orders, self.network.parts, strict=True)
        )
        changes, seconds = zip(*products, strict=True)
        return self.network._readings(changes), self.network._summed(seconds)

    def matrix(self) -> Array:
        size = self.weights.size
        matrix = np.zeros((size, size))
        for part in self.network._addresses:
            order = part.network.second_order(part.weights(self.weights))
            cells = part.cells.ravel()
            matrix[np.ix_(cells, cells)] += order.matrix()
        return matrix
