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


@dataclass(frozen=True, eq=False)
class ProgramResult(ReadOnlyArrays):
    """Result of IPOPT for an instance, in its units.

    Attributes
    ----------
    instance : Instance
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

    instance: Instance
    unknown: Array
    of_bounds: Array
    of_equations: Array
    status: str
    iterations: int
    corrected: bool = False
    history: Mapping[str, list[float]] = field(default_factory=dict)

    @classmethod
    def none(cls, instance: Instance) -> "ProgramResult":
        """Return the result of an instance that was not solved: unknowns NaN, multipliers zero.

        With multipliers of zero IPOPT begins with a small barrier.
        """
        of_bounds, of_equations = map(np.zeros_like, (instance.start, instance.equations[0]))
        return cls(instance, of_bounds + np.nan, of_bounds, of_equations, "", 0)

    @property
    def cells(self) -> Array:
        """Cells, (frames, rows, columns) ohm.

        A cell is put on a bound if the bound's multiplier exceeds the distance to it, see
        `on_bounds`.
        """
        instance = self.instance
        conductance, pull, low, high = (
            instance.program.unknown.named(column)["conductance"]
            for column in (self.unknown, self.of_bounds, instance.lower, instance.upper)
        )
        with np.errstate(divide="ignore"):
            cells = instance.scale / on_bounds(conductance, pull, low, high)
        return np.asarray(cells).reshape(instance.shape)

    def duals(self, slope: Array) -> Array:
        """Return the duals z of absolute losses, (residuals,).

        `slope` are the weights of their residuals.
        """
        instance = self.instance
        weights = slope * instance.split_scale / instance.cost_scale
        split = instance.program.equation.named(self.of_equations)["split"]
        return np.asarray(split / np.maximum(weights, np.finfo(float).tiny))

    def start_of(self, instance: Instance) -> Instance:
        """Return an instance that begins at the own unknowns of this result, by name."""
        own, other = self.instance.program, instance.program
        column = _by_name(self.unknown, own.unknown, other.unknown, instance.start, other.own)
        return replace(instance, start=np.clip(column, instance.lower, instance.upper))

    def multipliers_of(self, instance: Instance) -> tuple[Array, Array]:
        """Return the multipliers in the units of an instance, by name; zero where there are none.

        Multipliers are ∂f/∂(right-hand side), f = φ/`cost_scale`. Balances have no unit;
        conductances are in 1/`scale`, voltages in `scale`.

        Returns
        -------
        of_bounds : array, shape (unknowns,)
        of_equations : array, shape (constraints,)
        """
        own, other = self.instance.program, instance.program
        share = self.instance.cost_scale / instance.cost_scale
        of_equations = _by_name(self.of_equations * share, own.equation, other.equation)
        of_bounds = other.unknown.named(
            _by_name(self.of_bounds * share, own.unknown, other.unknown)
        )
        of_bounds["conductance"] = of_bounds["conductance"] * self.instance.scale / instance.scale
        return other.unknown.stacked(of_bounds), of_equations


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
    otherwise: Array | float = 0.0,
    names: Collection[str] | None = None,
) -> Array:
    """Return the blocks of a column as those of another one, by name, all or some of them.

    Blocks that it has not, or of another size, are those of `otherwise`.
    """
    named = own.named(values)
    blocks = other.named(np.broadcast_to(otherwise, sum(other.sizes.values())))
    for name in blocks if names is None else names:
        if len(named.get(name, ())) == len(blocks[name]):
            blocks[name] = named[name]
    return other.stacked(blocks)
