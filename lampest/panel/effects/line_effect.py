"""The base class of effects at lines, and their influence on readings."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar, Self

import numpy as np

from lampest.files.applications import loaded
from lampest.files.typed import installed
from lampest.panel.effects import GROUP
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import LINE_EFFECTS


@dataclass(frozen=True)
class LineEffect(ABC):
    """Additional parameter of the readings that the scene does not specify.

    Attributes
    ----------
    lines : tuple of int
        Numbers of the lines that it acts on, rows first; () of an effect of the panel.
    since : bool
        Whether it began after the unloaded frames.
    size : float
        Size in `unit`.
    known : bool
        Whether the scene states the size.
    key : str
        The key of a scene that states it; '' where none does.
    prior : float
        Standard deviation of the size.
    unit : str
        Unit of the size.
    may_begin : bool
        Whether it may begin after the unloaded frames.

    >>> class LineGain(lampest.LineEffect):
    ...     prior = 0.05
    ...
    ...     @classmethod
    ...     def places(cls, rows, columns):
    ...         yield from ((line,) for line in range(rows + columns))
    ...
    ...     def sentence(self, rows):
    ...         return f"{100 * self.size:+.1f} % in all readings of {self.where(rows)}"
    >>> LineGain((2,), size=0.03).sentence(rows=5)
    '+3.0 % in all readings of row 2'
    """

    lines: tuple[int, ...]
    since: bool = False
    size: float = 0.0
    known: bool = False
    key: ClassVar[str] = ""
    prior: ClassVar[float]
    unit: ClassVar[str] = ""
    may_begin: ClassVar[bool] = True

    @property
    def positive(self) -> bool:
        """Whether the size is never negative."""
        return False

    @classmethod
    @abstractmethod
    def places(cls, rows: int, columns: int) -> Iterator[tuple[int, ...]]:
        """Yield the lines of all effects of this kind that are tried on a panel."""

    @classmethod
    def simulated(cls, size: float, rows: int, columns: int) -> Self:
        """Return the effect with a size of `unmodelled`, or of a scene, on a panel."""
        return cls((), size=size)

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

    def added_sensitivity(self, scene: Scene, network: Network) -> Array | float:
        """Return ∂`added`/∂log r, (readings, cells), or 0 where it is small."""
        return 0.0

    def where(self, rows: int) -> str:
        """Return the first of its lines in words; `rows` is the number of rows of the panel."""
        line = self.lines[0]
        return f"row {line}" if line < rows else f"column {line - rows}"

    def named(self, rows: int) -> str:
        """Return its key, with the first of its lines in words if it has any."""
        return f"{self.key} of {self.where(rows)}" if self.lines else self.key

    @property
    def _since(self) -> str:
        return ", since the unloaded frames" if self.since else ""


@cache
def line_effects() -> tuple[type[LineEffect], ...]:
    """Return all effects at lines that are searched for, those of installed packages included."""
    further = (kind for kind in installed(GROUP, type) if issubclass(kind, LineEffect))
    return (*(loaded(effect.path) for effect in LINE_EFFECTS), *further)


def stated_effects(scene: Scene) -> tuple[LineEffect, ...]:
    """Return the effects at lines whose sizes a scene states."""
    return tuple(
        replace(loaded(effect.path).simulated(size, *scene.panel.shape), known=True)
        for effect in LINE_EFFECTS
        if isinstance(size := specified(scene, effect.key), float) and size
    )


def with_effects(
    effects: Sequence[LineEffect], scene: Scene, network: Network
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
    return network, added


def effect_on_readings(effects: Sequence[LineEffect], scene: Scene, network: Network) -> Array:
    """Return the change of a network's readings by effects, (rows, columns)."""
    leaking, added = with_effects(effects, scene, network)
    return leaking.reading() - network.reading() + added
