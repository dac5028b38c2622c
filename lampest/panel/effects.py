"""Effects outside the scene, and their influence on readings.

The effects are leaks between lines and contact resistances.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene


def neighbours(rows: int, columns: int) -> tuple[int, ...]:
    """Return the numbers of all lines that have a next one on their side, rows first."""
    return tuple(line for line in range(rows + columns - 1) if line != rows - 1)


@dataclass(frozen=True)
class Effect(ABC):
    """Additional parameter of the readings that the scene does not specify.

    Attributes
    ----------
    lines : tuple of int
        Numbers of the lines that it acts on, rows first.
    since : bool
        Whether it began after the unloaded frames.
    size : float
        Size in the unit of `prior`.
    key : str
        The key of a scene that states it; '' where none does.
    prior : float
        Standard deviation of the size.
    positive : bool
        Whether the size is never negative.
    """

    lines: tuple[int, ...]
    since: bool = False
    size: float = 0.0
    key: ClassVar[str] = ""
    prior: ClassVar[float]
    positive: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def places(cls, rows: int, columns: int) -> Iterator[tuple[int, ...]]:
        """Yield the lines of all effects of this kind that are tried on a panel."""

    @abstractmethod
    def sentence(self, rows: int) -> str:
        """Return the effect in words, with its size; `rows` is the number of rows of the panel."""

    def changed(self, network: Network) -> Network:
        """Return the network with the effect."""
        return network

    def added(self, scene: Scene, network: Network) -> Array:
        """Return the effect's contribution to the readings, (rows, columns).

        The influence of the changed network is not included.
        """
        return np.zeros(network.conductance.shape)

    def where(self, rows: int) -> str:
        """Return the first of its lines in words; `rows` is the number of rows of the panel."""
        line = self.lines[0]
        return f"row {line}" if line < rows else f"column {line - rows}"

    @property
    def _since(self) -> str:
        return ", since the unloaded frames" if self.since else ""


class LineLeak(Effect):
    """Leak from each of the lines to the next one, such as water, in siemens."""

    key = "leaks"
    prior = 1 / 10e3
    positive = True

    @classmethod
    def places(cls, rows: int, columns: int) -> Iterator[tuple[int, ...]]:
        pairs = neighbours(rows, columns)
        yield from (pairs, *((line,) for line in pairs))

    def sentence(self, rows: int) -> str:
        where = (
            f"{self.where(rows)} and the next one" if len(self.lines) == 1 else "neighbouring lines"
        )
        return f"a leak of {1e-3 / self.size:.2g} kohm between {where}{self._since}"

    def changed(self, network: Network) -> Network:
        """Return the network with the leak; see `Network.leaking`."""
        unit = np.eye(sum(network.conductance.shape))
        lines = list(self.lines)
        return network.leaking(unit[:, lines] - unit[:, [line + 1 for line in lines]], self.size)


class LooseContact(Effect):
    """Additional resistance at the contact of a line, such as that of a loose one, in ohm."""

    key = "contacts"
    prior = 100.0

    @classmethod
    def places(cls, rows: int, columns: int) -> Iterator[tuple[int, ...]]:
        yield from ((line,) for line in range(rows + columns))

    def sentence(self, rows: int) -> str:
        more = "more" if self.size > 0 else "less"
        return (
            f"{float(f'{abs(self.size):.2g}'):g} ohm {more} "
            f"at the contact of {self.where(rows)}{self._since}"
        )

    def added(self, scene: Scene, network: Network) -> Array:
        rows, columns = network.conductance.shape
        more = self.size * np.isin(np.arange(rows + columns), self.lines)
        return scene.circuit.beyond(network, scene, more[:rows], more[rows:])


# All effects that are searched for.
EFFECTS: tuple[type[Effect], ...] = (LineLeak, LooseContact)


def with_effects(
    effects: Sequence[Effect], scene: Scene, network: Network
) -> tuple[Network, Array]:
    """Return the network with all effects.

    Returns
    -------
    network : Network
        The changed network.
    added : array, shape (rows, columns)
        Contribution of the effects to the readings besides the changed network.
    """
    added = sum(
        (effect.added(scene, network) for effect in effects), np.zeros(network.conductance.shape)
    )
    for effect in effects:
        network = effect.changed(network)
    return network, np.asarray(added)


def effect_on_readings(effects: Sequence[Effect], scene: Scene, network: Network) -> Array:
    """Return the change of a network's readings by effects, (rows, columns)."""
    leaking, added = with_effects(effects, scene, network)
    return np.asarray(leaking.reading() - network.reading() + added)
