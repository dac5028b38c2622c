"""The nonlinear program of one frame, or of several.

    minimise    Σ_t w_t ρ_t( x_t(r, y) )
    over        cells g = 1/r,  node voltages V  (one pattern a line: nodal; one a pixel: per_pixel)
    subject to  L(g) V + diag(t) V = I          Kirchhoff's current law at every node
                y = h(V)                        the readout
                r_low ≤ r ≤ r_high              native bounds

Units make all numbers of order one: conductances are s/r with s a typical resistance, voltages for
unit currents have the size of their start, and the cost is divided by that of a cell at readings of
zero. A loss without a second derivative everywhere enters by parts p, q ≥ 0 of its residuals
(`Loss.lowered`). All derivatives are exact and sparse.

`pose` has all of this by name: unknowns with their start and bounds, constraints, and the cost.

Source: paper, equations (2)-(24); Wächter & Biegler, Mathematical Programming 106, 2006 (the method
of IPOPT).
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from numpy.typing import ArrayLike

from lampest.cost.cost import Cost, Summand, Symbols, lowered, program_groups, summands
from lampest.cost.given import Given
from lampest.cost.losses import Lowered
from lampest.cost.terms import term_kind
from lampest.files.errors import InputError, counted, first_and_more, in_words
from lampest.files.typed import real_array
from lampest.formulation.circuit import Circuit, ConductanceSymbols
from lampest.formulation.patterns import (
    END_VOLTAGE,
    EXCITATIONS,
    FrameNetwork,
    NetworkSymbols,
    joined_addresses,
    stacked_networks,
)
from lampest.formulation.values import EMPTY, Blocks, Constraint, ProgramUnknown, Statement, unit_of
from lampest.panel.compiled import CasadiOwner, guarded
from lampest.panel.equation import equation_of
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.wiring import Wiring

if TYPE_CHECKING:
    from lampest.formulation.scene_numbers import SymbolicReadout  # loads every driven readout

CELL_BOUNDS = ("lower", "upper")  # names of the bounds of the cells in sensitivities


def pose(program: "Program") -> Statement:
    """State the unknowns of a program with their start and bounds, its constraints and its cost.

    Everything that is solved stands here by name. The order of the names is that of the columns;
    voltages follow the conductances, see `Program.hessian`.
    """
    network = program.network
    losses = program.lowered

    def voltage(name: str, symbol: casadi.SX) -> ProgramUnknown:
        return ProgramUnknown(symbol, start=lambda at: at.voltages[name] / at.units[name])

    unknowns = {
        # Cells g = s/r, within the bounds of r
        "conductance": ProgramUnknown(
            casadi.vec(program.conductance),
            start=lambda at: at.scale / at.cells,
            lower=lambda at: at.scale / at.upper,
            upper=lambda at: at.scale / at.lower,
        ),
        # Node voltages V of every pattern, those of the start's cells, without bounds
        **{name: voltage(name, symbol) for name, symbol in network.voltages.items()},
        # Parts p, q of residuals whose loss has no second derivative at zero
        "split": ProgramUnknown(
            casadi.vertcat(EMPTY, *(side for part in losses for side in part.split)),
            start=lambda at: at.split,
            lower=0.0,
        ),
        **program.own,
    }
    constraints = {
        # Kirchhoff's current law at every node: L(g) V + diag(t) V − I = 0
        "balance": Constraint(network.balance),
        # p − q − x = 0
        "split": Constraint(
            casadi.vertcat(EMPTY, *(part.equation for part in losses if part.equation is not None))
        ),
        **program.own_constraints,
    }
    # φ = Σ_t w_t ρ_t(x_t(r, y)) + own costs, with y = h(V)
    cost = sum((part.objective for part in losses), casadi.SX(0)) + program.own_cost
    return Statement(unknowns, constraints, cost / program.cost_scale)


@dataclass(frozen=True, eq=False)
class Program(CasadiOwner):
    """Symbols of some frames, and what a user adds to their program; `pose` states the program.

    Attributes
    ----------
    cost : Cost
        Terms over one block of frames: a single frame, or a baseline and its first frame.
    shape : tuple of int
        Rows and columns.
    conductance : casadi.SX, shape (cells, frames)
        s/r.
    addresses : tuple of pairs of Circuit and NetworkSymbols
        Circuit of each address of the readout, and its network in one frame.
    network : NetworkSymbols
        Voltages and current balances of all frames.
    reading : casadi.SX, shape (cells, frames)
        y = h(V), as the terms read it.
    given : Given
        Readings, noise and earlier frames.
    tie, weight, scale, cost_scale, split_scale : casadi.SX
        Ties (lines, frames · addresses) in 1/s, weights of the terms, s in ohm, units of costs and
        split residuals.
    own : mapping of str to ProgramUnknown
        Unknowns that a user adds.
    own_cost : casadi.SX, shape (1, 1)
        Costs that a user adds, in the unit of φ.
    own_constraints : mapping of str to Constraint
        Constraints that a user adds.
    """

    cost: Cost
    shape: tuple[int, int]
    conductance: casadi.SX
    addresses: tuple[tuple[Circuit, NetworkSymbols], ...]
    network: NetworkSymbols
    reading: casadi.SX
    given: Given
    tie: casadi.SX
    weight: casadi.SX
    scale: casadi.SX
    cost_scale: casadi.SX
    split_scale: casadi.SX
    own: Mapping[str, ProgramUnknown] = field(default_factory=dict)
    own_cost: casadi.SX = casadi.SX(0)
    own_constraints: Mapping[str, Constraint] = field(default_factory=dict)

    @classmethod
    def build(
        cls,
        cost: Cost,
        readout: Readout,
        wiring: Wiring | None,
        excitation: str,
        blocks: int = 1,
        symbolic: "SymbolicReadout | None" = None,
    ) -> "Program":
        """Return the program of a cost, over a number of independent blocks of frames.

        Parameters
        ----------
        cost : Cost
        readout : Readout
        wiring : Wiring or None
        excitation : {'nodal', 'per_pixel'}
        blocks : int
        symbolic : SymbolicReadout or None
            The readout with numbers that are unknown, the same in all frames.
        """
        frames = blocks * cost.frames
        rows, columns = cost.panel.shape
        circuits = Circuit.of_readout(readout, (rows, columns), wiring)
        tie = casadi.SX.sym("tie", rows + columns, frames * len(circuits))
        scale, cost_scale, split_scale = map(casadi.SX.sym, ("scale", "cost_scale", "split_scale"))
        conductance = casadi.SX.sym("conductance", rows * columns, frames)
        equation = equation_of(readout, rows, columns) if symbolic is None else symbolic
        of_readout = 0 if symbolic is None else scale * symbolic.tie
        networks = []
        for frame, ties in enumerate(casadi.horzsplit(tie, len(circuits))):
            addresses = []
            for circuit, tied in zip(circuits, casadi.horzsplit(ties + of_readout), strict=True):
                symbols = ConductanceSymbols(conductance[:, frame], tied, scale, equation.reading)
                addresses.append(EXCITATIONS[excitation](FrameNetwork(circuit, readout, symbols)))
            networks.append(joined_addresses(circuits, addresses))
        network = stacked_networks(networks)
        program = cls(
            cost,
            (rows, columns),
            conductance,
            tuple(zip(circuits, addresses, strict=True)),
            network,
            network.reading,
            Given.symbols(rows * columns, frames, partial=cost.partial),
            tie,
            casadi.SX.sym("weights", len(cost.terms)),
            scale,
            cost_scale,
            split_scale,
        )
        if symbolic is None:
            return program
        own = {
            each.key: ProgramUnknown(symbolic.symbols[each.key], each.value, each.least)
            for each in symbolic.numbers
        }
        program = replace(program, own=own, own_cost=symbolic.prior)
        return program.with_reading(symbolic.as_the_scene_reads)

    def __repr__(self) -> str:
        """Return the program as a table of cost, unknowns and constraints, with their sizes."""
        frames = counted(self.conductance.shape[1], "frame")
        rows, columns = self.shape
        lines = [f"program of {frames} of {rows} × {columns} cells", "minimise"]
        sizes = Counter[int]()
        for part in chain(*self.groups):
            sizes[part.term] += part.rows
        lines += [
            f"    {term_kind(term):<24}{counted(sizes[number], 'residual'):>16}  {term.loss.kind}"
            for number, term in enumerate(self.cost.terms)
        ]
        if not self.own_cost.is_zero():
            lines.append(f"    {'own cost':<24}{'1 number':>16}")
        parts = (
            ("over", "unknown", self.unknown, self.statement.unknowns),
            ("subject to", "row", self.equation, self.statement.constraints),
        )
        for heading, word, blocks, rules in parts:
            lines.append(heading)
            for name, size in blocks.sizes.items():
                limits = _in_words(rules[name].lower, rules[name].upper)
                lines += [f"    {name:<24}{counted(size, word):>16}{limits}"] * bool(size)
        return "\n".join(lines)

    @property
    def cell_resistance(self) -> casadi.SX:
        """Cells r in ohm, (cells, frames)."""
        return self.scale / self.conductance

    def cells(self, frame: int = 0) -> casadi.SX:
        """Return the cells of one frame in ohm, (rows, columns).

        Raises InputError for a frame that the program does not have.
        """
        rows, columns = self.shape
        frames = self.conductance.shape[1]
        if not (isinstance(frame, int | np.integer) and 0 <= frame < frames):
            raise InputError(
                f"cells(frame) counts the frames of the program, 0 to {frames - 1}, not {frame!r}"
            )
        return casadi.reshape(self.cell_resistance[:, frame], columns, rows).T

    def with_unknown(
        self,
        name: str,
        *,
        size: int = 1,
        start: ArrayLike | None = None,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        mean: ArrayLike = 0.0,
        sd: ArrayLike = np.inf,
    ) -> "tuple[Program, casadi.SX]":
        """Return the program with a further unknown x, and its symbol (size, 1).

        Each argument is a number, or one for each entry of x. A prior adds Σ ((x − mean)/sd)² to
        the cost; an infinite sd is none. The start is by default the mean, within the bounds.
        Raises InputError if the name is taken, or a number is out of range.
        """
        _check_text(name, "the name of an unknown")
        if name in self.quantities:
            raise InputError(
                f"the program has an unknown {name} already: {', '.join(self.quantities)}"
            )
        if not (isinstance(size, int | np.integer) and size >= 1):
            raise InputError(f"unknown {name} needs a size of 1 or more, not {size!r}")
        low, high, centre, deviation, begin = (
            _column(value, size, f"{key} of unknown {name}")
            for key, value in (
                ("lower", lower),
                ("upper", upper),
                ("mean", mean),
                ("sd", sd),
                ("start", mean if start is None else start),
            )
        )
        if start is None:
            begin = np.clip(centre, low, high)
        inside = (low < high) & (low <= begin) & (begin <= high)
        if not np.all(inside & (deviation > 0) & np.isfinite(centre + begin)):
            raise InputError(
                f"unknown {name} needs lower < upper and sd > 0, and a finite mean, and a start "
                f"within the bounds, not {_brief(low)}, {_brief(high)}, {_brief(deviation)}, "
                f"{_brief(centre)} and {_brief(begin)}"
            )
        symbol = casadi.SX.sym(name, int(size))
        known = np.flatnonzero(np.isfinite(deviation)).tolist()
        departures = [(symbol[entry] - centre[entry]) / deviation[entry] for entry in known]
        prior = casadi.sumsqr(casadi.vertcat(EMPTY, *departures))
        own = {**self.own, name: ProgramUnknown(symbol, begin, low, high)}
        return replace(self, own=own, own_cost=self.own_cost + prior), symbol

    def with_reading(self, changed: Callable[[casadi.SX], Any]) -> "Program":
        """Return the program whose terms read changed(y) in place of y.

        y and changed(y) have the shape (cells, frames) and the readout's unit. Raises InputError if
        `changed` is no function, and as `expression`.
        """
        if not callable(changed):
            raise InputError(f"with_reading needs a function of y, not {in_words(changed)}")
        reading = self.expression("the changed reading", changed(self.reading), self.reading.shape)
        return replace(self, reading=reading)

    def with_cost(self, added: Any) -> "Program":
        """Return the program with a further cost in the unit of φ. Raises as `expression`."""
        cost = self.expression("an own cost", added, (1, 1))
        return replace(self, own_cost=self.own_cost + cost)

    def subject_to(
        self,
        name: str,
        expression: Any,
        lower: ArrayLike = 0.0,
        upper: ArrayLike | None = None,
    ) -> "Program":
        """Return the program with a constraint lower ≤ expression ≤ upper.

        The constraint is an equation if there is no upper limit. A limit is a number, or one for
        each row. Raises InputError if the name is taken, or the expression is no column, or has no
        derivative by the unknowns, as a comparison has none, or no number lies between the limits.
        """
        _check_text(name, "the name of a constraint")
        if name in {*self.statement.constraints, *self.parameter.sizes, *CELL_BOUNDS}:
            raise InputError(f"the program has a constraint or a given number {name} already")
        expression = self.expression(f"constraint {name}", expression)
        rows, columns = expression.shape
        if columns != 1 or not rows:
            raise InputError(
                f"constraint {name} is {rows} × {columns}, not a column (rows, 1); "
                "casadi.vec makes one of a matrix"
            )
        slopes = casadi.sparsify(casadi.jacobian(expression, self.unknown.column))
        if not slopes.nnz():
            raise InputError(
                f"constraint {name} has no derivative by the unknowns "
                f"{', '.join(self.unknown.symbols)}; a comparison is written with its limits, "
                "as lower and upper"
            )
        low = _column(lower, rows, f"lower limit of constraint {name}")
        high = low if upper is None else _column(upper, rows, f"upper limit of constraint {name}")
        if not np.all((low <= high) & (low < np.inf) & (high > -np.inf)):
            raise InputError(
                f"constraint {name} needs lower <= upper, and an equation a finite number, "
                f"not {lower!s} and {upper!s}"
            )
        constraint = Constraint(expression, low, high)
        return replace(self, own_constraints={**self.own_constraints, name: constraint})

    @guarded
    def expression(self, name: str, value: Any, shape: tuple[int, int] | None = None) -> casadi.SX:
        """Return a value as an expression of the program's symbols.

        Raises InputError for another object, another shape than `shape`, and for symbols that are
        not the program's.
        """
        try:
            expression = casadi.SX(value)
        except (NotImplementedError, TypeError) as error:
            raise InputError(
                f"{name} must be an expression of the program's symbols, a casadi.SX, "
                f"not {in_words(value)}"
            ) from error
        if shape is not None and expression.shape != shape:
            actual, required = (" × ".join(map(str, size)) for size in (expression.shape, shape))
            raise InputError(f"{name} is {actual}; it must be {required}")
        arguments = [self.unknown.column, self.parameter.column]
        free = casadi.Function("value", arguments, [expression], {"allow_free": True}).free_sx()
        if free:
            raise InputError(
                f"{name} depends on {first_and_more(free)}, which is no symbol of this program; "
                "with_unknown adds one"
            )
        return expression

    def own_speaks_of(self, frame: int) -> bool:
        """Return whether an own cost or an own constraint depends on the cells of a frame."""
        parts = [self.own_cost, *(each.expression for each in self.own_constraints.values())]
        return bool(casadi.depends_on(casadi.vertcat(*parts), self.conductance[:, frame]))

    @cached_property
    def groups(self) -> list[list[Summand]]:
        """Costs w·ρ(x) of all terms and frames, in groups that are lowered together."""
        pairs = []
        size = self.cost.frames
        sources = self.given.sources()
        for first in range(0, self.conductance.shape[1], size):
            block = slice(first, first + size)
            # Inputs of one block of frames
            some = {
                name: value[:, block] if sources[name].per_frame else value
                for name, value in self.given.named()
            }
            given = replace(self.given, **some)
            symbols = Symbols(self.cell_resistance[:, block], self.reading[:, block], given)
            pairs += self.cost.residuals(symbols)
        return program_groups(summands(self.cost.terms, pairs, self.weight))

    @cached_property
    def lowered(self) -> list[Lowered]:
        """The groups in the form of an interior-point method, `Loss.lowered`."""
        return [lowered(group, self.split_scale) for group in self.groups]

    @guarded
    def split_residuals(self, unknown: Array, parameter: Array) -> list[Array]:
        """Return the residuals of each group that is split into p and q, for values of x and p."""
        return [value.full().ravel() for value in self._split_residuals.call([unknown, parameter])]

    @cached_property
    def _split_residuals(self) -> casadi.Function:
        """Function (x, p) → residuals, a column for each group of split terms."""
        residuals = [
            casadi.vertcat(*(part.residual for part in group))
            for group in self.groups
            if group[0].loss.enters != "whole"
        ]
        return casadi.Function("split", [self.unknown.column, self.parameter.column], residuals)

    @cached_property
    def statement(self) -> Statement:
        """The program as it is solved."""
        return pose(self)

    @cached_property
    def unknown(self) -> Blocks:
        """Unknowns by name: 'conductance', the voltages, 'split' (p, q), and own ones."""
        return Blocks({name: each.symbol for name, each in self.statement.unknowns.items()})

    @cached_property
    def parameter(self) -> Blocks:
        """Parameters by name: the fields of `Given`, units, ties and weights."""
        given = {name: casadi.vec(symbol) for name, symbol in self.given.named()}
        voltages = {unit_of(name): unit for name, unit in self.network.units.items()}
        return Blocks(
            {
                **given,
                **voltages,
                "tie": casadi.vec(self.tie),
                "weights": self.weight,
                "scale": self.scale,
                "cost_scale": self.cost_scale,
                "split_scale": self.split_scale,
            }
        )

    @cached_property
    def quantities(self) -> dict[str, casadi.SX]:
        """Unknowns by name, in units that do not depend on the data, and functions of them.

        Conductances are in siemens, voltages in volt or V/A, parts of residuals in their own unit.
        """
        units = {"conductance": 1 / self.scale, "split": self.split_scale}
        for name, unit in self.network.units.items():
            units[name] = unit if name == END_VOLTAGE else unit * self.scale
        natural = {
            name: symbol * units.get(name, 1) for name, symbol in self.unknown.symbols.items()
        }
        cells = casadi.vec(self.cell_resistance)
        return {
            **natural,
            "cell_resistance": cells,
            "log_cell_resistance": casadi.log(cells),
            "reading": casadi.vec(self.reading),
        }

    @cached_property
    def equation(self) -> Blocks:
        """Constraints by name: 'balance' of the currents, 'split' (p − q = x), and own ones."""
        return Blocks({name: each.expression for name, each in self.statement.constraints.items()})

    @property
    def nlp(self) -> dict[str, casadi.SX]:
        """The program in the form of CasADi's solvers."""
        return {
            "x": self.unknown.column,
            "p": self.parameter.column,
            "f": self.statement.cost,
            "g": self.equation.column,
        }

    @cached_property
    def derivatives(self) -> dict[str, casadi.Function]:
        """Gradient of f, Jacobian of g, and Hessian of the Lagrangian, by CasADi's names."""
        program = casadi.Function("nlp", self.nlp, ["x", "p"], ["f", "g"])
        return {
            "grad_f": program.factory("nlp_grad_f", ["x", "p"], ["f", "grad:f:x"]),
            "jac_g": program.factory("nlp_jac_g", ["x", "p"], ["g", "jac:g:x"]),
            "hess_lag": self.hessian(),
        }

    def hessian(self) -> casadi.Function:
        """Return the function (x, p, σ, λ) → ∇²(σf + λᵀg), upper triangle, (x, x) sparse.

        The current balance is bilinear: its second derivatives are one block between conductances
        and voltages, which follow each other in x. Everything else is differentiated twice.
        """
        unknown = self.unknown.column
        weight = casadi.SX.sym("weight")
        multiplier = casadi.SX.sym("multiplier", self.equation.column.shape[0])
        count = self.equation.sizes["balance"]
        voltages = casadi.vertcat(*self.network.voltages.values())
        lagrangian = weight * self.statement.cost + casadi.dot(
            multiplier[count:], self.equation.column[count:]
        )
        full, _ = casadi.hessian(lagrangian, unknown)
        slope = casadi.gradient(casadi.dot(multiplier[:count], self.network.balance), voltages)
        block = casadi.jacobian(slope, self.unknown.symbols["conductance"])
        first = self.unknown.sizes["conductance"]
        upper = casadi.triu(full)
        upper[:first, first : first + voltages.shape[0]] += block.T
        arguments = [unknown, self.parameter.column, weight, multiplier]
        return casadi.Function("nlp_hess_l", arguments, [upper])


def _check_text(name: Any, what: str) -> None:
    """Raise InputError unless a name is a text."""
    if not isinstance(name, str):
        raise InputError(f"{what} is a text, not {in_words(name)}")


def _column(values: ArrayLike, size: int, label: str) -> Array:
    """Return a number, or one for each entry, as a column of numbers, (size,).

    Raises InputError for another count, and for what is no number.
    """
    column = real_array(values, label).ravel()
    if column.size not in (1, size):
        raise InputError(f"{label} has {counted(column.size, 'number')}; it needs 1 or {size}")
    return np.broadcast_to(column, (size,))


def _brief(column: Array) -> str:
    """Return the numbers of a column in words, those of equal entries once."""
    return ", ".join(f"{value:g}" for value in np.unique(column))


def _in_words(lower: Any, upper: Any) -> str:
    """Return limits in words, such as '  = 0' or '  0 to 30'."""
    if callable(lower) or callable(upper):
        return "  within the bounds of the cells"
    low, high = np.min(lower), np.max(upper)
    if np.array_equal(lower, upper):
        return f"  = {low:g}" if low == high else "  equations"
    return "" if np.isinf(low) and np.isinf(high) else f"  {low:g} to {high:g}"
