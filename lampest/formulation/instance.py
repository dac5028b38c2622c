"""Numbers of a program for given data: start, parameters, bounds and units.

They are given by the names of the program's blocks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.formulation.circuit import Circuit
from lampest.formulation.patterns import Excitation
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
    """ProgramResult of IPOPT.

    Attributes
    ----------
    unknown : array, shape (unknowns,)
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
        """Return the instance that begins at the cells of the evaluations.

        There is one evaluation for each block of frames.
        """
        known = _Known(circuits, excitation, blocks)
        scale = known.scale
        cost_scale = known.cost_scale
        voltages = known.voltages(known.cells, scale)
        size = {name: _voltage_unit(part) for name, part in voltages.items()}
        values: dict[str, Any] = {
            **known.given,
            "tie": known.tie * scale,
            "weights": blocks[0].weights,
            "scale": scale,
            "cost_scale": cost_scale,
            **{unit_of(name): part for name, part in size.items()},
        }

        def stacked(cells: Array, voltages: dict[str, Array], split: Array | float) -> Array:
            scaled = {name: part / size[name] for name, part in voltages.items()}
            own = {name: unknown.start for name, unknown in program.own.items()}
            return program.unknown.stacked(
                {"conductance": scale / cells, **scaled, "split": split, **own}
            )

        # Unit of split residuals: the largest one of the start and of the apparent resistances,
        # because a start at the baseline may leave none.
        parameter = program.parameter.stacked({**values, "split_scale": 1.0})
        residuals = program.split_residuals(stacked(known.cells, voltages, 0.0), parameter)
        split_scale = MIN_SPLIT_UNIT
        if residuals:
            apparent = stacked(known.apparent, known.voltages(known.apparent, scale), 0.0)
            groups = [*residuals, *program.split_residuals(apparent, parameter)]
            split_scale = max(
                split_scale, *(float(np.abs(group).max(initial=0)) for group in groups)
            )
        lower = {name: unknown.lower for name, unknown in program.own.items()}
        upper = {name: unknown.upper for name, unknown in program.own.items()}
        return cls(
            program,
            stacked(known.cells, voltages, _split_start(residuals, split_scale)),
            program.unknown.stacked(
                {"conductance": scale / known.upper, "split": 0.0, **lower}, default=-np.inf
            ),
            program.unknown.stacked({"conductance": scale / known.lower, **upper}, default=np.inf),
            program.parameter.stacked({**values, "split_scale": split_scale}),
            (_equation_limits(program, "lower"), _equation_limits(program, "upper")),
            known.cells.shape,
            scale,
            cost_scale,
            split_scale,
        )

    def cells_of(self, result: ProgramResult) -> Array:
        """Return the cells of a result, (frames, rows, columns) ohm.

        They are on a bound where its multiplier says so.
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
    sides = [side for group in residuals for side in (group, -group)]
    split = [np.maximum(side / unit, 0) + SPLIT_START for side in sides]
    return np.concatenate([np.zeros(0), *split])


def _equation_limits(program: Program, side: str) -> Array:
    """Return the limits of the constraints, 'lower' or 'upper'; those of equations are 0."""
    limits = {part.name: getattr(part, side) for part in program.constraints}
    return program.equation.stacked(limits, default=0.0)


def on_bounds(conductance: Array, multiplier: Array, low: Array, high: Array) -> Array:
    """Return the conductances, put on a bound where its multiplier exceeds the distance to it.

    All have shape (…, cells).
    """
    lowered = np.where(-multiplier > conductance - low, low, conductance)
    return np.where(multiplier > high - conductance, high, lowered)


@dataclass(frozen=True, eq=False)
class _Known:
    """Data of all blocks, frame by frame."""

    circuits: Sequence[Circuit]
    excitation: Excitation
    blocks: Sequence[Evaluation]

    def _frames(self, of: "list[Array]") -> Array:
        """Return values of the blocks one after the other, (frames, …)."""
        return np.concatenate(of)

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
        return float(
            np.mean([float(block.cell_costs) or block.cost_scale for block in self.blocks])
        )

    @property
    def cells(self) -> Array:
        """Cells of the start, (frames, rows, columns) ohm."""
        return self._frames([block.cell_resistance for block in self.blocks])

    @property
    def uniform(self) -> Array:
        """Equal cells with the readings, (frames, rows, columns) ohm."""
        return self._frames([data.uniform_start for data in self.data])

    @property
    def apparent(self) -> Array:
        """Apparent resistances, (frames, rows, columns) ohm."""
        return self._frames([data.apparent_resistance for data in self.data])

    @property
    def tie(self) -> Array:
        """Ties of the lines, (frames, addresses, lines) siemens.

        0 for lines at ground, which the circuit knows.
        """
        ties = self._frames([data.ties for data in self.data])
        ties = ties.reshape(len(ties), len(self.circuits), -1)
        return np.where(np.isinf(ties), 0.0, ties)

    @property
    def upper(self) -> Array:
        """Upper bounds of the cells, (frames, rows, columns) ohm."""
        return self._frames([data.upper for data in self.data])

    @property
    def lower(self) -> Array:
        """Lower bounds of the cells.

        Smaller cells than `Readout.nearly_shorted` do not change any reading.
        """
        return self._frames(
            [
                np.minimum(
                    np.maximum(data.lower, data.readout.nearly_shorted(data.measured)), data.upper
                )
                for data in self.data
            ]
        )

    @property
    def given(self) -> dict[str, Array]:
        """Inputs of the terms by name; those of no single frame are the same in all blocks."""
        first = self.data[0]
        sources = self.data[0].given.sources()
        return {
            name: np.concatenate([data.flat[name] for data in self.data])
            if sources[name].per_frame
            else values
            for name, values in first.flat.items()
        }

    def voltages(self, cells: Array, scale: float) -> dict[str, Array]:
        """Return the voltages of cells (frames, rows, columns) by name.

        They are given frame after frame, in `scale`.
        """
        readout = self.data[0].readout
        solved = [
            self.excitation.voltages(circuit, readout, circuit.voltages(one, tie))
            for one, ties in zip(cells, self.tie, strict=True)
            for circuit, tie in zip(self.circuits, ties, strict=True)
        ]
        return {name: np.concatenate([part[name] for part in solved]) / scale for name in solved[0]}
