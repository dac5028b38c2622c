"""Modules with two-point readouts as one panel: no current crosses a seam, and the network falls into blocks.

For costs that couple cells over seams; all arrays of networks have an axis that counts modules.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Network, Numbers, SecondOrder
from lampest.panel.panel import Array, EachModule, Modules
from lampest.panel.readouts.floating import FloatingNetwork, convex_start, grounding, uniform_factor
from lampest.panel.readouts.two_point import TwoPointReadout
from lampest.panel.readouts.wiring import Wiring


@dataclass(frozen=True, kw_only=True)
class ModulesReadout(TwoPointReadout):
    """R_jk of each module by itself, as readings of the whole image.

    >>> lampest.panel.readouts.blocks.ModulesReadout().unit
    'ohm'
    """

    layout: Modules = Modules(1, 1, EachModule(1, 1))

    def ties(self, measured: Array) -> Array:
        """One line of every module, (modules, lines)."""
        return grounding(self.layout.split(measured))

    def ties_of_parts(self, measured: Array, parts: NDArray[np.intp] | None) -> Array:
        """The same."""
        return self.ties(measured)

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Of all modules."""
        inner = FloatingNetwork.solve(1 / self.layout.split(cell_resistance), ties)
        return BlockNetwork(cell_resistance, 1 / cell_resistance, inner._impedance, self.layout, inner)

    def uniform_start(self, measured: Array) -> Array:
        """Of each module; see `TwoPointReadout.uniform_start`."""
        return np.asarray(measured / uniform_factor(self.layout.each.rows, self.layout.each.columns))

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells that reproduce attainable readings, module by module; see `convex_start`."""
        nothing = [None] * self.layout.count
        nears = nothing if near is None else self.layout.split(near)
        three = zip(self.layout.split(measured), self.layout.split(upper), nears, strict=True)
        return np.asarray(self.layout.joined(np.stack([convex_start(*one) for one in three])))

    def exact_start(self, measured: Array, upper: Array) -> Array:
        """The same."""
        return self.start(measured, upper)


@dataclass(frozen=True, eq=False)
class BlockNetwork(Network):
    """inner : the networks of all modules."""

    layout: Modules
    inner: FloatingNetwork

    def reading(self) -> Array:
        """Of the image, (rows, columns)."""
        return np.asarray(self.layout.joined(self.inner.reading()))

    def forward(self, step: Array) -> Array:
        """J·p, module by module."""
        return np.asarray(self.layout.joined(self.inner.forward(self.layout.split(step))))

    def adjoint(self, weights: Array) -> Array:
        """Jᵀ·w, module by module."""
        return np.asarray(self.layout.joined(self.inner.adjoint(self.layout.split(weights))))

    def own_response(self) -> Array:
        """The diagonal of J."""
        return np.asarray(self.layout.joined(self.inner.own_response()))

    def sensitivity(self, cells: Numbers | None = None, readings: Numbers | None = None) -> Array:
        """J, zero between modules."""
        whole = self.scattered(self.inner.sensitivity())
        whole = whole if readings is None else whole[readings]
        return whole if cells is None else whole[:, cells]

    def second_order(self, weights: Array) -> SecondOrder:
        """Of all modules."""
        return BlockSecondOrder(self, self.inner.second_order(self.layout.split(weights)))

    def condition(self) -> float:
        """The largest of all modules; see `Network.condition`."""
        diagonal = np.diagonal(self.inner._impedance, axis1=-2, axis2=-1)
        lines = np.concatenate([self.inner.conductance.sum(axis=-1), self.inner.conductance.sum(axis=-2)], axis=-1)
        return float(np.abs(lines * diagonal).sum(axis=-1).max())

    @cached_property
    def numbers(self) -> NDArray[np.intp]:
        """(modules, cells) the number in the image of every module's cells."""
        image = np.arange(self.conductance.size).reshape(self.conductance.shape)
        return np.asarray(self.layout.split(image).reshape(self.layout.count, -1))

    def scattered(self, blocks: Array) -> Array:
        """(modules, cells, cells) as a matrix over the image's cells."""
        whole = np.zeros((self.conductance.size,) * 2)
        whole[self.numbers[:, :, None], self.numbers[:, None, :]] = blocks
        return whole


@dataclass(frozen=True, eq=False)
class BlockSecondOrder:
    """H of all modules; inner : of the networks."""

    network: BlockNetwork
    inner: Any

    def products(self, step: Array) -> tuple[Array, Array]:
        """(J·p, H·p)."""
        layout = self.network.layout
        change, second = self.inner.products(layout.split(step))
        return np.asarray(layout.joined(change)), np.asarray(layout.joined(second))

    def adjoint(self) -> Array:
        """Jᵀ·w."""
        return np.asarray(self.network.layout.joined(self.inner.adjoint()))

    def matrix(self, cells: Numbers | None = None) -> Array:
        """H, zero between modules; between some cells if these are given by their numbers."""
        whole = self.network.scattered(self.inner.matrix())
        return whole if cells is None else whole[np.ix_(cells, cells)]
