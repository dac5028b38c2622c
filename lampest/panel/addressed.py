"""Networks of a readout that loads a panel differently at each address.

Where several lines are loaded at once, each address of the readout has a network of its own, with
its own impedance Z. Every reading, and each of its derivatives, is that of the network of its
address.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.panel.network import Entries, Network, SecondOrder
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class AddressedNetwork(Network):
    """Networks of a panel, one for each address of its readout.

    Every network gives the readings of its address.

    Attributes
    ----------
    networks : tuple of Network
        Network of each address.
    read_at : array, shape (addresses, rows, columns)
        1 for the readings of each address, else 0.
    """

    networks: tuple[Network, ...]
    read_at: Array

    @classmethod
    def of(cls, networks: tuple[Network, ...], read_at: Array) -> "AddressedNetwork":
        """Return the network of all addresses."""
        impedance = np.stack([network._impedance for network in networks])
        sources = None
        each = [network.sources for network in networks if network.sources is not None]
        if each:
            sources = np.stack(each)
        return cls(networks[0].cell_resistance, impedance, networks, read_at, sources=sources)

    def _selected(self, values: Sequence[Array]) -> Array:
        """Return the readings (rows, columns, …) of each address from those of all networks."""
        pairs = zip(self.read_at, values, strict=True)
        return np.asarray(
            sum(read.reshape(*read.shape, *(1,) * (part.ndim - 2)) * part for read, part in pairs)
        )

    def read(self, entries: Entries) -> Array:
        """Return h(p, q, t), (rows, columns), of entries (addresses, …).

        Every reading is taken from the entries of its address.
        """
        addresses = zip(self.networks, zip(*entries, strict=True), strict=True)
        return self._selected([network.read(own) for network, own in addresses])

    @property
    def slopes(self) -> Entries:
        """First derivatives of h of each reading at its address.

        Shape (rows, columns) each.
        """
        slopes = zip(*(network.slopes for network in self.networks), strict=True)
        return tuple(self._selected(of_entry) for of_entry in slopes)

    def forward(self, step: Array) -> Array:
        return self._selected([network.forward(step) for network in self.networks])

    def adjoint(self, weights: Array) -> Array:
        pairs = zip(self.networks, self.read_at, strict=True)
        return np.asarray(sum(network.adjoint(read * weights) for network, read in pairs))

    def sensitivity(self) -> Array:
        sensitivity = np.empty((*self.conductance.shape, self.conductance.size))
        for network, read in zip(self.networks, self.read_at.astype(bool), strict=True):
            sensitivity[read] = network.sensitivity_of(read)
        return sensitivity.reshape(self.conductance.size, -1)

    def own_response(self) -> Array:
        return self._selected([network.own_response() for network in self.networks])

    def second_order(self, weights: Array) -> SecondOrder:
        return AddressedSecondOrder(self, weights)

    def leaking(self, across: Array, siemens: float) -> Network:
        return AddressedNetwork.of(
            tuple(network.leaking(across, siemens) for network in self.networks), self.read_at
        )

    def condition(self) -> float:
        """Return the largest condition of all addresses; see `Network.condition`."""
        return max(network.condition() for network in self.networks)

    def response_of(self, response: Callable[[Network], Array]) -> Array:
        return self._selected([response(network) for network in self.networks])


@dataclass(frozen=True, eq=False)
class AddressedSecondOrder(SecondOrder):
    """Second derivatives H of the networks of all addresses; see `SecondOrder`."""

    network: AddressedNetwork

    @cached_property
    def _parts(self) -> list[SecondOrder]:
        pairs = zip(self.network.networks, self.network.read_at, strict=True)
        return [network.second_order(read * self.weights) for network, read in pairs]

    def adjoint(self) -> Array:
        return np.asarray(sum(part.adjoint() for part in self._parts))

    def products(self, step: Array) -> tuple[Array, Array]:
        changes, seconds = zip(*(part.products(step) for part in self._parts), strict=True)
        return self.network._selected(list(changes)), np.asarray(sum(seconds))

    def matrix(self) -> Array:
        return np.asarray(sum(part.matrix() for part in self._parts))
