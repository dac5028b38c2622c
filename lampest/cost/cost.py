"""The cost function of one frame, or of a baseline and its first frame, with sparse derivatives.

φ = Σ_terms weight · loss(residual). This module is symbolic; values and the adjoint product from
potentials to cells are in `lampest.cost.problem`. Weights are parameters of the compiled functions,
so that costs that differ only in their weights share these functions.
"""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi
import numpy as np

from lampest.cost.given import Given
from lampest.cost.losses import Loss, Lowered
from lampest.cost.terms import State, Term, term_kind
from lampest.files.errors import InputError
from lampest.files.typed import ReadOnlyArrays
from lampest.panel.compiled import Compiled, guarded
from lampest.panel.panel import Array, Numbers, Panel


@dataclass(frozen=True)
class Cost(ReadOnlyArrays):
    """Cost φ over `frames` frames of a panel, built once and evaluated for any data.

    A loss without a derivative at 0 enters through its dual variables z, |z| ≤ 1: weight · Σ z·x.

    Attributes
    ----------
    panel : Panel
    terms : tuple of Term
    frames : int
        1, or 2 for a joint solve. The first of two frames is the baseline and the previous frame of
        the second; terms that need a previous frame skip it.
    faulty : tuple of int
        Numbers of faulty cells; residuals that depend on them are left out.
    partial : bool
        Whether readings may be one-sided or missing.
    """

    panel: Panel
    terms: tuple[Term, ...]
    frames: int = 1
    faulty: tuple[int, ...] = ()
    partial: bool = False

    @property
    def convex_losses(self) -> bool:
        """Whether every loss is convex."""
        return all(term.loss.convex for term in self.terms)

    @property
    def needs_previous(self) -> bool:
        """Whether a single frame needs a known previous one."""
        return self.frames == 1 and any(term.needs_previous for term in self.terms)

    @cached_property
    def weights(self) -> Array:
        """Weights of the terms, in their order.

        Raises ValueError if a weight is still to be chosen.
        """
        return np.array([float(term.weight) for term in self.terms])

    @cached_property
    def unweighted(self) -> "Cost":
        """The same cost with weights of one."""
        return replace(self, terms=tuple(replace(term, weight=1.0) for term in self.terms))

    def symbols(self) -> "Symbols":
        """Return new symbols of all inputs of the cost except weights and duals."""
        shape = self.panel.crossings, self.frames
        cell_resistance, reading = (
            casadi.SX.sym(name, *shape) for name in ("cell_resistance", "reading")
        )
        return Symbols(cell_resistance, reading, Given.symbols(*shape, partial=self.partial))

    def residuals(self, symbols: "Symbols") -> list[tuple[int, casadi.SX]]:
        """Return the residuals of all terms as expressions, frame by frame.

        Residuals leave out the rows that depend on a faulty cell.

        Returns
        -------
        list of (int, casadi.SX)
            Number of the term, and its residual (rows, 1).
        """
        pairs = []
        for frame in range(self.frames):
            baseline = symbols.cell_resistance[:, 0] if frame else None
            # Frame 1 of a joint solve compares with frame 0, its baseline; a single frame compares
            # with given earlier frames.
            inputs = symbols.given.of_frame(frame, baseline, looks_back=self.needs_previous)
            cells = symbols.cell_resistance[:, frame]
            reading = symbols.reading[:, frame]
            state = State(panel=self.panel, cell_resistance=cells, reading=reading, **inputs)
            for number, term in enumerate(self.terms):
                if frame or self.needs_previous or not term.needs_previous:
                    pairs.append((number, _residual_of(term, state)))
        if not self.faulty:
            return pairs
        return [
            (number, part[rows])
            for (number, part), rows in zip(pairs, self._sound_rows, strict=True)
        ]

    @cached_property
    def _sound_rows(self) -> list[list[int]]:
        """Numbers of the rows of each residual that do not depend on a faulty cell."""
        symbols = self.symbols()
        faulty = casadi.vec(symbols.cell_resistance[list(self.faulty), :])
        rows = []
        for _, residual in replace(self, faulty=()).residuals(symbols):
            touched = set(casadi.jacobian_sparsity(residual, faulty).row())
            rows.append([row for row in range(residual.shape[0]) if row not in touched])
        return rows

    @cached_property
    def functions(self) -> "CostFunctions":
        """The cost and its derivatives, compiled at first use.

        Costs that differ only in weights share them.
        """
        return _functions(self.unweighted)

    @cached_property
    def slope(self) -> Array:
        """Weight of every residual that enters through a dual."""
        return self.weights[self.functions.nonsmooth_terms]


def _residual_of(term: Term, state: State) -> casadi.SX:
    """Return a term's residual (rows, 1). Raises InputError if it is no column, or constant."""
    name = f"term {term_kind(term)}: residual(state)"
    try:
        # np.log of a symbol is CasADi's; its notice of a change of types is for others
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", r"\s*casadi: a numpy function", FutureWarning)
            residual = casadi.SX(term.residual(state))
    except Exception as error:
        shape = f"fields of state are columns of {state.panel.crossings} cells"
        if state.panel.cells is not None:
            shape += ", and gradients of listed cells have a row for each pair"
        if not term.needs_previous:
            shape += "; a term that reads state.previous or state.baseline says needs_previous"
        raise InputError(
            f"{name} raises {type(error).__name__} ({str(error).splitlines()[-1]}): {shape}"
        ) from error
    rows, columns = residual.shape
    unknown = casadi.vertcat(state.cell_resistance, state.reading)
    if columns != 1 or (rows == 0 and len(state.panel.neighbours[2])):
        raise InputError(
            f"{name} is {rows} × {columns}, not a column of one or more rows; "
            "fields of state are columns, "
            "state.grid(state.cell_resistance) is the matrix of rows × columns, "
            "and casadi.vec makes a column of one"
        )
    if len(state.panel.neighbours[2]) and _symbols_in(residual).isdisjoint(_symbols_in(unknown)):
        raise InputError(
            f"{name} is constant: it must depend on state.cell_resistance or state.reading"
        )
    return residual


def _symbols_in(expression: casadi.SX) -> set[int]:
    """Return keys of the scalar symbols of which an expression is made."""
    return {symbol.element_hash() for symbol in casadi.symvar(expression)}


@dataclass(frozen=True, eq=False)
class Symbols:
    """Symbols of a cost's inputs.

    Attributes
    ----------
    cell_resistance, reading : casadi.SX, shape (cells, frames)
        Unknowns r and y.
    given : Given
        Symbols of all other inputs.
    """

    cell_resistance: casadi.SX
    reading: casadi.SX
    given: Given

    @property
    def unknown(self) -> casadi.SX:
        """All unknowns (r; y) as one column, (2·cells·frames, 1)."""
        return casadi.vertcat(casadi.vec(self.cell_resistance), casadi.vec(self.reading))

    def inputs(self) -> dict[str, casadi.SX]:
        """Return name → flat symbol of the inputs of compiled functions."""
        named: dict[str, Any] = {"cell_resistance": self.cell_resistance, "reading": self.reading}
        return {
            name: casadi.vec(symbol) for name, symbol in (named | dict(self.given.named())).items()
        }

    def compiled(self, name: str, output: casadi.SX, **more: casadi.SX) -> Compiled:
        """Return a compiled function, called by names, of the inputs that an output depends on.

        The inputs `more` are inputs of the function in any case.
        """
        contained = _symbols_in(output)
        used = {
            name: symbol
            for name, symbol in self.inputs().items()
            if not contained.isdisjoint(_symbols_in(symbol))
        } | more
        return Compiled(casadi.Function(name, [*used.values()], [output], [*used], ["value"]))


@dataclass(frozen=True, eq=False)
class CostFunctions:
    """Compiled functions of inputs, of the terms' weights and of the duals.

    The inputs are those that `Symbols.inputs` names.

    Attributes
    ----------
    first : Compiled
        Cost of each term, the same at readings of zero, and the gradient of Σ smooth + Σ weight·z·x
        with respect to (cells; readings), in one call.
    hessian : Compiled
        Second derivatives of the same function, sparse.
    nonsmooth, nonsmooth_jacobian : Compiled
        Residuals x that enter through duals, and their derivatives.
    nonsmooth_terms : array of int
        Number of the term of each residual that enters through a dual.
    """

    first: Compiled
    hessian: Compiled
    nonsmooth: Compiled
    nonsmooth_jacobian: Compiled
    nonsmooth_terms: Numbers

    @cached_property
    def entries(self) -> "Entries":
        """Places of the nonzero second derivatives of the smooth losses."""
        rows, columns = self.hessian.pattern
        count = self.hessian.structure.shape[0] // 2
        cells = np.flatnonzero((rows < count) & (columns < count))
        model = np.flatnonzero((rows >= count) & (columns >= count))
        diagonal = np.array_equal(rows[model], columns[model])
        pivots = np.flatnonzero(rows == columns)
        return Entries(
            cells=cells,
            at_cells=(rows[cells], columns[cells]),
            model=model,
            at_model=rows[model] - count if diagonal else None,
            crossed=len(cells) + len(model) < len(rows),
            on_diagonal=(pivots, rows[pivots]),
        )


@dataclass(frozen=True, eq=False)
class Entries:
    """Places of the nonzero second derivatives of a cost with respect to (cells; readings).

    The cells and the readings are `count` unknowns each.

    Attributes
    ----------
    cells, model : array of int
        Numbers of the nonzeros between cells, and between readings.
    at_cells : pair of arrays
        Rows and columns of the nonzeros between cells.
    at_model : array, or None
        Readings of the nonzeros between readings if all are on the diagonal.
    crossed : bool
        Whether there are nonzeros between cells and readings.
    on_diagonal : pair of arrays
        Numbers and places of the nonzeros on the diagonal.
    """

    cells: Numbers
    at_cells: tuple[Numbers, Numbers]
    model: Numbers
    at_model: Numbers | None
    crossed: bool
    on_diagonal: tuple[Numbers, Numbers]


@dataclass(frozen=True, eq=False)
class Summand:
    """Summand weight·loss(residual) of a term in one frame.

    Attributes
    ----------
    term : int
        Number of the term.
    loss : Loss
    residual : casadi.SX, shape (rows, 1)
    weight : casadi.SX, shape (1, 1)
    """

    term: int
    loss: Loss
    residual: casadi.SX
    weight: casadi.SX

    @property
    def cost(self) -> Any:
        """Value of the summand. Raises InputError if a loss does not sum over its residuals."""
        cost = self.loss.cost(self.residual)
        if cost.shape != (1, 1):
            name = type(self.loss).__name__
            shape = "×".join(map(str, cost.shape))
            raise InputError(
                f"loss {name}: cost gives {shape} numbers; "
                "it must give one, the sum over all residuals"
            )
        return self.weight * cost

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return int(self.residual.shape[0])

    @property
    def smooth(self) -> bool:
        """Whether the summand enters derivatives directly, not through duals."""
        return self.loss.enters != "dual"


def summands(
    terms: Sequence[Term], pairs: Iterable[tuple[int, casadi.SX]], weights: casadi.SX
) -> list[Summand]:
    """Return the summands of (number of the term, residual) pairs, in their order.

    The weights are (terms, 1).
    """
    return [
        Summand(number, terms[number].loss, residual, weights[number]) for number, residual in pairs
    ]


def stacked(parts: Sequence[Summand]) -> tuple[casadi.SX, casadi.SX]:
    """Return the residuals and weights of all summands as columns.

    Returns
    -------
    residuals, weights : casadi.SX, shape (rows, 1)
        Rows of all summands in their order, and the weight of each row.
    """
    empty = casadi.SX(0, 1)
    weights = (casadi.repmat(part.weight, part.rows, 1) for part in parts)
    residuals = (part.residual for part in parts)
    return casadi.vertcat(empty, *residuals), casadi.vertcat(empty, *weights)


def program_groups(parts: Sequence[Summand]) -> list[list[Summand]]:
    """Return the groups of summands that a program lowers together.

    A summand whose loss enters 'whole' or 'split' is a group of its own; all summands with duals
    form one group.
    """
    smooth, dual, split = (
        [part for part in parts if part.loss.enters == how] for how in ("whole", "dual", "split")
    )
    return [*([part] for part in smooth), *([dual] if dual else []), *([part] for part in split)]


def lowered(group: Sequence[Summand], unit: casadi.SX) -> Lowered:
    """Return a group in the form of `Loss.lowered`, with `unit` as the unit of p and q."""
    first = group[0]
    residual, weight = (first.residual, first.weight) if first.smooth else stacked(group)
    return first.loss.lowered(residual, weight, unit)


@guarded
@lru_cache(maxsize=128)
def _functions(cost: Cost) -> CostFunctions:
    """Differentiate the terms symbolically, and compile the sparse results."""
    symbols = cost.symbols()
    weights = casadi.SX.sym("weights", len(cost.terms))
    parts = summands(cost.terms, cost.residuals(symbols), weights)
    # Σ weight·loss of each term, and the function to differentiate: Σ smooth + Σ weight·z·x
    costs = [
        sum((part.cost for part in parts if part.term == n), casadi.SX(0))
        for n in range(len(cost.terms))
    ]
    through_duals = [part for part in parts if not part.smooth]
    nonsmooth, slope = stacked(through_duals)
    dual = casadi.SX.sym("dual", nonsmooth.shape[0])
    smooth = sum((part.cost for part in parts if part.smooth), casadi.SX(0))
    lagrangian = smooth + casadi.dot(slope * dual, nonsmooth)
    unknown = symbols.unknown
    gradient = casadi.gradient(lagrangian, unknown)
    by_term = casadi.vertcat(*costs)
    # Costs of the terms at readings of zero, a part of the scale of the cost.
    blank = casadi.substitute(by_term, symbols.reading, casadi.SX.zeros(*symbols.reading.shape))
    outputs = {
        "first": casadi.densify(casadi.vertcat(by_term, blank, gradient)),
        "hessian": casadi.jacobian(gradient, unknown, {"symmetric": True}),
        "nonsmooth": casadi.densify(nonsmooth),
        "nonsmooth_jacobian": casadi.jacobian(nonsmooth, unknown),
    }
    compiled = {
        name: symbols.compiled(name, output, weights=weights, dual=dual)
        for name, output in outputs.items()
    }
    terms = [np.full(part.rows, part.term) for part in through_duals]
    return CostFunctions(**compiled, nonsmooth_terms=np.concatenate([np.zeros(0, int), *terms]))
