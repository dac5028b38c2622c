"""What a program consists of: named unknowns with start and bounds, constraints, and a cost."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi
import numpy as np
from numpy.typing import ArrayLike

from lampest.formulation.values import Values
from lampest.panel.compiled import CasadiOwner
from lampest.panel.panel import Array

EMPTY = casadi.SX(0, 1)


@dataclass(frozen=True, eq=False)
class Blocks(CasadiOwner):
    """Named columns of symbols, one below the other.

    Attributes
    ----------
    symbols : mapping of str to casadi.SX, shape (n, 1)
    """

    symbols: Mapping[str, casadi.SX]

    @cached_property
    def column(self) -> casadi.SX:
        """All symbols, (size, 1)."""
        return casadi.vertcat(EMPTY, *self.symbols.values())

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Number of entries of each block."""
        return {name: int(symbol.shape[0]) for name, symbol in self.symbols.items()}

    def stacked(self, values: Mapping[str, ArrayLike]) -> Array:
        """Return the values of all blocks as one column, (size,).

        Each value is a number, or one for each entry, by the name of the block.
        """
        parts = []
        for name, size in self.sizes.items():
            value = np.asarray(values[name], dtype=float).reshape(-1)
            parts.append(np.broadcast_to(value, (size,)))
        return np.concatenate([np.zeros(0), *parts])

    def named(self, column: Array) -> dict[str, Array]:
        """Return the block of each name from one column of values, (size,)."""
        ends = np.cumsum([*self.sizes.values()], dtype=int)[:-1]
        return dict(zip(self.sizes, np.split(column, ends), strict=True))


# Numbers, or a function of the values of the frames
Rule = float | Array | Callable[[Values], ArrayLike]


@dataclass(frozen=True, eq=False)
class ProgramUnknown(CasadiOwner):
    """Unknown of a program, with its start and its bounds.

    Attributes
    ----------
    symbol : casadi.SX, shape (size, 1)
    start, lower, upper : Rule
    """

    symbol: casadi.SX
    start: Rule
    lower: Rule = -np.inf
    upper: Rule = np.inf


@dataclass(frozen=True, eq=False)
class Constraint(CasadiOwner):
    """Constraint lower ≤ expression ≤ upper; equal limits make an equation.

    Attributes
    ----------
    expression : casadi.SX, shape (rows, 1)
    lower, upper : float or array, shape (rows,)
    """

    expression: casadi.SX
    lower: float | Array = 0.0
    upper: float | Array = 0.0


@dataclass(frozen=True, eq=False)
class Statement(CasadiOwner):
    """A program as it is solved: its cost, over its unknowns, subject to its constraints.

    Attributes
    ----------
    unknowns : mapping of str to ProgramUnknown
    constraints : mapping of str to Constraint
    cost : casadi.SX, shape (1, 1)
        φ/cost_scale.
    """

    unknowns: Mapping[str, ProgramUnknown]
    constraints: Mapping[str, Constraint]
    cost: casadi.SX
