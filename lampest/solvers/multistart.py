"""Starts of a frame, and the lowest minimum that a solver reaches from them.

The starts are the same for every solver. A frame begins at the previous estimate, the first one at
equal cells. Where the solver then met negative curvature, the cost may have several minima: it
begins again at the convex start and at equal cells, cold, along the central path of a barrier,
which ends in lower minima than steps straight down (docs/studies/speed.md).
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.files.errors import BROKEN
from lampest.files.process import delayed_interrupt
from lampest.panel.panel import Array
from lampest.solvers.check import check
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
    ends itself, see `lampest.solvers.relaxation`. A number of starts that the settings state has no
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
        from lampest.solvers.relaxation import searched_starts  # for such losses alone

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
