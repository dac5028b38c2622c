"""The data of a solve, the cost and the terms' residuals at a point with derivatives, and the test of optimality."""

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

ROUNDING = 1e-15  # of what a residual would be off by were every digit wrong: some four last bits of each


@dataclass(frozen=True, eq=False)
class Data:
    """What one solve is given.

    given : readings, noise, earlier frames. lower, upper : (frames, rows, columns) ohm. readout, wiring : how readings
    follow from cells. noise_known : whether σ is. until : s on the clock of `time.monotonic`, when a solver gives up.
    first : whether no frame before was solved. parts : see `Scene.parts`.

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
        """The same with so many s from now on to solve it, or without end."""
        return self if seconds is None else replace(self, until=monotonic() + seconds)

    @property
    def overdue(self) -> bool:
        """Whether it is time to give up."""
        return self.until < math.inf and monotonic() > self.until

    @property
    def measured(self) -> Array:
        """(frames, rows, columns) the network's readings."""
        return np.asarray(self.given.measured)

    @property
    def sigma(self) -> Array:
        """Their standard deviation; ones where unknown."""
        return np.asarray(self.given.sigma)

    @property
    def plain(self) -> NDArray[np.bool_]:
        """(frames, rows, columns) whether a reading is a value: no bound, not nothing, no stand-in."""
        whole = np.ones(self.measured.shape, dtype=bool)
        return np.asarray(whole & (self.given.side == 0) & (self.given.seen == 1)) if self.partial else whole

    @property
    def deviation(self) -> Array:
        """σ, and σ/seen of what stands in for a reading; that of a reading without any weight does not matter."""
        return self.sigma if not self.partial else self.sigma / np.where(self.given.seen > 0, self.given.seen, 1.0)

    @property
    def bounded(self) -> bool:
        """Whether any reading is one-sided."""
        return self.partial and bool(np.any(self.given.side != 0))

    @property
    def partial(self) -> bool:
        """Whether readings may be bounds or say nothing."""
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
        return np.log(self.lower), np.log(self.upper)

    @cached_property
    def ties(self) -> Array:
        """(frames, rows + columns) siemens: each frame's ties to ground."""
        return np.stack([self.readout.ties_of_parts(measured, self.parts) for measured in self.measured])

    def network(self, frame: int, cell_resistance: Array) -> Network:
        """The solved network of one frame's cells (rows, columns) ohm."""
        return self.readout.network(cell_resistance, self.ties[frame], self.wiring)

    def networks(self, cell_resistance: Array) -> tuple[Network, ...]:
        """Those of all frames."""
        return tuple(self.network(frame, cells) for frame, cells in enumerate(cell_resistance))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """φ and its derivatives at one point: cell resistance in ohm and the readings, (frames, rows, columns).

    solved : the networks of the frames, or None where nobody needed them yet.
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
        """The same cost and data at other cells, evaluated in the same way."""
        return Evaluation.at(self.cost, self.data, cell_resistance)

    @cached_property
    def networks(self) -> tuple[Network, ...]:
        """The solved network of every frame."""
        return self.data.networks(self.cell_resistance) if self.solved is None else self.solved

    def call(self, function: Compiled, dual: Array) -> Array:
        """One of the cost's functions at this point."""
        here = {
            "cell_resistance": self.cell_resistance.ravel(),
            "reading": self.reading.ravel(),
            "weights": self.cost.weights,
            "dual": dual,
        }
        given = self.data.given.flat
        return function(*[here[name] if name in here else given[name] for name in function.names])

    def of_terms(self, function: Compiled) -> Array:
        """A function of the terms' residuals at this point, which knows no duals."""
        return self.call(function, np.zeros(len(self.cost.slope)))

    @cached_property
    def first(self) -> Array:
        """The costs of the terms, here and at f(r) = 0, and their derivatives without duals."""
        return self.of_terms(self.cost.functions.first)

    @property
    def costs(self) -> Array:
        """weight · loss of each term, summed over frames, in the order of the terms."""
        return self.first[: len(self.cost.terms)]

    @cached_property
    def objective(self) -> float:
        """φ."""
        return float(self.costs.sum())

    def partials(self, dual: Array) -> tuple[Array, Array]:
        """(∂φ/∂r at fixed readings y, ∂φ/∂y), each (frames, rows, columns)."""
        values = self.call(self.cost.functions.first, dual) if len(dual) else self.first
        direct, through = values[2 * len(self.cost.terms) :].reshape(2, *self.cell_resistance.shape)
        return direct, through

    def log_gradient(self, dual: Array) -> Array:
        """∂φ/∂u, u = log r, (frames, rows, columns): r·∂φ/∂r + Jᵀ ∂φ/∂y, in product form; duals held to |z| ≤ 1."""
        direct, through = self.partials(within_one(dual))
        gradient: Array = direct * self.cell_resistance
        for frame, network in enumerate(self.networks):
            gradient[frame] += network.adjoint(through[frame])
        return gradient

    @cached_property
    def cost_scale(self) -> float:
        """φ with the terms at f(r) = 0 for one cell, plus φ here: the size against which a gradient is small."""
        blank = self.first[len(self.cost.terms) : 2 * len(self.cost.terms)]
        return (float(blank.sum()) / self.cell_resistance.size + self.objective) or 1.0

    @cached_property
    def nonsmooth(self) -> Array:
        """Residuals x with an absolute loss."""
        return self.of_terms(self.cost.functions.nonsmooth) if len(self.cost.slope) else np.zeros(0)

    @cached_property
    def nonsmooth_reach(self) -> Array:
        """Σ |∂x/∂r|·r + Σ |∂x/∂y|·|y| of those residuals: what they would be off by were every digit wrong."""
        rows, columns = self.cost.functions.nonsmooth_jacobian.pattern
        slopes = self.of_terms(self.cost.functions.nonsmooth_jacobian)
        at = np.concatenate([self.cell_resistance.ravel(), self.reading.ravel()])
        return np.asarray(np.bincount(rows, np.abs(slopes * at[columns]), len(self.nonsmooth)), dtype=float)

    @property
    def last_bits(self) -> Array:
        """What residuals with an absolute loss that are zero may hold."""
        return ROUNDING * self.nonsmooth_reach

    @property
    def rounding(self) -> float:
        """What φ may be off by where residuals that are zero hold their last bits, times their weight."""
        return float(np.sum(self.cost.slope * self.last_bits)) if len(self.cost.slope) else 0.0

    def dual_gap(self, dual: Array) -> float:
        """Σ weight·(|x| − z·x) of the absolute losses: zero where z is a subgradient; rounding of x counts for none."""
        left = np.abs(self.nonsmooth) - dual * self.nonsmooth - self.last_bits
        return float(np.sum(self.cost.slope * np.maximum(left, 0.0)))

    def kkt_residual(self, dual: Array, log_gradient: Array | None = None) -> float:
        """max |u − Π(u − ∇φ/s)| over u = log r, Π onto the bounds, s = `cost_scale`; with the dual gap φ/s added.

        Zero where the first-order optimality conditions hold. log_gradient : for these duals, where it is known.
        """
        gap = self.dual_gap(within_one(dual)) / self.cost_scale if len(dual) else 0.0
        return self.projected_gradient(self.log_gradient(dual) if log_gradient is None else log_gradient) + gap

    def projected_gradient(self, log_gradient: Array) -> float:
        """max |u − Π(u − ∇φ/s)| for a gradient that is known already."""
        lower, upper = self.data.log_bounds
        target = np.minimum(np.maximum(self.position - log_gradient / self.cost_scale, lower), upper)
        return float(np.abs(self.position - target).max())

    @cached_property
    def position(self) -> Array:
        """u = log r, (frames, rows, columns)."""
        return np.log(self.cell_resistance)


def within_one(dual: Array) -> Array:
    """The duals of absolute losses, held to |z| ≤ 1."""
    return np.clip(dual, -1, 1) if len(dual) else dual


@dataclass(frozen=True, eq=False)
class Part:
    """Some rows of the residuals x, unweighted: functions of what `Evaluation` holds.

    value : x. by_cells, by_model, by_previous, by_baseline : ∂x/∂ cells, readings, previous and baseline, sparse.
    term : the number of the term that every row belongs to.
    """

    value: Compiled
    by_cells: Compiled
    by_model: Compiled
    by_previous: Compiled
    by_baseline: Compiled
    term: NDArray[np.intp]

    def values(self, at: Evaluation) -> Array:
        """x at a point."""
        return at.of_terms(self.value)

    def jacobian(self, name: str, at: Evaluation) -> sparse.csc_array:
        """One of the derivatives at a point, (rows, unknowns) sparse."""
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
    """data : the rows that read readings. penalties : all others."""

    data: Part
    penalties: Part


def residuals(cost: Cost) -> Residuals:
    """The residuals of a cost, compiled once for all weights."""
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
