"""Data of a solve, cost and residuals at a point with derivatives, and the test of optimality."""

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from time import monotonic

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.cost.cost import Cost, Symbols
from lampest.cost.given import Given
from lampest.panel.compiled import Compiled, guarded
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.panel.readouts.wiring import Wiring

ROUNDING = 1e-15  # relative rounding error of a residual: four last bits of double precision


@dataclass(frozen=True, eq=False)
class Data:
    """Data of one solve.

    Attributes
    ----------
    given : Given
        Readings, noise, earlier frames.
    lower, upper : array, shape (frames, rows, columns)
        Bounds in ohm.
    readout, wiring
        Circuit by which readings follow from cells.
    noise_known : bool
        Whether σ is known.
    until : float
        Time at which a solver gives up, in s on the clock of `time.monotonic`.
    first : bool
        Whether no earlier frame was solved.
    parts : array, or None
        See `Scene.parts`.

    >>> data = found.estimator.data(recording.readings()[2], lampest.cost.given.Background(recording.scene))
    """

    given: Given
    lower: Array
    upper: Array
    readout: Readout = TwoPointReadout()
    wiring: Wiring | None = None
    noise_known: bool = False
    until: float = math.inf
    first: bool = False
    parts: NDArray[np.intp] | None = None

    def limited(self, seconds: float | None) -> "Data":
        """Return the data with a time limit of that many s from now on; None: no limit."""
        return self if seconds is None else replace(self, until=monotonic() + seconds)

    @property
    def overdue(self) -> bool:
        """Whether the time limit has passed."""
        return self.until < math.inf and monotonic() > self.until

    @property
    def measured(self) -> Array:
        """(frames, rows, columns) the network's readings."""
        return np.asarray(self.given.measured)

    @property
    def sigma(self) -> Array:
        """Standard deviations of the readings; ones if unknown."""
        return np.asarray(self.given.sigma)

    @property
    def plain(self) -> NDArray[np.bool_]:
        """(frames, rows, columns) whether a reading is a value: neither a bound nor missing nor a substitute."""
        whole = np.ones(self.measured.shape, dtype=bool)
        return np.asarray(whole & (self.given.side == 0) & (self.given.seen == 1)) if self.partial else whole

    @property
    def deviation(self) -> Array:
        """σ of readings, and σ/seen of substitutes; irrelevant for a reading without weight."""
        return self.sigma if not self.partial else self.sigma / np.where(self.given.seen > 0, self.given.seen, 1.0)

    @property
    def bounded(self) -> bool:
        """Whether any reading is one-sided."""
        return self.partial and bool(np.any(self.given.side != 0))

    @property
    def partial(self) -> bool:
        """Whether readings may be bounds or missing."""
        return self.given.side is not None

    @cached_property
    def apparent_resistance(self) -> Array:
        """(frames, rows, columns) ohm; see `Readout.apparent_resistance`."""
        return self.readout.apparent_resistance(self.measured)

    @cached_property
    def uniform_start(self) -> Array:
        """(frames, rows, columns) ohm; see `Readout.uniform_start`."""
        return self.readout.uniform_start(self.measured)

    @cached_property
    def log_bounds(self) -> tuple[Array, Array]:
        """Logarithms of the bounds."""
        return np.log(self.lower), np.log(self.upper)

    @cached_property
    def ties(self) -> Array:
        """(frames, rows + columns) siemens: each frame's ties to ground."""
        return np.stack([self.readout.ties_of_parts(measured, self.parts) for measured in self.measured])

    def network(self, frame: int, cell_resistance: Array) -> Network:
        """Return the solved network of one frame's cells (rows, columns) ohm."""
        return self.readout.network(cell_resistance, self.ties[frame], self.wiring)

    def networks(self, cell_resistance: Array) -> tuple[Network, ...]:
        """Return the solved networks of all frames."""
        return tuple(self.network(frame, cells) for frame, cells in enumerate(cell_resistance))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Cost φ and its derivatives at one point: cell resistance in ohm and the readings, (frames, rows, columns).

    solved : networks of the frames, or None if not yet needed.
    """

    cost: Cost
    data: Data
    cell_resistance: Array
    reading: Array
    solved: tuple[Network, ...] | None

    @classmethod
    def at(cls, cost: Cost, data: Data, cell_resistance: Array) -> "Evaluation":
        """Solve the networks of a cell resistance (frames, rows, columns) ohm."""
        networks = data.networks(cell_resistance)
        return cls(cost, data, cell_resistance, np.stack([network.reading() for network in networks]), networks)

    def elsewhere(self, cell_resistance: Array) -> "Evaluation":
        """Return the evaluation of the same cost and data at other cells."""
        return Evaluation.at(self.cost, self.data, cell_resistance)

    @cached_property
    def networks(self) -> tuple[Network, ...]:
        """The solved network of every frame."""
        return self.data.networks(self.cell_resistance) if self.solved is None else self.solved

    def call(self, function: Compiled, dual: Array) -> Array:
        """Return a function of the cost at this point."""
        point = {
            "cell_resistance": self.cell_resistance.ravel(),
            "reading": self.reading.ravel(),
            "weights": self.cost.weights,
            "dual": dual,
        }
        given = self.data.given.flat
        return function(*[point[name] if name in point else given[name] for name in function.names])

    def of_terms(self, function: Compiled) -> Array:
        """Return a function of the terms' residuals at this point, which takes no duals."""
        return self.call(function, np.zeros(len(self.cost.slope)))

    @cached_property
    def first(self) -> Array:
        """Costs of the terms, at this point and at f(r) = 0, and their derivatives without duals."""
        return self.of_terms(self.cost.functions.first)

    @property
    def costs(self) -> Array:
        """Costs weight · loss of the terms, summed over frames, in the order of the terms."""
        return self.first[: len(self.cost.terms)]

    @cached_property
    def objective(self) -> float:
        """φ."""
        return float(self.costs.sum())

    def partials(self, dual: Array) -> tuple[Array, Array]:
        """Return (∂φ/∂r at fixed readings y, ∂φ/∂y), each (frames, rows, columns)."""
        values = self.call(self.cost.functions.first, dual) if len(dual) else self.first
        direct, through = values[2 * len(self.cost.terms) :].reshape(2, *self.cell_resistance.shape)
        return direct, through

    def log_gradient(self, dual: Array) -> Array:
        """Return ∂φ/∂u, u = log r, (frames, rows, columns): r·∂φ/∂r + Jᵀ ∂φ/∂y; duals clipped to |z| ≤ 1."""
        direct, through = self.partials(within_one(dual))
        gradient: Array = direct * self.cell_resistance
        for frame, network in enumerate(self.networks):
            gradient[frame] += network.adjoint(through[frame])
        return gradient

    @cached_property
    def cost_scale(self) -> float:
        """Scale against which a gradient is small: φ with the terms at f(r) = 0 for one cell, plus φ at this point."""
        blank = self.first[len(self.cost.terms) : 2 * len(self.cost.terms)]
        return (float(blank.sum()) / self.cell_resistance.size + self.objective) or 1.0

    @cached_property
    def nonsmooth(self) -> Array:
        """Residuals x with an absolute loss."""
        return self.of_terms(self.cost.functions.nonsmooth) if len(self.cost.slope) else np.zeros(0)

    @cached_property
    def nonsmooth_reach(self) -> Array:
        """Σ |∂x/∂r|·r + Σ |∂x/∂y|·|y| of those residuals: their error if every digit were wrong."""
        rows, columns = self.cost.functions.nonsmooth_jacobian.pattern
        slopes = self.of_terms(self.cost.functions.nonsmooth_jacobian)
        at = np.concatenate([self.cell_resistance.ravel(), self.reading.ravel()])
        return np.asarray(np.bincount(rows, np.abs(slopes * at[columns]), len(self.nonsmooth)), dtype=float)

    @property
    def last_bits(self) -> Array:
        """Rounding errors of residuals with an absolute loss that are zero."""
        return ROUNDING * self.nonsmooth_reach

    @property
    def rounding(self) -> float:
        """Rounding error of φ: that of residuals that are zero, times their weight."""
        return float(np.sum(self.cost.slope * self.last_bits)) if len(self.cost.slope) else 0.0

    def dual_gap(self, dual: Array) -> float:
        """Return Σ weight·(|x| − z·x) of the absolute losses, zero if z is a subgradient; rounding of x is ignored."""
        gap = np.abs(self.nonsmooth) - dual * self.nonsmooth - self.last_bits
        return float(np.sum(self.cost.slope * np.maximum(gap, 0.0)))

    def kkt_residual(self, dual: Array, log_gradient: Array | None = None) -> float:
        """Return max |u − Π(u − ∇φ/s)| plus the dual gap φ/s; u = log r, Π onto the bounds, s = `cost_scale`.

        Zero where the first-order optimality conditions hold. log_gradient : gradient for these duals, if it is known.
        """
        gap = self.dual_gap(within_one(dual)) / self.cost_scale if len(dual) else 0.0
        return self.projected_gradient(self.log_gradient(dual) if log_gradient is None else log_gradient) + gap

    def projected_gradient(self, log_gradient: Array) -> float:
        """Return max |u − Π(u − ∇φ/s)| of a known gradient."""
        lower, upper = self.data.log_bounds
        target = np.minimum(np.maximum(self.position - log_gradient / self.cost_scale, lower), upper)
        return float(np.abs(self.position - target).max())

    @cached_property
    def position(self) -> Array:
        """Position u = log r, (frames, rows, columns)."""
        return np.log(self.cell_resistance)


def within_one(dual: Array) -> Array:
    """Return the duals of absolute losses, clipped to |z| ≤ 1."""
    return np.clip(dual, -1, 1) if len(dual) else dual


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of the unweighted residuals x, as functions of the inputs of `Evaluation`.

    Attributes
    ----------
    value : Compiled
        x.
    by_cells, by_model, by_previous, by_baseline : Compiled
        ∂x/∂(cells, readings, previous frame, baseline), sparse.
    term : array of int
        Number of the term of each row.
    """

    value: Compiled
    by_cells: Compiled
    by_model: Compiled
    by_previous: Compiled
    by_baseline: Compiled
    term: NDArray[np.intp]

    def values(self, at: Evaluation) -> Array:
        """Return x at a point."""
        return at.of_terms(self.value)

    def jacobian(self, name: str, at: Evaluation) -> sparse.csc_array:
        """Return one of the derivatives at a point, (rows, unknowns) sparse."""
        structure = self._structures[name]
        if not structure.nnz:
            return structure
        values = at.of_terms(getattr(self, name))
        return sparse.csc_array((values, structure.indices, structure.indptr), shape=structure.shape)

    @cached_property
    def _structures(self) -> dict[str, sparse.csc_array]:
        names = ("by_cells", "by_model", "by_previous", "by_baseline")
        functions: dict[str, Compiled] = {name: getattr(self, name) for name in names}
        return {
            name: sparse.csc_array((np.ones(len(part.by_columns[0])), *part.by_columns), shape=part.shape)
            for name, part in functions.items()
        }


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of a cost: the rows that read readings, `data`, and all others, `penalties`."""

    data: Part
    penalties: Part


def residuals(cost: Cost) -> Residuals:
    """Return the residuals of a cost, compiled once for all weights."""
    return _residuals(cost.unweighted)


@guarded
@lru_cache(maxsize=64)
def _residuals(cost: Cost) -> Residuals:
    symbols = cost.symbols()
    pairs = cost.residuals(symbols)
    stacked = casadi.vertcat(*(part for _, part in pairs))
    term = np.concatenate([np.full(part.shape[0], number, dtype=np.intp) for number, part in pairs])
    reads = set(casadi.jacobian_sparsity(stacked, symbols.inputs()["reading"]).row())
    rows = ([row for row in range(len(term)) if (row in reads) is data] for data in (True, False))
    return Residuals(*(_part(symbols, stacked[chosen], term[chosen]) for chosen in rows))


def _part(symbols: Symbols, rows: casadi.SX, term: NDArray[np.intp]) -> Part:
    inputs = symbols.inputs()
    outputs = {
        "value": casadi.densify(rows),
        "by_cells": casadi.jacobian(rows, inputs["cell_resistance"]),
        "by_model": casadi.jacobian(rows, inputs["reading"]),
        "by_previous": casadi.jacobian(rows, inputs["previous"]),
        "by_baseline": casadi.jacobian(rows, inputs["baseline"]),
    }
    return Part(**{name: symbols.compiled(name, output) for name, output in outputs.items()}, term=term)
