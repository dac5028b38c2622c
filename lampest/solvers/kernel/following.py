"""A frame that follows another one, solved in one call of machine code where nothing is unusual."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.compiled import evaluation_address
from lampest.panel.conjugate import DENSE_UNKNOWNS, Linear
from lampest.panel.panel import Array
from lampest.solvers.certificate import MILLIONTH, NEARBY, SHARE, Bend, Certificate
from lampest.solvers.newton.directions import FOLLOWED, Factor
from lampest.solvers.newton.newton import Newton
from lampest.solvers.newton.steps import CONTRACTION, DECREASE, EQUAL, HALVED
from lampest.solvers.newton.ways import LONGEST_STEP
from lampest.solvers.solution import Outcome, Solution, Status, check

NOTHING = np.zeros(0)
LIMITS = (CONTRACTION, DECREASE, EQUAL, HALVED, LONGEST_STEP, FOLLOWED, NEARBY, MILLIONTH, SHARE)


@dataclass(frozen=True, eq=False, kw_only=True)
class KeptFactor(Factor):
    """upper : the factor itself, (cells, cells), above the diagonal. position : u where it was taken."""

    upper: Array
    position: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class MachineEvaluation(Evaluation):
    """The cost at a point of one frame, from machine code; what that does not say follows as elsewhere.

    values : what the cost's `first` returns. gradient : ∇φ in u, (1, rows, columns).
    """

    values: Array
    gradient: Array

    @classmethod
    def at(cls, cost: Cost, data: Data, cell_resistance: Array) -> "MachineEvaluation":
        """Of cells (1, rows, columns) ohm."""
        from lampest.solvers.kernel.arena import arena
        from lampest.solvers.kernel.arithmetic import appraised

        known = arena(cost.functions, data.readout, *data.measured.shape[1:], len(cost.terms))
        shape, told = cell_resistance.shape, known.told(cost, data)
        reading, values, gradient = appraised(*known.bound, told, data.ties[0], cell_resistance.ravel())
        gradient = gradient.reshape(shape)
        return cls(cost, data, cell_resistance, reading.reshape(shape), None, values=values, gradient=gradient)

    @property
    def first(self) -> Array:
        """The costs of the terms, and their derivatives."""
        return self.values

    def log_gradient(self, dual: Array) -> Array:
        """∇φ: no loss here has duals."""
        return self.gradient


def from_previous(solver: Newton, data: Data, previous: Array, most_factors: int) -> Solution | None:
    """The checked optimum near the last estimate (1, rows, columns) ohm; None where it takes more than that.

    Then nothing was decided: the frame has several minima nearby, cells that stop at many bounds, a penalty or a panel
    that the machine code does not know. most_factors : of second derivatives.
    """
    if not serves(solver.cost, data):
        return None
    start = MachineEvaluation.at(solver.cost, data, np.clip(previous, data.lower, data.upper))
    found = descended(solver, data, start.position, most_factors)
    solution = None if found is None else check(start, found)
    return solution if solution is not None and solution.status is Status.OPTIMUM else None


def serves(cost: Cost, data: Data) -> bool:
    """Whether there is machine code for a cost: one frame of a small panel without wire, losses that are smooth, and
    terms of which each speaks of cells or of one reading.
    """
    if len(data.measured) > 1 or data.measured.size > DENSE_UNKNOWNS or data.wiring is not None or len(cost.slope):
        return False
    entries = cost.functions.entries
    return entries.at_model is not None and not entries.crossed and evaluation_address() != 0


def descended(solver: Newton, data: Data, start: Array, most_factors: int) -> Outcome | None:
    """What the machine code makes of a frame from u = `start` (1, rows, columns) on; None where it fell short."""
    from lampest.solvers.kernel.arena import arena
    from lampest.solvers.kernel.arithmetic import SETTLED, descend

    cost, (lower, upper) = solver.cost, data.log_bounds
    known = arena(cost.functions, data.readout, *data.measured.shape[1:], len(cost.terms))
    kept = solver.factor if isinstance(solver.factor, KeptFactor) else None
    factor = (np.zeros((0, 0)), np.zeros(0, dtype=np.int64), NOTHING)
    ending, position, step, decrement, share, factors, upper_factor, cells, place = descend(
        *known.bound,
        known.told(cost, data),
        known.entries,
        data.ties[0],
        np.concatenate([lower, upper]).reshape(2, -1),
        start.ravel(),
        *(factor if kept is None else (kept.upper, kept.cells, kept.position)),
        np.array([solver.settings.tolerance, *LIMITS, most_factors]),
        data.sigma.ravel() if data.noise_known else NOTHING,
    )
    if ending != SETTLED:
        return None
    certificate = Certificate(Bend.UP, step, decrement, share)
    left = KeptFactor(
        cells,
        np.exp(place).reshape(start.shape),
        _by_factor(upper_factor),
        upper=upper_factor,
        position=place,
    )
    cell_resistance = np.exp(position).reshape(start.shape)
    return Outcome(cell_resistance, NOTHING, Status.OPTIMUM, factors, certificate, left)


def _by_factor(upper: Array) -> Linear:
    """Solves with a Cholesky factor."""

    def solve(right: Array) -> Array:
        solution: Array = lapack.dpotrs(upper.T, right, lower=1)[0]
        return solution

    return solve
