"""Multi-start: choice of the starts of a frame, and of the lowest minimum.

Plain least squares of two-point readings begins at the convex start. A frame that follows another begins at the
previous estimate. A first frame whose cost may have several minima begins at the baseline, at equal cells, and at the
readout's own start.
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain, count, islice

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import NO_DUAL, Data, Evaluation
from lampest.files.process import delayed_interrupt
from lampest.panel.panel import Array
from lampest.solvers.preconditioners import Preconditioner
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import MAX_STARTS, VERIFIED, Outcome, Solution, Solver, Status, check, failure

BROKEN = (ArithmeticError, ValueError, RuntimeError)  # raised by numpy, LAPACK, SuperLU and CasADi for bad numbers
# Where the first start of a first frame met negative curvature, 3 of 9 frames of the bench ended 0.5 to 45 % above the
# best of three starts (docs/studies/speed.md).
FIRST_STARTS = 3
MAX_SPENT, MAX_UNSOLVED = 100, 300  # iterations of all starts after which a frame ends: with, and without an estimate
# Tolerance of polishing steps of readings in volt: they are large compared with their noise, and so is the cost that
# scales the test of optimality.
FINE = 1e-12
START_SPREAD = 20.0  # largest factor between a scattered start and the apparent resistance
SAME_MINIMUM = 1e-9  # relative difference of cost below which two minima are the same


def best_solution(
    solver: Solver, data: Data, previous: Array | None, preconditioner: Preconditioner | None = None
) -> Solution:
    """Return the lowest minimum over the starts of a frame.

    Where the cost may have several minima, solvers other than projected Newton continue from the minimum that projected
    Newton finds. A start with a numerical breakdown is skipped. If all starts break down, the status states it.

    Parameters
    ----------
    solver : Solver
    data : Data
    previous : array, shape (frames, rows, columns), or None
        Estimate of the previous frame, ohm.
    preconditioner : Preconditioner or None
        Preconditioner of the previous frame.
    """
    with np.errstate(all="ignore"), delayed_interrupt():
        if isinstance(solver, ProjectedNewton):
            return _lowest(replace(solver, preconditioner=preconditioner), data, previous)
        if not several_minima(solver.cost, data):
            return _lowest(solver, data, previous)
        scout = _lowest(ProjectedNewton(solver.cost, solver.settings, preconditioner), data, previous)
        if not scout.solved:
            return scout
        solution = solved_from(solver, evaluated(solver.cost, data, scout.cell_resistance))
        return replace(solution, starts=scout.starts, preconditioner=scout.preconditioner)


def _lowest(solver: Solver, data: Data, previous: Array | None) -> Solution:
    """Return the lowest minimum that one solver reaches from the starts of a frame."""
    requested, best, tried, spent = solver.settings.starts, None, 0, 0
    first = previous is None or data.first
    most = requested or (FIRST_STARTS if first and several_minima(solver.cost, data) else 1)
    places = chain(starts(solver.cost, data, previous), scattered(data) if requested else ())
    for start in evaluable(solver.cost, data, places):
        # End after the number of starts, the time limit, or the iterations that a frame may spend on further starts.
        solved = best is not None and best.solved
        done = tried >= most or (requested is None and spent > MAX_SPENT)
        if tried and (data.overdue or (solved and done) or (requested is None and spent > MAX_UNSOLVED)):
            break
        solution, tried = solved_from(solver, start), tried + 1
        spent += solution.iterations
        # Keep the first solution, and any solved one that is clearly lower.
        lower = best is None or not best.solved or solution.objective < best.objective * (1 - SAME_MINIMUM)
        best = solution if best is None or (solution.solved and lower) else best
        # No direction of negative curvature was met: further starts rarely find a lower minimum (1 of 24 first frames
        # of the bench, by 0.2 %; docs/studies/speed.md).
        if requested is None and solution.strict and solution.convex:
            break
    return _broken(solver.cost, data) if best is None else replace(best, starts=tried)


def several_minima(cost: Cost, data: Data) -> bool:
    """Return whether the cost may have several minima.

    One minimum is assumed for readouts whose inverse problem is unique, with convex losses, in two cases: plain least
    squares; and two-sided readings with terms that compare with an earlier frame, all of them convex in log r.
    """
    if not (all(term.loss.convex for term in cost.terms) and data.readout.unique):
        return True
    if all(term.reads_measurement for term in cost.terms):
        return False
    comparing = [term for term in cost.terms if term.needs_previous]
    convex_in_log = bool(comparing) and all(term.convex_in_log for term in comparing)
    return not (convex_in_log and bool(data.plain.all()))


def starts(cost: Cost, data: Data, previous: Array | None) -> Iterator[Array]:
    """Yield the starts of a frame in the order in which they are tried, (frames, rows, columns) ohm each."""
    if all(term.reads_measurement for term in cost.terms) and data.readout.unique:
        yield convex(data, previous)
    if previous is not None:
        yield previous
    yield data.uniform_start
    yield convex(data, None)


def scattered(data: Data) -> Iterator[Array]:
    """Yield an endless, deterministic sequence of starts: apparent resistances times factors of 1 to START_SPREAD.

    The exponents are the fractional parts of √2·n², which are evenly distributed (Rudnick, Sarnak & Zaharescu, Invent.
    Math. 145, 2001).
    """
    size = data.measured.size
    for drawn in count():
        places = np.arange(1, size + 1, dtype=float) + size * drawn
        share = (np.sqrt(2.0) * places**2 % 1.0).reshape(data.measured.shape)
        yield data.apparent_resistance * START_SPREAD**share


def convex(data: Data, near: Array | None) -> Array:
    """Return the readout's start of every frame, (frames, rows, columns) ohm; of two-point readings the convex one.

    `near` is an estimate of the same shape from which it is computed, or None. If the computation breaks down, the
    uniform start is returned.
    """
    places = [None] * len(data.measured) if near is None else list(near)
    with suppress(*BROKEN):
        return np.stack([data.readout.start(*frame) for frame in zip(data.measured, data.upper, places, strict=True)])
    return data.uniform_start


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
    """Solve from one start; Newton's method polishes results of IPOPT that are not settled strict minima."""
    try:
        outcome = solver.solve(start.data, start)
        solution = check(start, outcome)
        settled, unique = solution.strict and solution.kkt_residual <= VERIFIED / 10, start.data.readout.unique
        if isinstance(solver, ProjectedNewton) or outcome.status is not Status.OPTIMUM or (settled and unique):
            return solution
        # Polish from the solver's cells and, if that gives no strict minimum, from the start.
        steps = solver.settings if unique else replace(solver.settings, tolerance=FINE)
        newton, reached = ProjectedNewton(solver.cost, steps), [solution]
        for near in (evaluated(solver.cost, start.data, outcome.cell_resistance), start):
            polished = check(start, replace(newton.solve(start.data, near), iterations=outcome.iterations))
            reached.append(polished)
            if polished.strict:
                break
        solved = [candidate for candidate in reached if candidate.solved]
        return min(solved, key=lambda candidate: (not candidate.strict, candidate.objective), default=solution)
    except BROKEN:
        return _broken(solver.cost, start.data)


def _broken(cost: Cost, data: Data) -> Solution:
    """Return a solution of NaN with the status BREAKDOWN."""
    outcome = Outcome(data.measured, NO_DUAL, Status.BREAKDOWN, 0)
    return failure(cost, data, Status.BREAKDOWN, float("nan"), outcome)
