"""Multi-start: plain least squares of two-point readings begins at the convex start, a frame at the estimate before.

A first frame whose cost may have several minima begins at the baseline, at equal cells, and at the readout's own start.
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain, count, islice

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.files.process import delayed_interrupt
from lampest.panel.panel import Array
from lampest.solvers.preconditioners import Preconditioner
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import MAX_STARTS, VERIFIED, Outcome, Settings, Solution, Solver, Status, check, failure

BROKEN = (ArithmeticError, ValueError, RuntimeError)  # what numpy, LAPACK, SuperLU and CasADi raise for numbers
FIRST_STARTS = 3
MAX_SPENT, MAX_UNSOLVED = 100, 300  # iterations of all starts, after which a frame with, without an estimate ends
START_SPREAD = 20.0  # times the apparent resistance, to which scattered starts reach
SAME_MINIMUM = 1e-9  # of the cost: minima that differ by less are one, reached from two sides
LAST_STEPS = Settings(max_iterations=20)
# Readings in volt are large beside their noise, and so is the cost against which the test of optimality is scaled.
FINE_STEPS = Settings(tolerance=1e-12, max_iterations=20)


def best_solution(
    solver: Solver, data: Data, previous: Array | None, preconditioner: Preconditioner | None = None
) -> Solution:
    """Return the lowest minimum from as many starts as the settings or, by default, the frame asks for.

    Other solvers continue from the minimum of projected Newton where the cost may have several. Arithmetic that breaks
    down costs its start; where it does at every start, the status says so.

    Parameters
    ----------
    solver : Solver
    data : Data
    previous : array, shape (frames, rows, columns), or None
        Estimate of the frame before, ohm.
    preconditioner : Preconditioner or None
        From the frame before.
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
    requested, best, tried, spent = solver.settings.starts, None, 0, 0
    first = previous is None or data.first
    most = requested or (FIRST_STARTS if first and several_minima(solver.cost, data) else 1)
    places = chain(starts(solver.cost, data, previous), scattered(data) if requested else ())
    for start in evaluable(solver.cost, data, places):
        solved = best is not None and best.solved
        enough = tried >= most or (requested is None and spent > MAX_SPENT)
        if tried and (data.overdue or (solved and enough) or (requested is None and spent > MAX_UNSOLVED)):
            break
        solution, tried = solved_from(solver, start), tried + 1
        spent += solution.iterations
        lower = best is None or not best.solved or solution.objective < best.objective * (1 - SAME_MINIMUM)
        best = solution if best is None or (solution.solved and lower) else best
        if requested is None and solution.strict and solution.convex:
            break
    return _broken(solver.cost, data) if best is None else replace(best, starts=tried)


def several_minima(cost: Cost, data: Data) -> bool:
    """Return whether there may be several minima: in all but two-point readings whose penalties are convex in log r."""
    if not (all(term.loss.convex for term in cost.terms) and data.readout.unique):
        return True
    if all(term.reads_measurement for term in cost.terms):
        return False
    comparing = [term for term in cost.terms if term.needs_previous]
    convex_in_log = bool(comparing) and all(term.convex_in_log for term in comparing)
    return not (convex_in_log and bool(data.plain.all()))


def starts(cost: Cost, data: Data, previous: Array | None) -> Iterator[Array]:
    """Return starts in the order in which they are tried: (frames, rows, columns) ohm."""
    if all(term.reads_measurement for term in cost.terms) and data.readout.unique:
        yield convex(data, previous)
    if previous is not None:
        yield previous
    yield data.uniform_start
    yield convex(data, None)


def scattered(data: Data) -> Iterator[Array]:
    """Apparent resistances times 1 to START_SPREAD, without end and the same for everybody.

    The exponents are fractions of √2·n², which lie evenly (Rudnick, Sarnak & Zaharescu, Invent. Math. 145, 2001).
    """
    size = data.measured.size
    for drawn in count():
        places = np.arange(1, size + 1, dtype=float) + size * drawn
        share = (np.sqrt(2.0) * places**2 % 1.0).reshape(data.measured.shape)
        yield data.apparent_resistance * START_SPREAD**share


def convex(data: Data, near: Array | None) -> Array:
    """Return the readout's start of every frame, of two-point readings the convex one; near : an estimate, or None."""
    places = [None] * len(data.measured) if near is None else list(near)
    with suppress(*BROKEN):
        return np.stack([data.readout.start(*three) for three in zip(data.measured, data.upper, places, strict=True)])
    return data.uniform_start


def evaluated(cost: Cost, data: Data, start: Array) -> Evaluation:
    """Return the cost at a start put within the bounds."""
    return Evaluation.at(cost, data, np.clip(start, data.lower, data.upper))


def evaluable(cost: Cost, data: Data, places: Iterable[Array]) -> Iterator[Evaluation]:
    """Return the cost at those starts where it is a number."""
    for start in islice(places, MAX_STARTS):
        with suppress(*BROKEN):
            point = evaluated(cost, data, start)
            if np.isfinite(point.objective):
                yield point


def solved_from(solver: Solver, start: Evaluation) -> Solution:
    """Solve from one start; what an interior-point method left short of an optimum is polished by Newton's steps."""
    with suppress(*BROKEN):
        return _solved(solver, start)
    return _broken(solver.cost, start.data)


def _solved(solver: Solver, start: Evaluation) -> Solution:
    outcome = solver.solve(start.data, start)
    solution = check(start, outcome)
    settled = solution.strict and solution.kkt_residual <= VERIFIED / 10
    unique = start.data.readout.unique
    if (settled and unique) or isinstance(solver, ProjectedNewton) or outcome.status is not Status.OPTIMUM:
        return solution
    steps = LAST_STEPS if unique else FINE_STEPS
    newton = ProjectedNewton(solver.cost, steps if solution.solved else solver.settings)
    reached = [solution]
    for near in (evaluated(solver.cost, start.data, outcome.cell_resistance), start):
        polished = check(start, replace(newton.solve(start.data, near), iterations=outcome.iterations))
        reached.append(polished)
        if polished.strict:
            break
    solved = [candidate for candidate in reached if candidate.solved]
    return min(solved, key=lambda candidate: (not candidate.strict, candidate.objective), default=solution)


def _broken(cost: Cost, data: Data) -> Solution:
    outcome = Outcome(data.measured, np.zeros(0), Status.BREAKDOWN, 0)
    return failure(cost, data, Status.BREAKDOWN, float("nan"), outcome)
