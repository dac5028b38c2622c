"""Leaks from line to line, such as water."""

from collections.abc import Iterator
from typing import Self

import numpy as np

from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.network import Network


def neighbours(rows: int, columns: int) -> tuple[int, ...]:
    """Return the numbers of all lines that have a next one on their side, rows first."""
    return tuple(line for line in range(rows + columns - 1) if line != rows - 1)


class LineLeak(LineEffect):
    """Leak from each of the lines to the next one, such as water, in siemens."""

    key = "leaks"
    prior = 1 / 10e3
    unit = "siemens"
    positive = True

    @classmethod
    def places(cls, rows: int, columns: int) -> Iterator[tuple[int, ...]]:
        pairs = neighbours(rows, columns)
        yield from (pairs, *((line,) for line in pairs))

    @classmethod
    def simulated(cls, size: float, rows: int, columns: int) -> Self:
        return cls(neighbours(rows, columns), size=1 / size)

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
