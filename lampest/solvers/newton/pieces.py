"""Absolute and Huber's losses with their kinks and corners as they are: minima of convex pieces, each within reach.

At a point u every residual x with such a loss is taken as x + A s, all others as their squares, and min gᵀs + ½ sᵀBs
+ Σ ρ(x + A s) over bounds and |s| ≤ Δ is the next step where the cost falls as that promises. Kinks that are rounded,
of readings and of penalties at once, leave no step that lowers the cost by more than their rounding; between corners
that stand close Newton's method gropes.
Source: Fletcher, Practical Methods of Optimization, 1987, section 14.4 (Sl₁QP, with its second-order correction).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.losses import Huber, Loss
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.solvers.certificate import Bend, free_cells
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.downhill import STILL, downhill, settled, stepped
from lampest.solvers.newton.exactly import exactly
from lampest.solvers.newton.kinks import Kinks, Straight, standing
from lampest.solvers.newton.quadratic import ConvexPiece
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.newton.squares import ORTHOGONAL_UNKNOWNS, pulls, sloped
from lampest.solvers.newton.steps import Iterate

MOST_ROUNDS = 60
FIRST, LONGEST, SHORTEST = 1.0, 2.5, 1e-9  # of log r: Δ at first, at most, and where no step is left
TRUSTED, FAITHFUL = 0.01, 0.7  # of what a step promises: it is taken, and the next may be twice as long
CLOSE = 0.1  # of log r: after so short a step the rows at their kink are known


def has_pieces(cost: Cost, unknowns: int) -> bool:
    """Whether a cost has kinks or corners, and so few cells that pieces are solved in a second."""
    return unknowns <= ORTHOGONAL_UNKNOWNS and any(_in_pieces(term.loss) for term in cost.terms)


def _in_pieces(loss: Loss) -> bool:
    return isinstance(loss, Huber) or loss.enters == "dual"


def by_pieces(point: Iterate, data: Data) -> tuple[Iterate, bool, int]:
    """(where this ends, whether at a minimum with its duals and certificate, pieces that were solved)."""
    at, reach, count = point.at, FIRST, 0
    while count < MOST_ROUNDS and not data.overdue:
        count += 1
        tried = _Local.of(at, data).tried(reach)
        at, reach = tried.at or at, tried.reach
        still = tried.promised <= STILL * at.cost_scale or reach < SHORTEST
        if not still and (tried.at is None or tried.length > CLOSE):
            continue
        if not len(at.rough):
            break
        dual = _Local.of(at, data).tried(FIRST).dual if still else tried.dual
        near = Iterate(Curvature(at, Straight(0.0, dual)), at.objective, 0.0)
        if (ended := exactly(near, data)) is not None:
            return ended, True, count
        lower = _lower(near) if still else at
        if lower is None:
            return near, True, count
        at, reach = lower, FIRST if still else reach
    return _rounded(at), False, count


def _rounded(at: Evaluation) -> Iterate:
    smoothing = Smoothing.start(at)
    return Iterate(Curvature(at, smoothing), smoothing.objective(at), 0.0)


def _lower(near: Iterate) -> Evaluation | None:
    """Where the cost is lower, along the move that keeps kinks and bends it down most; None where it is nowhere."""
    at, gradient = near.at, near.curvature.gradient
    if near.certificate.bend is not Bend.DOWN:
        return None
    free = np.flatnonzero(free_cells(at, gradient))
    kinks = Kinks.of(near.curvature, standing(at, near.curvature.smoothing.dual), free)
    matrix, _ = kinks.reduced(near.curvature.matrix[np.ix_(free, free)], gradient[free])
    along = np.zeros(len(gradient))
    along[free] = kinks.along @ np.linalg.eigh(matrix)[1][:, 0]
    return downhill(at, along)


@dataclass(frozen=True, eq=False)
class _Tried:
    """at : where a step led, None where the cost did not fall as promised. reach : of the next one."""

    at: Evaluation | None
    dual: Array
    length: float
    promised: float
    reach: float


@dataclass(frozen=True, eq=False)
class _Local:
    """The pieces at a point, over the cells that have room. term : of each of its rows."""

    at: Evaluation
    moving: NDArray[np.intp]
    piece: ConvexPiece
    term: NDArray[np.intp]

    @classmethod
    def of(cls, at: Evaluation, data: Data) -> "_Local":
        moving = np.flatnonzero((data.lower < data.upper).ravel())
        low, high = (bound.ravel()[moving] - at.position.ravel()[moving] for bound in data.log_bounds)
        curvature = Curvature(at, Straight(0.0, np.zeros(len(at.rough))))
        gradient, squares = np.zeros(len(moving)), np.zeros((len(moving), len(moving)))
        kinked = np.array([_in_pieces(term.loss) for term in at.cost.terms])
        corner = np.array([term.loss.corner if isinstance(term.loss, Huber) else 0.0 for term in at.cost.terms])
        weight = at.cost.weights * np.where(corner > 0, 2 * corner, 1.0)
        values, slopes, terms = [], [], []
        for part, value, slope in sloped(at, moving):
            pull, bend = pulls(curvature, part, value)
            whole, own = ~kinked[part.term], np.flatnonzero(kinked[part.term])
            gradient += slope[whole].T @ pull[whole]
            squares += slope[whole].T @ (bend[whole, None] * slope[whole])
            values.append(weight[part.term[own]] * value[own])
            slopes.append(weight[part.term[own], None] * slope[own])
            terms.append(part.term[own])
        term = np.concatenate(terms)
        rows = (np.concatenate(values), np.concatenate(slopes), (weight * corner)[term])
        return cls(at, moving, ConvexPiece(gradient, squares, *rows, low, high), term)

    def tried(self, reach: float) -> _Tried:
        """One step of at most `reach`; where the residuals bend too much for it, with what they bent taken off."""
        piece = self._within(reach, self.piece.residual)
        step, dual = piece.least()
        promised, length = piece.value(0 * step) - piece.value(step), float(np.abs(step).max(initial=0.0))
        there = self._at(step)
        if there is not None and not self._falls(there, promised):
            residual = _Local.of(there, there.data).piece.residual - piece.slopes @ step
            second, dual = self._within(reach, residual).least()
            there = self._at(second)
        if there is None or not self._falls(there, promised):
            return _Tried(None, self._rough(dual), length, promised, min(reach, length) / 4)
        share = (settled(self.at) - settled(there)) / promised
        wider = share > FAITHFUL and length > reach / 2
        reach = min(LONGEST, 2 * reach) if wider else reach if share > 1 - FAITHFUL else reach / 2
        return _Tried(there, self._rough(dual), length, promised, reach)

    def _falls(self, there: Evaluation, promised: float) -> bool:
        return promised > 0 and settled(self.at) - settled(there) >= TRUSTED * promised

    def _within(self, reach: float, residual: Array) -> ConvexPiece:
        low, high = np.maximum(self.piece.low, -reach), np.minimum(self.piece.high, reach)
        return replace(self.piece, residual=residual, low=low, high=high)

    def _at(self, step: Array) -> Evaluation | None:
        whole = np.zeros(self.at.position.size)
        whole[self.moving] = step
        return stepped(self.at, whole)

    def _rough(self, dual: Array) -> Array:
        """The duals of absolute losses alone, in the cost's order."""
        of_terms = self.at.cost.functions.rough_terms
        found = np.zeros(len(of_terms))
        for number in set(of_terms):
            found[of_terms == number] = dual[self.term == number]
        return found
