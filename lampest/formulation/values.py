"""Values of a program's symbols for given data, by name and in the program's units."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.formulation.circuit import Circuit
from lampest.formulation.patterns import END_VOLTAGE, NetworkSymbols
from lampest.panel.panel import Array
from lampest.panel.readouts.starts import nearly_shorted

Addresses = Sequence[tuple[Circuit, NetworkSymbols]]
MIN_VOLTAGE = 1e-3  # smallest unit of a voltage, relative to the largest voltage of its kind
MIN_SPLIT_UNIT = 1e-12  # unit of split residuals that are all zero, in their own unit
# Distance of p, q from their bound 0 at the start, in split units: IPOPT's default of bound_push.
SPLIT_START = 0.01


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
        given: dict[str, Array | float] = dict(first.flat)
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
