"""Modules with two-point readouts as one panel: no current crosses a seam, so that the network consists of blocks.

It serves costs that couple cells across seams. All arrays of the inner networks have a leading axis of modules.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Network, NormalByLines, Numbers, SecondOrder
from lampest.panel.panel import Array, EachModule, Modules
from lampest.panel.readouts.floating import FloatingNetwork, convex_start, grounding, uniform_factor
from lampest.panel.readouts.two_point import TwoPointReadout
from lampest.panel.readouts.wiring import Wiring


@dataclass(frozen=True, kw_only=True)
class ModulesReadout(TwoPointReadout):
    """Two-point readings R_jk of each module alone, as readings of the whole image.

    Attributes
    ----------
    layout : Modules
        Arrangement of the modules.
    """

    layout: Modules = Modules(1, 1, EachModule(1, 1))

    def ties(self, measured: Array) -> Array:
        return grounding(self.layout.split(measured))

    def ties_of_parts(self, measured: Array, parts: NDArray[np.intp] | None) -> Array:
        return self.ties(measured)

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        inner = FloatingNetwork.solve(1 / self.layout.split(cell_resistance), ties)
        return BlockNetwork(cell_resistance, 1 / cell_resistance, inner.potentials(), self.layout, inner)

    def uniform_start(self, measured: Array) -> Array:
        """Return the uniform start of each module; see `TwoPointReadout.uniform_start`."""
        return np.asarray(measured / uniform_factor(self.layout.each.rows, self.layout.each.columns))

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Return cells that reproduce attainable readings, module by module; see `convex_start`."""
        nears = [None] * self.layout.count if near is None else self.layout.split(near)
        modules = zip(self.layout.split(measured), self.layout.split(upper), nears, strict=True)
        return np.asarray(self.layout.joined(np.stack([convex_start(*module) for module in modules])))


@dataclass(frozen=True, eq=False)
class BlockNetwork(FloatingNetwork):
    """Network of an image of modules.

    Attributes
    ----------
    layout : Modules
        Arrangement of the modules.
    inner : FloatingNetwork
        Networks of all modules, with a leading axis.
    """

    layout: Modules
    inner: FloatingNetwork

    def reading(self) -> Array:
        return np.asarray(self.layout.joined(self.inner.reading()))

    def forward(self, step: Array) -> Array:
        """Return J·p, module by module."""
        return np.asarray(self.layout.joined(self.inner.forward(self.layout.split(step))))

    def adjoint(self, weights: Array) -> Array:
        """Return Jᵀ·w, module by module."""
        return np.asarray(self.layout.joined(self.inner.adjoint(self.layout.split(weights))))

    def sensitivity(self, cells: Numbers | None = None, readings: Numbers | None = None) -> Array:
        whole = self.scattered(self.inner.sensitivity())
        whole = whole if readings is None else whole[readings]
        return whole if cells is None else whole[:, cells]

    def second_order(self, weights: Array) -> SecondOrder:
        return BlockSecondOrder(self, weights)

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        return Network.normal_by_lines(self, weight)

    def condition(self) -> float:
        """Return the largest condition of all modules; see `Network.condition`."""
        return self.inner.condition()

    def scattered(self, blocks: Array) -> Array:
        """Return blocks (modules, cells, cells) as a matrix (cells, cells) over the cells of the image."""
        size, layout = self.conductance.size, self.layout
        numbers = layout.split(np.arange(size).reshape(layout.shape)).reshape(layout.count, -1)
        whole = np.zeros((size, size))
        whole[numbers[:, :, None], numbers[:, None, :]] = blocks
        return whole


@dataclass(frozen=True, eq=False)
class BlockSecondOrder(SecondOrder):
    """Second derivatives H of all modules; see `SecondOrder`."""

    network: BlockNetwork

    @cached_property
    def _inner(self) -> SecondOrder:
        """Second derivatives of the inner networks."""
        return self.network.inner.second_order(self.network.layout.split(self.weights))

    def products(self, step: Array) -> tuple[Array, Array]:
        """Return (J·p, H·p), module by module."""
        layout = self.network.layout
        change, second = self._inner.products(layout.split(step))
        return np.asarray(layout.joined(change)), np.asarray(layout.joined(second))

    def adjoint(self) -> Array:
        """Return Jᵀ·w for the weights, module by module."""
        return np.asarray(self.network.layout.joined(self._inner.adjoint()))

    def matrix(self, cells: Numbers | None = None) -> Array:
        whole = self.network.scattered(self._inner.matrix())
        return whole if cells is None else whole[np.ix_(cells, cells)]
