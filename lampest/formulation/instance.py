"""Numbers of a program for given data: start, parameters, bounds and units, by block names."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.formulation.circuit import Circuit
from lampest.formulation.patterns import END_VOLTAGE, Excitation
from lampest.formulation.program import Program, unit_of
from lampest.panel.panel import Array

# Distance of p, q from their bound 0 at the start, in split units: IPOPT's default of bound_push.
SPLIT_START = 0.01
MIN_VOLTAGE = 1e-3  # smallest unit of a voltage, relative to the largest voltage of its kind
MIN_SPLIT_UNIT = 1e-12  # unit of split residuals that are all zero, in their own unit


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of a solved program, in its units.

    Attributes
    ----------
    of_bounds : array, shape (unknowns,)
    of_equations : array, shape (constraints,)
    scale, cost_scale : float
        Units of resistances in ohm, and of the cost.
    """

    of_bounds: Array
    of_equations: Array
    scale: float
    cost_scale: float

    def in_units(self, program: Program, scale: float, cost_scale: float) -> "Multipliers":
        """Return the multipliers in other units.

        Multipliers are ∂f/∂(right-hand side), f = φ/`cost_scale`. Balances have no unit;
        conductances are in 1/`scale`, voltages in `scale`.
        """
        share = self.cost_scale / cost_scale
        of_bounds = program.unknown.named(self.of_bounds * share)
        of_bounds["conductance"] = of_bounds["conductance"] * self.scale / scale
        stacked = program.unknown.stacked(of_bounds)
        return replace(
            self,
            of_bounds=stacked,
            of_equations=self.of_equations * share,
            scale=scale,
            cost_scale=cost_scale,
        )


@dataclass(frozen=True, eq=False)
class ProgramResult:
    """Result of IPOPT.

    Attributes
    ----------
    unknown : array, shape (unknowns,)
        x, in the program's units.
    of_bounds : array, shape (unknowns,)
        Multipliers of the bounds; positive at an upper one.
    of_equations : array, shape (constraints,)
    status : str
        IPOPT's return status.
    iterations : int
    corrected : bool
        Whether IPOPT corrected the inertia in any iteration: there was negative curvature along the
        equations.
    """

    unknown: Array
    of_bounds: Array
    of_equations: Array
    status: str
    iterations: int
    corrected: bool = False


@dataclass(frozen=True, eq=False)
class Instance:
    """A program with its numbers.

    Attributes
    ----------
    program : Program
    start, lower, upper : array, shape (unknowns,)
    parameter : array, shape (parameters,)
    equations : pair of arrays, shape (constraints,)
        Lower and upper limits of the constraints.
    shape : tuple of int
        Frames, rows and columns.
    scale : float
        s, the geometric mean of equal cells with these readings, ohm.
    cost_scale : float
        Mean cost of a cell at readings of zero, which does not depend on the start.
    split_scale : float
        Unit of split residuals.
    """

    program: Program
    start: Array
    lower: Array
    upper: Array
    parameter: Array
    equations: tuple[Array, Array]
    shape: tuple[int, ...]
    scale: float
    cost_scale: float
    split_scale: float

    @classmethod
    def of(
        cls,
        program: Program,
        circuits: Sequence[Circuit],
        excitation: Excitation,
        blocks: Sequence[Evaluation],
    ) -> "Instance":
        """Return the instance that begins at the cells of the evaluations, one for each block.

        The units, the start, the bounds of the unknowns and the limits of the constraints are all
        stated here, by the names that `Program` gives them.
        """
        values = _FrameValues(circuits, excitation, blocks)
        scale = values.scale
        cost_scale = values.cost_scale
        voltages = values.voltages(values.cells, scale)
        units = {name: _voltage_unit(part) for name, part in voltages.items()}
        parameters: dict[str, Any] = {
            **values.given,
            "tie": values.tie * scale,
            "weights": blocks[0].weights,
            "scale": scale,
            "cost_scale": cost_scale,
            **{unit_of(name): unit for name, unit in units.items()},
        }

        def start_at(cells: Array, voltages: dict[str, Array], split: Array | float) -> Array:
            scaled = {name: part / units[name] for name, part in voltages.items()}
            own = {name: unknown.start for name, unknown in program.own.items()}
            return program.unknown.stacked(
                {"conductance": scale / cells, **scaled, "split": split, **own}
            )

        # Unit of split residuals: the largest one of the start and of the apparent resistances,
        # because a start at the baseline may leave none.
        unscaled = program.parameter.stacked({**parameters, "split_scale": 1.0})
        residuals = program.split_residuals(start_at(values.cells, voltages, 0.0), unscaled)
        split_scale = MIN_SPLIT_UNIT
        if residuals:
            apparent = start_at(values.apparent, values.voltages(values.apparent, scale), 0.0)
            groups = [*residuals, *program.split_residuals(apparent, unscaled)]
            largest = [float(np.abs(group).max(initial=0)) for group in groups]
            split_scale = max(split_scale, *largest)
        # Voltages have no bounds, and parts of split residuals are not negative.
        lower: dict[str, Any] = {"conductance": scale / values.upper, "split": 0.0}
        upper: dict[str, Any] = {"conductance": scale / values.lower}
        for name, unknown in program.own.items():
            lower[name] = unknown.lower
            upper[name] = unknown.upper
        # Kirchhoff's law and splits are equations, = 0.
        low = {constraint.name: constraint.lower for constraint in program.constraints}
        high = {constraint.name: constraint.upper for constraint in program.constraints}
        return cls(
            program,
            start=start_at(values.cells, voltages, _split_start(residuals, split_scale)),
            lower=program.unknown.stacked(lower, default=-np.inf),
            upper=program.unknown.stacked(upper, default=np.inf),
            parameter=program.parameter.stacked({**parameters, "split_scale": split_scale}),
            equations=(
                program.equation.stacked(low, default=0.0),
                program.equation.stacked(high, default=0.0),
            ),
            shape=values.cells.shape,
            scale=scale,
            cost_scale=cost_scale,
            split_scale=split_scale,
        )

    def cells_of(self, result: ProgramResult) -> Array:
        """Return the cells of a result, (frames, rows, columns) ohm.

        A cell is put on a bound if the bound's multiplier exceeds the distance to it, see
        `on_bounds`.
        """
        place = self.program.unknown
        conductance, pull, low, high = (
            place.named(column)["conductance"]
            for column in (result.unknown, result.of_bounds, self.lower, self.upper)
        )
        with np.errstate(divide="ignore"):
            return np.asarray(self.scale / on_bounds(conductance, pull, low, high)).reshape(
                self.shape
            )

    def duals_of(self, result: ProgramResult, slope: Array) -> Array:
        """Return the duals z of absolute losses, (residuals,).

        `slope` are the weights of their residuals.
        """
        weights = np.maximum(slope * self.split_scale / self.cost_scale, np.finfo(float).tiny)
        return np.asarray(self.program.equation.named(result.of_equations)["split"] / weights)

    def multipliers_of(self, result: ProgramResult) -> Multipliers:
        """Return the multipliers of a result, with the units of the program."""
        return Multipliers(result.of_bounds, result.of_equations, self.scale, self.cost_scale)


def _voltage_unit(voltages: Array) -> Array:
    """Return the unit of each voltage of a kind: its size, at least MIN_VOLTAGE of the largest."""
    size = np.abs(voltages)
    return np.asarray(np.maximum(size, MIN_VOLTAGE * size.max(initial=0.0)))


def _split_start(residuals: Sequence[Array], unit: float) -> Array:
    """Return p and q of split residuals ±(p − q), SPLIT_START from their bound, in their unit."""
    split = [np.zeros(0)]
    for group in residuals:
        split += [np.maximum(side / unit, 0) + SPLIT_START for side in (group, -group)]
    return np.concatenate(split)


def on_bounds(conductance: Array, multiplier: Array, low: Array, high: Array) -> Array:
    """Return the conductances, put on a bound where its multiplier exceeds the distance to it.

    The arguments and the result have the shape (…, cells).
    """
    lowered = np.where(-multiplier > conductance - low, low, conductance)
    return np.where(multiplier > high - conductance, high, lowered)


@dataclass(frozen=True, eq=False)
class _FrameValues:
    """Values of a program's symbols, those of all blocks one after the other, by frame."""

    circuits: Sequence[Circuit]
    excitation: Excitation
    blocks: Sequence[Evaluation]

    @property
    def data(self) -> list[Data]:
        """Data of every block."""
        return [block.data for block in self.blocks]

    @property
    def scale(self) -> float:
        """Geometric mean of equal cells with the readings, ohm."""
        return float(np.exp(np.mean(np.log(self.uniform))))

    @property
    def cost_scale(self) -> float:
        """Mean cost of a cell at readings of zero."""
        costs = [float(block.cell_costs) or block.cost_scale for block in self.blocks]
        return float(np.mean(costs))

    @property
    def cells(self) -> Array:
        """Cells of the start, (frames, rows, columns) ohm."""
        return np.concatenate([block.cell_resistance for block in self.blocks])

    @property
    def uniform(self) -> Array:
        """Equal cells with the readings, (frames, rows, columns) ohm."""
        return np.concatenate([data.uniform_start for data in self.data])

    @property
    def apparent(self) -> Array:
        """Apparent resistances, (frames, rows, columns) ohm."""
        return np.concatenate([data.apparent_resistance for data in self.data])

    @property
    def tie(self) -> Array:
        """Ties of the lines, (frames, addresses, lines) siemens.

        0 for lines at ground, which the circuit knows.
        """
        ties = np.concatenate([data.ties for data in self.data])
        ties = ties.reshape(len(ties), len(self.circuits), -1)
        return np.where(np.isinf(ties), 0.0, ties)

    @property
    def upper(self) -> Array:
        """Upper bounds of the cells, (frames, rows, columns) ohm."""
        return np.concatenate([data.upper for data in self.data])

    @property
    def lower(self) -> Array:
        """Lower bounds of the cells.

        Smaller cells than `Readout.nearly_shorted` do not change any reading.
        """
        limits = []
        for data in self.data:
            lower = np.maximum(data.lower, data.readout.nearly_shorted(data.measured))
            limits.append(np.minimum(lower, data.upper))
        return np.concatenate(limits)

    @property
    def given(self) -> dict[str, Array]:
        """Inputs of the terms by name; inputs without a frame are the same in all blocks."""
        first = self.data[0]
        inputs = dict(first.flat)
        for name, source in first.given.sources().items():
            if source.per_frame:
                inputs[name] = np.concatenate([data.flat[name] for data in self.data])
        return inputs

    def voltages(self, cells: Array, scale: float) -> dict[str, Array]:
        """Return the voltages of cells (frames, rows, columns) by name, in the unit `scale`.

        An array contains the voltages of all frames, one after the other.
        """
        readout = self.data[0].readout
        solved = []
        for frame, ties in zip(cells, self.tie, strict=True):
            for circuit, tie in zip(self.circuits, ties, strict=True):
                response = circuit.voltages(frame, tie)
                solved.append(self.excitation.voltages(circuit, readout, response))
        units = {name: 1.0 if name == END_VOLTAGE else scale for name in solved[0]}
        return {
            name: np.concatenate([part[name] for part in solved]) / unit
            for name, unit in units.items()
        }
