"""Starts of a frame, and the lowest minimum that a solver reaches from them.

The starts are the same for every solver. A frame begins at the previous estimate, the first one at
equal cells. Where the solver then met negative curvature, the cost may have several minima: it
begins again at the convex start and at equal cells, cold, along the central path of a barrier,
which ends in lower minima than steps straight down (docs/studies/speed.md).

Readings that are far off at a start have hardly any pull under a loss that is not convex, so that
steps from there end where they are outliers. The relaxed cost has Huber's loss instead, with a
corner where the loss still is a square: it is convex, and single wrong readings hardly move its
minimum. The solver that minimises the cost minimises the relaxed one first, and begins at its
minimum.

Minima differ in the readings that are outliers there. From the lowest one an outlier enters, or a
reading with large leverage leaves, and the solver begins there. The search begins again at every
lower minimum, and ends where no exchange lowers the cost. Losses that shrink from squares end
higher, and so do starts at random (docs/studies/minima.md).
Source: Yohai, Ann. Statist. 15, 1987 (a robust convex start for a redescending loss).
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, reduce
from itertools import islice
from typing import Any

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.losses import Huber, Loss
from lampest.cost.problem import NO_DUAL, Data, Evaluation, residuals
from lampest.files.errors import BROKEN
from lampest.files.process import delayed_interrupt
from lampest.panel.panel import Array
from lampest.solvers.check import check, sharp_hessian
from lampest.solvers.preconditioners import preconditioner
from lampest.solvers.solution import (
    MAX_STARTS,
    Solution,
    Solver,
    Status,
    blank,
    lower_of,
)

# Starts of a frame whose first solve met negative curvature: as many as there are kinds of starts.
MAX_MINIMA = 3
MAX_SEARCHED = 40  # starts with losses that are not convex (docs/studies/minima.md)
# iterations of all starts after which a frame ends: with, and without an estimate
MAX_SPENT = 100
MAX_UNSOLVED = 300
START_SPREAD = 20.0  # largest factor between a scattered start and the apparent resistance
CORNER = 0.1  # of the residual at which the loss ceases to be convex
FAR_OUT = 2.0  # times the range in which a loss is convex: residuals of outliers are beyond
LARGEST_STEP = 2.0  # of log r: change of a cell where a reading is exchanged
# Residuals among which the end of convexity is searched for, in any unit.
RESIDUALS = np.geomspace(1e-12, 1e12, 4801)


def most_starts(solver: Solver, data: Data) -> int:
    """Return the number of starts that a frame may spend.

    Unless the settings state it, it is MAX_MINIMA where the cost may have several minima,
    MAX_SEARCHED with losses that are not convex, and 1 otherwise.
    """
    if solver.settings.starts is not None:
        return solver.settings.starts
    if not solver.cost.convex_losses:
        return MAX_SEARCHED
    return MAX_MINIMA if several_minima(solver.cost, data) else 1


def _is_spent(
    solver: Solver, data: Data, best: Solution, ends: Sequence[Solution], *, continues: bool
) -> bool:
    """Return whether no further start is tried after these solutions, given the best of them.

    A strict minimum from the first start is kept in two cases: in a frame that continues an earlier
    one, and where the solver met no direction of negative curvature on its way. Further starts then
    rarely find a lower minimum (docs/studies/speed.md). With losses that are not convex, the search
    ends itself, see `lampest.solvers.multistart`. A number of starts that the settings state has no
    limit of iterations.
    """
    iterations = sum(end.iterations for end in ends)
    requested = solver.settings.starts is not None
    if not (requested or best.solved):
        return iterations > MAX_UNSOLVED
    if len(ends) >= most_starts(solver, data):
        return True
    if requested or not solver.cost.convex_losses:
        return False
    kept = len(ends) == 1 and best.strict and (best.convex or continues)
    return kept or iterations > MAX_SPENT


def best_solution(
    solver: Solver, data: Data, previous: Array | None, carried: Any = None
) -> Solution:
    """Return the lowest minimum that a solver reaches from the starts of a frame.

    A start with a numerical breakdown
    is skipped. If all starts break down, the status states it.

    Parameters
    ----------
    solver : Solver
    data : Data
    previous : array, shape (frames, rows, columns), or None
        Estimate of the previous frame, ohm.
    carried : object
        What the solution of the previous frame carries, see `Outcome`.
    """
    solver = solver.continued(carried)
    continues = previous is not None and not data.first
    best = None
    ends = list[Solution]()
    with np.errstate(all="ignore"), delayed_interrupt():
        for start in evaluable(solver.cost, data, _places(solver, data, previous, ends)):
            attempt = solver
            if ends:  # only the first start continues the previous frame
                attempt = solver.cold() if solver.cost.convex_losses else solver.continued(None)
            ends.append(solved_from(attempt, start))
            best = lower_of(best, ends[-1])
            if data.overdue or _is_spent(solver, data, best, ends, continues=continues):
                break
    best = _broken(solver.cost, data) if best is None else best
    return replace(best, starts=len(ends) or 1, solver=solver.name)


def _places(
    solver: Solver, data: Data, previous: Array | None, ends: Sequence[Solution]
) -> Iterator[Array]:
    """Yield the starts of a frame, given the solutions from those before.

    The sequence has no end where the settings state the number of starts.
    """
    cost = solver.cost
    usual = starts(cost, data, previous)
    if not cost.convex_losses:
        first = next(usual)
        yield first
        yield from searched_starts(solver.continued(None), evaluated(cost, data, first), ends)
        if solver.settings.starts is None:
            return
    yield from usual
    if solver.settings.starts is not None:
        yield from scattered(data)


def several_minima(cost: Cost, data: Data) -> bool:
    """Return whether the cost may have several minima.

    One minimum is assumed for readouts whose inverse problem is unique, with convex losses, in two
    cases: plain least squares; and two-sided readings with terms that compare with an earlier
    frame, all of them convex in log r.
    """
    if not (all(term.loss.convex for term in cost.terms) and data.readout.two_point):
        return True
    if all(term.reads_measurement for term in cost.terms):
        return False
    comparing = [term for term in cost.terms if term.needs_previous]
    convex_in_log = comparing and all(term.convex_in_log for term in comparing)
    return not (convex_in_log and data.plain.all())


def starts(cost: Cost, data: Data, previous: Array | None) -> Iterator[Array]:
    """Yield the starts of a frame, (frames, rows, columns) ohm, in the order of their trial.

    The convex start of plain least squares is left out, because it is the solution by another
    method.
    """
    yield data.uniform_start if previous is None else previous
    if not data.start_minimises(cost):
        yield data.start()
    if previous is not None:
        yield data.uniform_start


def scattered(data: Data) -> Iterator[Array]:
    """Yield an endless, deterministic sequence of starts.

    A start is the apparent resistance times factors from 1 to START_SPREAD. The exponents of
    START_SPREAD are the fractional parts of √2·n², which are evenly distributed (Rudnick, Sarnak &
    Zaharescu, Invent. Math. 145, 2001).
    """
    places = np.arange(1.0, data.measured.size + 1).reshape(data.measured.shape)
    while True:
        yield data.apparent_resistance * START_SPREAD ** (np.sqrt(2.0) * places**2 % 1.0)
        places = places + places.size


def evaluated(cost: Cost, data: Data, start: Array) -> Evaluation:
    """Return the evaluation at a start, clipped to the bounds."""
    return Evaluation.at(cost, data, np.clip(start, data.lower, data.upper))


def evaluable(cost: Cost, data: Data, places: Iterable[Array]) -> Iterator[Evaluation]:
    """Yield the evaluations at those starts where the cost is finite."""
    for start in islice(places, MAX_STARTS):
        with suppress(*BROKEN):
            point = evaluated(cost, data, start)
            if np.isfinite(point.objective):
                yield point


def solved_from(solver: Solver, start: Evaluation) -> Solution:
    """Return the checked solution from one start."""
    try:
        return check(start, solver.solve(start.data, start))
    except BROKEN:
        return _broken(solver.cost, start.data)


def _broken(cost: Cost, data: Data) -> Solution:
    """Return a solution of NaN with the status BREAKDOWN."""
    return blank(data.measured.shape, len(cost.terms), Status.BREAKDOWN)


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
    is exchanged follow, until none leads to a lower minimum.

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
