"""A frame that follows another one, solved in one call of machine code where nothing is unusual."""

import time
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.compiled import evaluation_address
from lampest.panel.conjugate import DENSE_UNKNOWNS
from lampest.panel.panel import Array
from lampest.solvers.certificate import MILLIONTH, NEARBY, SHARE, Bend, Certificate
from lampest.solvers.kernel.pursuing import LARGER_UNKNOWNS, NO_PRECONDITIONER, pursued
from lampest.solvers.newton.directions import FOLLOWED, Factor
from lampest.solvers.newton.newton import Newton
from lampest.solvers.newton.softest import SOFT
from lampest.solvers.newton.steps import DECREASE, EQUAL, HALVED
from lampest.solvers.newton.ways import LONGEST_STEP
from lampest.solvers.solution import Outcome, Solution, Status, check

if TYPE_CHECKING:
    from lampest.solvers.kernel.arena import Arena

NOTHING = np.zeros(0)
NO_FACTOR = (np.zeros((0, 0)), np.zeros(0, dtype=np.int64), NOTHING)
CONTRACTED = 1e-7  # of its first step by the last one: a direction that bends down would still hold its share of that
CLOCK = getattr(time, "CLOCK_MONOTONIC", 0)  # that of `time.monotonic`
SHORT = 3e-9  # of log r: where the last step is longer, there is one more if that is better
SIMILAR = 0.2  # of log r: so far from where it was taken a factor may say that by what its steps did
SLOWEST = 0.4  # of a step by the next one with the same factor, which costs as much as seven to twelve such steps
FACTORED_UNKNOWNS = 144  # beyond, a frame that makes a factor takes two to three times as long as one that makes none
LIMITS = (
    SLOWEST,
    DECREASE,
    EQUAL,
    HALVED,
    LONGEST_STEP,
    FOLLOWED,
    NEARBY,
    MILLIONTH,
    SHARE,
    SIMILAR,
    CONTRACTED,
    SHORT,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class KeptFactor(Factor):
    """position : u where it was taken."""

    position: Array


@dataclass(frozen=True, eq=False)
class Workbench:
    """A cost and the data of one frame, as machine code takes them."""

    cost: Cost
    data: Data

    @cached_property
    def arena(self) -> "Arena":
        """Functions and memory."""
        from lampest.solvers.kernel.arena import arena

        return arena(self.cost.functions, self.data.readout, *self.data.measured.shape[1:], len(self.cost.terms))

    @cached_property
    def told(self) -> Array:
        """What the terms are given."""
        return self.arena.told(self.cost, self.data)

    @cached_property
    def given(self) -> tuple[NDArray[Any], ...]:
        """What machine code takes first: functions, memory, what the terms are given, entries, ties and bounds of u."""
        arena, bounds = self.arena, np.concatenate(self.data.log_bounds).reshape(2, -1)
        return arena.addresses, arena.where, arena.memory, self.told, arena.entries, self.data.ties, bounds

    @cached_property
    def sigma(self) -> Array:
        """Of the readings, or nothing where it is not known."""
        return self.data.sigma.flatten() if self.data.noise_known else NOTHING  # a copy: what may only be read differs

    def point(self, cell_resistance: Array) -> "MachineEvaluation":
        """The cost at cells (1, rows, columns) ohm."""
        from lampest.panel.machine import result_of
        from lampest.solvers.kernel.points import appraised

        shape, arena = cell_resistance.shape, self.arena
        reading, values, gradient = result_of(
            appraised, arena.addresses, arena.where, arena.memory, self.told, self.data.ties, cell_resistance.ravel()
        )
        reading, gradient = reading.reshape(shape), gradient.reshape(shape)
        return MachineEvaluation(
            self.cost, self.data, cell_resistance, reading, None, values=values, gradient=gradient, bench=self
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class MachineEvaluation(Evaluation):
    """The cost at a point of one frame, from machine code; what that does not say follows as elsewhere.

    values : what the cost's `first` returns. gradient : ∇φ in u, (1, rows, columns). bench : where it was computed.
    """

    values: Array
    gradient: Array
    bench: Workbench

    @property
    def first(self) -> Array:
        """The costs of the terms, and their derivatives."""
        return self.values

    def log_gradient(self, dual: Array) -> Array:
        """∇φ: no loss here has duals."""
        return self.gradient

    def elsewhere(self, cell_resistance: Array) -> "MachineEvaluation":
        """At other cells."""
        return self.bench.point(cell_resistance)


def from_previous(solver: Newton, data: Data, previous: Array) -> Solution | None:
    """The checked optimum near the last estimate (1, rows, columns) ohm; None where machine code finds none.

    Then nothing was decided: steps lower nothing or bend down, or a penalty or a panel is none that it knows.
    """
    if not serves(solver.cost, data):
        return None
    start = Workbench(solver.cost, data).point(np.minimum(np.maximum(previous, data.lower), data.upper))
    found = descended(solver, start.bench, start.position)
    solution = None if found is None else check(start, found)
    return solution if solution is not None and solution.strict else None


def swift(solver: Newton) -> Newton:
    """The same, which tries machine code first."""
    return replace(solver, shortcut=_shortcut)


def _shortcut(solver: Newton, data: Data, start: Evaluation) -> Outcome | None:
    served = serves(solver.cost, data)
    return descended(solver, Workbench(solver.cost, data), start.position) if served else None


def long_way_round(solver: Newton) -> Newton:
    """The same for starts from which it takes many steps, each with a factor of its own where there is one."""
    return solver if solver.shortcut is None else replace(solver, shortcut=_without_factors)


def _without_factors(solver: Newton, data: Data, start: Evaluation) -> Outcome | None:
    if serves(solver.cost, data) and data.measured.size > FACTORED_UNKNOWNS:
        found = pursued(solver, Workbench(solver.cost, data), start.position, _limits(solver, data))
        if found is not None:
            return found
    return _shortcut(solver, data, start)


def _limits(solver: Newton, data: Data) -> Array:
    """What the machine code takes as limits."""
    return np.array([solver.settings.tolerance, *LIMITS, solver.settings.max_iterations, CLOCK, data.until])


def serves(cost: Cost, data: Data) -> bool:
    """Whether there is machine code for a cost: one frame of a panel without wire that is not large, losses that are
    smooth, and terms of which each speaks of cells or of one reading.
    """
    if len(data.measured) > 1 or data.measured.size > LARGER_UNKNOWNS or data.wiring is not None or len(cost.slope):
        return False
    entries = cost.functions.entries
    return entries.at_model is not None and not entries.crossed and evaluation_address() != 0


def without_factor(cost: Cost, data: Data) -> bool:
    """Whether conjugate gradients are quicker than a factor of a frame's own, and nobody else asks for one."""
    return data.measured.size > FACTORED_UNKNOWNS


@cache
def load_machine_code(larger: bool) -> None:
    """Read the machine code from numba's cache, or make it: by frames of one cell that conducts nothing."""
    from lampest.solvers.kernel.applied import preconditioned
    from lampest.solvers.kernel.descent import descend
    from lampest.solvers.kernel.points import appraised
    from lampest.solvers.kernel.pursuit import pursue
    from lampest.solvers.kernel.softness import softest_vector

    addresses, where, arena = np.zeros(12, dtype=np.int64), np.zeros(10, dtype=np.int64), np.zeros(4)
    entries, ties, bounds, open_cell = np.zeros((2, 0), dtype=np.int64), np.zeros((1, 2)), np.zeros((2, 1)), np.zeros(1)
    where[9], bounds[0], bounds[1], open_cell[0] = 1, -np.inf, np.inf, np.inf
    appraised(addresses, where, arena, NOTHING, ties, open_cell)
    limits = np.zeros(4 + len(LIMITS))
    limits[-1] = np.inf
    begun = (addresses, where, arena, NOTHING, entries, ties, bounds, open_cell)
    if larger:
        pursue(*begun, *NO_PRECONDITIONER, 0, 0, limits, NOTHING)
        softest_vector(*begun, *NO_PRECONDITIONER[:3], SOFT)
        preconditioned(addresses, 1, np.zeros((1, 1)), np.zeros((2, 1)), np.zeros((0, 0)), open_cell)
    else:
        descend(*begun, *NO_FACTOR, limits, NOTHING)


def descended(solver: Newton, bench: Workbench, start: Array) -> Outcome | None:
    """What the machine code makes of a frame from u (1, rows, columns) on; None where it fell short."""
    from lampest.panel.machine import result_of
    from lampest.solvers.kernel.descent import descend
    from lampest.solvers.kernel.points import SETTLED

    data, limits = bench.data, _limits(solver, bench.data)
    if without_factor(solver.cost, data):
        found = pursued(solver, bench, start, limits)
        if found is not None or data.measured.size > DENSE_UNKNOWNS:
            return found
    kept = solver.factor if isinstance(solver.factor, KeptFactor) else None
    ending, position, step, decrement, share, factors, upper, cells, place = result_of(
        descend,
        *bench.given,
        start.ravel(),
        *(NO_FACTOR if kept is None else (kept.triangle, kept.cells, kept.position)),
        limits,
        bench.sigma,
    )
    if ending != SETTLED:
        return None
    shape = start.shape
    certificate = Certificate(Bend.UP, step, decrement, share)
    left = kept if kept is not None and not factors else _taken(upper, cells, place, shape)
    if not left.solid:
        return None
    cell_resistance = np.exp(position).reshape(shape)
    return Outcome(cell_resistance, NOTHING, Status.OPTIMUM, factors, certificate, left)


def _taken(upper: Array, cells: NDArray[np.intp], position: Array, shape: tuple[int, ...]) -> KeptFactor:
    """A factor as the machine code leaves it, over some cells."""

    def solve(right: Array) -> Array:
        solution: Array = lapack.dpotrs(upper.T, right, lower=1)[0]
        return solution

    return KeptFactor(cells, np.exp(position).reshape(shape), solve, upper, position=position)
