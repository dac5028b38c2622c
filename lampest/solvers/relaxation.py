"""Starts for costs whose losses are not convex.

Readings that are far off at a start have hardly any pull under such a loss, so that steps from
there end where they are outliers. The relaxed cost has Huber's loss instead, with a corner where
the loss still is a square: it is convex, and single wrong readings hardly move its minimum. The
solver that minimises the cost minimises the relaxed one first, and begins at its minimum.

Minima differ in the readings that are outliers there. From the lowest one an outlier enters, or a
reading with large leverage leaves, and the solver begins there. The search begins again at every
lower minimum, and ends where no exchange lowers the cost. Losses that shrink from squares end
higher, and so do starts at random (docs/studies/minima.md).
Source: Yohai, Ann. Statist. 15, 1987 (a robust convex start for a redescending loss).
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, reduce

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.losses import Huber, Loss
from lampest.cost.problem import NO_DUAL, Evaluation, residuals
from lampest.files.errors import BROKEN
from lampest.panel.panel import Array
from lampest.solvers.check import sharp_hessian
from lampest.solvers.preconditioners import preconditioner
from lampest.solvers.solution import Solution, Solver, lower_of

CORNER = 0.1  # of the residual at which the loss ceases to be convex
FAR_OUT = 2.0  # times the range in which a loss is convex: residuals of outliers are beyond
LARGEST_STEP = 2.0  # of log r: change of a cell where a reading is exchanged
# Residuals among which the end of convexity is searched for, in any unit.
RESIDUALS = np.geomspace(1e-12, 1e12, 4801)


def relaxed(cost: Cost) -> Cost:
    """Return the cost with Huber's loss in place of losses that are not convex."""
    terms = []
    for term in cost.terms:
        if not term.loss.convex:
            corner, curvature = huber_of(term.loss)
            term = replace(term, loss=Huber(corner=corner), weight=curvature * float(term.weight))
        terms.append(term)
    return replace(cost, terms=tuple(terms))


def huber_of(loss: Loss) -> tuple[float, float]:
    """Return the corner and the factor of the Huber loss that replaces a loss.

    Returns
    -------
    corner : float
        CORNER of the range of residuals in which the loss is convex.
    factor : float
        Curvature ½ρ''(0) of the loss.
    """
    return CORNER * convex_range(loss), float(loss.curvature(np.zeros(1))[0])


@lru_cache(maxsize=64)
def convex_range(loss: Loss) -> float:
    """Return the residual up to which a loss is convex; infinity if it is convex everywhere."""
    if loss.convex:
        return np.inf
    convex = loss.curvature(RESIDUALS) > 0
    return float(RESIDUALS[-1] if convex.all() else RESIDUALS[int(np.argmin(convex))])


def searched_starts(solver: Solver, start: Evaluation, ends: Sequence[Solution]) -> Iterator[Array]:
    """Yield starts of a cost with losses that are not convex, (frames, rows, columns) ohm.

    The first is the minimum of the relaxed cost, unless that breaks down. Those at which a reading
    is exchanged follow.

    Parameters
    ----------
    solver : Solver
    start : Evaluation
        First start of the frame.
    ends : sequence of Solution
        Solutions from all starts so far; the caller appends to it.
    """
    cost = relaxed(solver.cost)
    with suppress(*BROKEN):
        begin = Evaluation.at(cost, start.data, start.cell_resistance)
        yield replace(solver, cost=cost).solve(start.data, begin).cell_resistance
    yield from exchanging_starts(ends)


def exchanging_starts(ends: Sequence[Solution]) -> Iterator[Array]:
    """Yield starts at which one reading is exchanged, until none leads to a lower minimum."""
    lowest = None
    while (best := reduce(lower_of, ends, None)) is not lowest and best is not None:
        lowest = best
        possible = list[tuple[float, Array]]()
        with suppress(*BROKEN):
            possible = exchanges(best)
        for _, step in possible:
            yield best.cell_resistance * np.exp(step)
            if reduce(lower_of, ends, None) is not lowest:
                break


def exchanges(minimum: Solution) -> list[tuple[float, Array]]:
    """Return the exchanges of one reading at a minimum, largest gain first.

    An exchange changes whether a reading is an outlier. It is a pair of the decrease of the cost in
    the quadratic model, and a step of u = log r of at most LARGEST_STEP, (frames, rows, columns).
    There are none where the solution is no minimum.

    With the gradient a = ∂x/∂u of a residual x, its loss ρ and weight w, its second derivative
    k = wρ'', the Hessian M of the cost, and the leverage h = k aᵀM⁻¹a:

    - An outlier enters by −x M⁻¹a/(aᵀM⁻¹a), the least costly step to x = 0. The gain is
      wρ(x) − ½x²/(aᵀM⁻¹a).
    - A reading whose x/√(1 − h) is that of an outlier leaves by k x M⁻¹a/(1 − h), the step to the
      minimum without it, where its residual is x/(1 − h). The gain is
      wρ(x) − wρ(x/(1 − h)) + ½k x² h/(1 − h). Panels too large for a matrix leave these out.

    Source: Cook & Weisberg, Residuals and Influence in Regression, 1982, chapter 2.
    """
    at = minimum.at
    if at is None:
        return []
    hessian = sharp_hessian(at, NO_DUAL if minimum.dual is None else minimum.dual)
    inverse = preconditioner(hessian, hessian.free).over(hessian.free, at.cell_resistance)
    part = residuals(at.cost).data
    values = part.values(at)
    by_reading = part.jacobian("reading", at).tocsr()
    possible = []
    for number, term in enumerate(at.cost.terms):
        loss = term.loss
        weight = float(at.weights[number])
        limit = FAR_OUT * convex_range(loss)
        for row in np.flatnonzero((part.term == number) & (limit < np.inf)).tolist():
            x = float(values[row])
            enters = abs(x) > limit
            if not (enters or hessian.dense):
                continue
            gradient = hessian.adjoint(by_reading[[row]].toarray().reshape(at.reading.shape))
            response = np.zeros_like(gradient)
            response[hessian.free] = inverse(gradient[hessian.free])
            size = max(float(gradient @ response), np.finfo(float).tiny)
            gain = weight * _cost(loss, x)
            if enters:
                factor = -x / size
                gain -= x**2 / (2 * size)
            else:
                k = 2 * weight * loss.curvature(np.array([x]))[0]
                remaining = 1 - k * size
                if remaining <= 0 or abs(x) <= limit * np.sqrt(remaining):
                    continue
                factor = k * x / remaining
                gain += k * x**2 * k * size / (2 * remaining) - weight * _cost(loss, x / remaining)
            step = factor * response
            step *= min(1.0, LARGEST_STEP / np.abs(step).max(initial=LARGEST_STEP))
            possible.append((gain, step.reshape(at.position.shape)))
    return sorted(possible, key=lambda exchange: -exchange[0])


def _cost(loss: Loss, residual: float) -> float:
    """Return ρ of one residual."""
    return float(loss.cost(np.array([residual])))
