"""A program with the numbers of given data, and what IPOPT returns for it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lampest.cost.problem import Evaluation
from lampest.files.typed import ReadOnlyArrays
from lampest.formulation.program import Program
from lampest.formulation.values import Blocks, Values
from lampest.panel.panel import Array


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

    @classmethod
    def none(cls, instance: "Instance") -> "Multipliers":
        """Return multipliers of zero, with which IPOPT begins with a small barrier."""
        of_bounds, of_equations = map(np.zeros_like, (instance.start, instance.equations[0]))
        return cls(of_bounds, of_equations, instance.scale, instance.cost_scale)

    def in_units_of(self, instance: "Instance") -> "Multipliers":
        """Return the multipliers in the units of an instance.

        Multipliers are ∂f/∂(right-hand side), f = φ/`cost_scale`. Balances have no unit;
        conductances are in 1/`scale`, voltages in `scale`.
        """
        share = self.cost_scale / instance.cost_scale
        unknown = instance.program.unknown
        of_bounds = unknown.named(self.of_bounds * share)
        of_bounds["conductance"] = of_bounds["conductance"] * self.scale / instance.scale
        return Multipliers(
            unknown.stacked(of_bounds),
            self.of_equations * share,
            instance.scale,
            instance.cost_scale,
        )


@dataclass(frozen=True, eq=False)
class ProgramResult(ReadOnlyArrays):
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
    history : mapping of str to list of float
        IPOPT's table of iterations: `obj`, `inf_pr`, `inf_du`, `mu`, `d_norm`, step lengths.
    """

    unknown: Array
    of_bounds: Array
    of_equations: Array
    status: str
    iterations: int
    corrected: bool = False
    history: Mapping[str, list[float]] = field(default_factory=dict)

    @classmethod
    def none(cls, instance: "Instance") -> "ProgramResult":
        """Return the result of an instance that was not solved, NaN."""
        unknown, equation = (
            np.full(len(column), np.nan) for column in (instance.start, instance.equations[0])
        )
        return cls(unknown, unknown, equation, "", 0)


@dataclass(frozen=True, eq=False)
class Instance(ReadOnlyArrays):
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
    def of(cls, program: Program, blocks: Sequence[Evaluation]) -> "Instance":
        """Return the instance that begins at the cells of the evaluations, one for each block."""
        unknowns = program.statement.unknowns
        constraints = program.statement.constraints

        def column(kind: str, at: Values) -> Array:
            rules = {name: getattr(each, kind) for name, each in unknowns.items()}
            return program.unknown.stacked(
                {name: rule(at) if callable(rule) else rule for name, rule in rules.items()}
            )

        at = Values.of(program.addresses, blocks)
        if program.unknown.sizes["split"]:
            parameter = program.parameter.stacked(at.parameters)
            apparent = at.with_cells(np.concatenate([data.apparent_resistance for data in at.data]))
            residuals = (
                program.split_residuals(column("start", place), parameter)
                for place in (at, apparent)
            )
            at = at.with_split(*residuals)
        low, high = (
            program.equation.stacked(
                {name: getattr(each, kind) for name, each in constraints.items()}
            )
            for kind in ("lower", "upper")
        )
        return cls(
            program,
            start=column("start", at),
            lower=column("lower", at),
            upper=column("upper", at),
            parameter=program.parameter.stacked(at.parameters),
            equations=(low, high),
            shape=at.cells.shape,
            scale=at.scale,
            cost_scale=at.cost_scale,
            split_scale=at.split_scale,
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

    def begun_at(self, other: "Instance", result: ProgramResult) -> "Instance":
        """Return the instance that begins at the own unknowns of another one's result, by name."""
        column = _by_name(
            result.unknown,
            other.program.unknown,
            self.program.unknown,
            self.start,
            self.program.own,
        )
        return replace(self, start=np.clip(column, self.lower, self.upper))

    def multipliers_from(self, other: "Instance", result: ProgramResult) -> Multipliers:
        """Return the multipliers of another instance's result, by name; zero where it has none."""
        none = Multipliers.none(self)
        of_bounds = _by_name(
            result.of_bounds, other.program.unknown, self.program.unknown, none.of_bounds
        )
        of_equations = _by_name(
            result.of_equations, other.program.equation, self.program.equation, none.of_equations
        )
        return Multipliers(of_bounds, of_equations, other.scale, other.cost_scale)

    def multipliers_of(self, result: ProgramResult) -> Multipliers:
        """Return the multipliers of a result, with the units of the program."""
        return Multipliers(result.of_bounds, result.of_equations, self.scale, self.cost_scale)


def on_bounds(conductance: Array, multiplier: Array, low: Array, high: Array) -> Array:
    """Return the conductances, put on a bound where its multiplier exceeds the distance to it.

    The arguments and the result have the shape (…, cells).
    """
    lowered = np.where(-multiplier > conductance - low, low, conductance)
    return np.where(multiplier > high - conductance, high, lowered)


def _by_name(
    values: Array,
    own: Blocks,
    other: Blocks,
    otherwise: Array,
    names: Collection[str] | None = None,
) -> Array:
    """Return the blocks of a column as those of another one, by name, all or some of them.

    Blocks that it has not, or of another size, are those of the column `otherwise`.
    """
    named = own.named(values)
    blocks = other.named(otherwise)
    for name in blocks if names is None else names:
        if len(named.get(name, ())) == len(blocks[name]):
            blocks[name] = named[name]
    return other.stacked(blocks)
