"""Leaks and contacts that no scene names: what they make of a network's readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene


def neighbours(rows: int, columns: int) -> tuple[int, ...]:
    """Every line that has a next one on its side, rows first."""
    return tuple(line for line in range(rows + columns - 1) if line != rows - 1)


@dataclass(frozen=True)
class Effect:
    """A leak from each of some lines to the next one, as water makes it, or more resistance at their contacts.

    lines : their numbers, rows first. since : whether it came after the unloaded frames. size : siemens, or ohm.
    """

    kind: Literal["leak", "contact"]
    lines: tuple[int, ...]
    since: bool = False
    size: float = 0.0

    def leaking(self, network: Network) -> Network:
        """The network with the leak: Z − Z B (1/G + Bᵀ Z B)⁻¹ Bᵀ Z, B the incidence vectors of the pairs (Woodbury).

        All derivatives follow from Z. A contact leaves the network as it is.
        """
        if self.kind == "contact":
            return network
        each, lines = np.eye(sum(network.conductance.shape)), list(self.lines)
        across = each[:, lines] - each[:, [line + 1 for line in lines]]
        towards = network.potentials() @ across
        core = np.linalg.inv(np.eye(len(lines)) + self.size * across.T @ towards)
        return replace(network, _impedance=network.potentials() - self.size * towards @ core @ towards.T)

    def contact(self, scene: Scene, network: Network) -> Array:
        """What the contact adds to the readings of cells, (rows, columns); 0 of a leak."""
        if self.kind == "leak":
            return np.zeros(network.conductance.shape)
        rows, columns = network.conductance.shape
        more = self.size * np.isin(np.arange(rows + columns), self.lines)
        return scene.circuit.beyond(network, scene, more[:rows], more[rows:])


def disturbed(effects: Sequence[Effect], scene: Scene, network: Network) -> tuple[Network, Array]:
    """(the network with all leaks, what all contacts add to its readings (rows, columns))."""
    added = sum((one.contact(scene, network) for one in effects), np.zeros(network.conductance.shape))
    for one in effects:
        network = one.leaking(network)
    return network, np.asarray(added)


def disturbance(effects: Sequence[Effect], scene: Scene, network: Network) -> Array:
    """What effects do to the readings of a network, (rows, columns)."""
    leaking, added = disturbed(effects, scene, network)
    return np.asarray(leaking.reading() - network.reading() + added)
