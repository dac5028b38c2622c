"""What a program consists of: named unknowns, constraints and a cost, and values of its symbols.

The values belong to given data, and are in the program's units.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi
import numpy as np
from numpy.typing import ArrayLike

from lampest.cost.problem import Data, Evaluation
from lampest.formulation.circuit import Circuit
from lampest.formulation.patterns import END_VOLTAGE, NetworkSymbols
from lampest.panel.compiled import CasadiOwner
from lampest.panel.panel import Array
from lampest.panel.readouts.starts import nearly_shorted

Addresses = Sequence[tuple[Circuit, NetworkSymbols]]
MIN_VOLTAGE = 1e-3  # smallest unit of a voltage, relative to the largest voltage of its kind
MIN_SPLIT_UNIT = 1e-12  # unit of split residuals that are all zero, in their own unit
# Distance of p, q from their bound 0 at the start, in split units: IPOPT's default of bound_push.
SPLIT_START = 0.01
EMPTY = casadi.SX(0, 1)


def unit_of(name: str) -> str:
    """Return the name of the parameter that is the unit of voltages."""
    return f"unit_{name}"


@dataclass(frozen=True, eq=False)
class Values:
    """Values of a program's frames, those of all blocks one after the other.

    Attributes
    ----------
    addresses : sequence of pairs of Circuit and NetworkSymbols
        Circuit of each address of the readout, and its network in one frame.
    data : sequence of Data
        Data of every block.
    scale : float
        s, the geometric mean of equal cells with these readings, ohm.
    cost_scale : float
        Mean cost of a cell at readings of zero, which does not depend on the start.
    weights : array, shape (terms,)
    cells : array, shape (frames, rows, columns)
        Cells of the start, ohm.
    voltages : mapping of str to array
        Voltages of these cells, by the names of `NetworkSymbols.voltages`: volt for END_VOLTAGE,
        units of s for all others.
    units : mapping of str to array
        Unit of each voltage in the program.
    split : array or float
        p and q at the start, in units of `split_scale`.
    split_scale : float
        Unit of split residuals.
    """

    addresses: Addresses
    data: Sequence[Data]
    scale: float
    cost_scale: float
    weights: Array
    cells: Array
    voltages: Mapping[str, Array]
    units: Mapping[str, Array]
    split: Array | float = 0.0
    split_scale: float = MIN_SPLIT_UNIT

    @classmethod
    def of(cls, addresses: Addresses, blocks: Sequence[Evaluation]) -> "Values":
        """Return the values at the cells of the evaluations, without those of split residuals."""
        uniform = np.concatenate([block.data.uniform_start for block in blocks])
        costs = [float(block.cell_costs) or block.cost_scale for block in blocks]
        values = cls(
            addresses,
            [block.data for block in blocks],
            scale=float(np.exp(np.mean(np.log(uniform)))),
            cost_scale=float(np.mean(costs)),
            weights=blocks[0].weights,
            cells=np.zeros(0),
            voltages={},
            units={},
        ).with_cells(np.concatenate([block.cell_resistance for block in blocks]))
        units = {}
        for name, voltages in values.voltages.items():
            size = np.abs(voltages)
            units[name] = np.maximum(size, MIN_VOLTAGE * size.max(initial=0.0))
        return replace(values, units=units)

    def with_cells(self, cells: Array) -> "Values":
        """Return the values with other cells, (frames, rows, columns) ohm, and their voltages."""
        solved = [
            network.values(circuit.voltages(frame, tie))
            for frame, ties in zip(cells, self.tie, strict=True)
            for (circuit, network), tie in zip(self.addresses, ties, strict=True)
        ]
        voltages = {
            name: np.concatenate([part[name] for part in solved])
            / (1.0 if name == END_VOLTAGE else self.scale)
            for name in solved[0]
        }
        return replace(self, cells=cells, voltages=voltages)

    def with_split(self, residuals: Sequence[Array], apparent: Sequence[Array]) -> "Values":
        """Return the values with parts p, q of the split residuals ±(p − q) of the start.

        The unit of p and q is the largest residual of the start and of the apparent resistances,
        because a start at the baseline may leave none.
        """
        unit = np.abs(np.concatenate([*residuals, *apparent])).max(initial=MIN_SPLIT_UNIT)
        sides = [np.maximum(side / unit, 0) for group in residuals for side in (group, -group)]
        return replace(self, split=np.concatenate(sides) + SPLIT_START, split_scale=float(unit))

    @property
    def tie(self) -> Array:
        """Ties of the lines, (frames, addresses, lines) siemens.

        0 for lines at ground, which the circuit knows.
        """
        ties = np.concatenate([data.ties for data in self.data])
        ties = ties.reshape(len(ties), len(self.addresses), -1)
        return np.where(np.isinf(ties), 0.0, ties)

    @property
    def upper(self) -> Array:
        """Upper bounds of the cells, (frames, rows, columns) ohm."""
        return np.concatenate([data.upper for data in self.data])

    @property
    def lower(self) -> Array:
        """Lower bounds of the cells, (frames, rows, columns) ohm.

        Smaller cells than `nearly_shorted` do not change any reading.
        """
        limits = [
            np.clip(data.lower, nearly_shorted(data.readout, data.measured), data.upper)
            for data in self.data
        ]
        return np.concatenate(limits)

    @property
    def parameters(self) -> dict[str, Array | float]:
        """Values of `Program.parameter` by name.

        Inputs of the terms that have no frame are the same in all blocks.
        """
        first = self.data[0]
        given = dict(first.flat)
        for name, source in first.given.sources().items():
            if source.per_frame:
                given[name] = np.concatenate([data.flat[name] for data in self.data])
        return {
            **given,
            **{unit_of(name): unit for name, unit in self.units.items()},
            "tie": self.tie * self.scale,
            "weights": self.weights,
            "scale": self.scale,
            "cost_scale": self.cost_scale,
            "split_scale": self.split_scale,
        }


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
