"""Which start is tried, and which of several minima is taken."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.losses import Squared
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import Term
from lampest.files.interrupts import delayed_interrupt
from lampest.panel.panel import Array
from lampest.solvers.kernel.following import from_previous, long_way_round, serves, swift
from lampest.solvers.kernel.pursuing import LARGER_UNKNOWNS
from lampest.solvers.newton.directions import Factor
from lampest.solvers.newton.newton import Newton
from lampest.solvers.newton.softest import either_side
from lampest.solvers.solution import VERIFIED, Outcome, Settings, Solution, Solver, Status, check, failure
from lampest.solvers.starts import (
    BROKEN,
    FAR_CELLS,
    affordable,
    convex,
    elsewhere,
    evaluable,
    evaluated,
    first_starts,
    large,
    lengthy,
    scattered,
)

POLISHED = 0.1 * VERIFIED
LAST_STEPS = Settings(max_iterations=20)
# Readings in volt are large beside their noise, and so is the cost against which the test of optimality is scaled: at
# 1e-8 of it cells may still be off by 1e-5.
FINE_STEPS = Settings(tolerance=1e-12, max_iterations=20)
SAME = 1e-9  # of the cost: minima that differ by less are one, reached from two sides
EASY, EASY_INTERIOR = 6, 20  # iterations; warm frames take 2 to 5 and 3 to 6, and a good start 9 of the latter
EASY_STRAIGHT = 12  # beyond what machine code follows: steps straight in r are cheap; frames in sequence take 3 to 8
EASY_KEPT = 4  # where factors are kept, which spares the first and the last step that any frame takes
MOVED, FEW_MOVED = 0.3, 0.05  # of log r, and of the cells
PATIENCE, LEAST_PATIENCE = 5, 60  # times the iterations, and iterations


def best_solution(solver: Solver, data: Data, previous: Array | None, kept: Factor | None = None) -> Solution:
    """The solution from the cheapest start; where the cost has several minima and the solve is hard, of all starts.

    The first start is the previous estimate; without one, r = R_m·MN/(M + N − 1) or the convex one; without a penalty,
    the convex one. A solve is hard that fails, takes many iterations, ends where more than a twentieth of the cells are
    others than in the frame before, or has no frame before on a panel of up to 400 cells, unless cells reproduce all
    readings of which nobody knows that others do; it is then begun from all of these and, on such panels, from 1.2 R_m
    and 20 R_m, which are far from all others, and a single frame from between its bounds, or, for a first pair,
    from cells that do not change; where these end in different minima, from six
    places more, while on larger ones starts that cost thirty times the cheapest are left out; what is
    verified is a local minimum, the best of these. A first pair of more than 1,024 cells is begun where none changes,
    and elsewhere only where that ends without an estimate.
    Costs that compare with a previous frame have several minima, and of some readouts nobody knows that they have one;
    for them the reduced solver searches, and any other solver goes on from what it found, so that all formulations
    stand in the same minimum; so it does on later frames of small panels. Where these terms are convex in log r and the
    previous frame is known, only one minimum was ever found, and the number of iterations is no sign.
    The starts after the first end with the one that brings them to one solve's limit of iterations, so that no frame
    takes more than three times that. In haste the first start has to do where there is a previous frame and it ends at
    an optimum; the solution says whether others would have been tried.
    Arithmetic that breaks down costs its start; where it does at every start, the status says so.

    kept : the factor that the frame before left, if it did.
    """
    with np.errstate(all="ignore"):
        if isinstance(solver, Newton):
            return _by_newton(solver.following(kept), data, previous)
        with delayed_interrupt():
            if not scouted(solver.cost, data, previous):
                return _best(solver, data, previous)
            scout = _by_newton(Newton(solver.cost, solver.settings, kept), data, previous)
            if not scout.solved:
                return scout
            at = evaluated(solver.cost, data, scout.cell_resistance)
            solution = solved_from(solver, at)
            return replace(solution, starts=scout.starts, factor=scout.factor, unsearched=scout.unsearched)


def scouted(cost: Cost, data: Data, previous: Array | None) -> bool:
    """Whether another solver goes on from what the reduced one found: where minima are several, and where machine code
    finds the only one at a fraction of the other solver's time.
    """
    if previous is not None and serves(cost, data):
        return True
    return not data.readout.unique or any(term.needs_previous for term in cost.terms)


def _by_newton(solver: Newton, data: Data, previous: Array | None) -> Solution:
    """The same by the reduced solver; of a later frame by machine code, where there is some.

    That alone is not kept from Ctrl-C, which costs a tenth of a frame; CasADi would take it for a failed evaluation.
    """
    found = None if previous is None else _followed(solver, data, previous)
    more = [] if found is None else _compared_with(solver, data, previous, found)
    if found is not None and not more:
        return found
    with delayed_interrupt():
        quick = solver if previous is None else swift(solver)
        if found is None:
            return _best(quick, data, previous)
        if data.hasty:
            return replace(found, unsearched=True)
        return _least(found, _others(quick, found, evaluable(quick.cost, data, more)))


def _followed(solver: Newton, data: Data, previous: Array) -> Solution | None:
    """The optimum that machine code finds near the frame before; None where it finds none.

    A factor that told of a second minimum makes no step of this frame: it would tell so again, of a place that is left.
    """
    if not _one_minimum(solver.cost, data) and solver.factor is not None and solver.factor.softest is not None:
        solver = solver.following(None)
    found = from_previous(solver, data, previous)
    if found is None and (near := _squared(solver)) is not None:
        begun = from_previous(near, data, previous)
        found = None if begun is None else from_previous(solver, data, begun.cell_resistance)
    return found


def _compared_with(solver: Newton, data: Data, previous: Array | None, found: Solution) -> list[Array]:
    """Starts beside an estimate that may be one of several minima, and, where it was hard to find, elsewhere."""
    if _one_minimum(solver.cost, data) or data.overdue:
        return []
    hard = found.iterations > _easy(solver, found) or _far_from(found, previous)
    return _beside(solver, found) + (elsewhere(data, previous) if hard else [])


def _far_from(found: Solution, previous: Array | None) -> bool:
    """Whether more than a few cells of a small panel are others than in the frame before: a load came, went or moved.

    A minimum that is not the lowest would be followed through all later frames, in a few iterations each.
    """
    if previous is None or not found.solved or previous.size > FAR_CELLS:
        return False
    return bool(np.mean(np.abs(np.log(found.cell_resistance / previous)) > MOVED) > FEW_MOVED)


def _missed(found: Solution) -> bool:
    """Whether readings are left that no cells reproduce; only where all are met is it known that no other cells do."""
    return found.at is not None and found.objective > SAME * found.at.cost_scale


def _one_minimum(cost: Cost, data: Data) -> bool:
    """Whether only one minimum was ever found beside a known previous frame, whatever the number of iterations.

    With penalties that is true of two-point readings alone, and of whole frames: where readings were missing, or
    bounds, a random start ended 3 % lower, and in volts at half the cost.
    """
    if not (all(term.loss.convex for term in cost.terms) and data.readout.unique):
        return False
    if all(term.reads_measurement for term in cost.terms):
        return True
    comparing = [term for term in cost.terms if term.needs_previous]
    return bool(comparing) and all(term.convex_in_log for term in comparing) and bool(data.plain.all())


def _best(solver: Solver, data: Data, previous: Array | None) -> Solution:
    relative = any(term.needs_previous for term in solver.cost.terms)
    plain = all(term.reads_measurement for term in solver.cost.terms)
    starts = first_starts(data) if previous is None else [previous]
    if previous is None and plain and data.readout.unique and large(data.measured):
        starts = starts[1:]  # it crowds the bounds where the estimate does, which tells how to go on
    starts += [convex(data, previous)] if previous is not None and plain else []
    points = affordable(evaluable(solver.cost, data, starts))
    if not points:
        return _broken(solver.cost, data)
    points = _with_squared(solver, points)
    found = solved_from(solver, points[0])
    first = previous is None and isinstance(solver, Newton) and data.measured[0].size <= FAR_CELLS
    long = first or (plain and data.measured[0].size <= FAR_CELLS and found.iterations > _easy(solver, found))
    one_minimum = _one_minimum(solver.cost, data) and not (long and _missed(found))
    hard = (relative and previous is None) or (
        not one_minimum and (first or found.iterations > _easy(solver, found) or _far_from(found, previous))
    )
    hard = hard and not lengthy(data)
    more = [] if one_minimum else _beside(solver, found)
    if (found.solved and not hard and not more) or data.overdue:
        return found
    if found.solved and data.hasty and previous is not None:
        return replace(found, unsearched=True)
    if hard or not found.solved:
        more += elsewhere(data, previous)
    else:
        points = points[:1]
    others = _others(solver, found, (*points[1:], *affordable(evaluable(solver.cost, data, more))))
    best = _least(found, others)
    if not (hard and best.solved and data.measured[0].size <= FAR_CELLS and _several([found, *others])):
        return best
    further = _others(solver, best, evaluable(solver.cost, data, scattered(data)))
    return replace(_least(best, further), starts=best.starts + len(further))


def _several(ends: list[Solution]) -> bool:
    """Whether they are different minima."""
    costs = [one.objective for one in ends if one.solved]
    return len(costs) > 1 and max(costs) > min(costs) * (1 + VERIFIED)


def _easy(solver: Solver, found: Solution) -> int:
    """Iterations of a frame that was not hard."""
    if not isinstance(solver, Newton):
        return EASY_INTERIOR
    if found.cell_resistance.size > LARGER_UNKNOWNS:
        return EASY_STRAIGHT
    return EASY_KEPT if found.factor is not None and found.factor.exact else EASY


def _others(solver: Solver, found: Solution, points: Iterable[Evaluation]) -> list[Solution]:
    """Solutions from more starts, as many as one solve's iterations begin."""
    solutions: list[Solution] = []
    patient = _patient(solver, found)
    patient = long_way_round(patient) if isinstance(patient, Newton) else patient
    for point in points:
        if sum(one.iterations for one in solutions) >= solver.settings.max_iterations or point.data.overdue:
            break
        solutions.append(solved_from(patient, point))
    return solutions


def _patient(solver: Solver, found: Solution) -> Solver:
    """The same for a few times the iterations of an optimum that is known: from afar one start in ten took all 300."""
    if not (found.solved and isinstance(solver, Newton)):
        return solver
    most = min(solver.settings.max_iterations, max(PATIENCE * found.iterations, LEAST_PATIENCE))
    return replace(solver, settings=replace(solver.settings, max_iterations=most))


def _least(found: Solution, others: list[Solution]) -> Solution:
    """The first, unless one of the others is a lower minimum; with the number of them all."""
    best = min((other for other in others if other.solved), key=lambda one: one.objective, default=found)
    lowest = best if not found.solved or best.objective < found.objective * (1 - SAME) else found
    return replace(lowest, starts=1 + len(others))


def _with_squared(solver: Solver, points: list[Evaluation]) -> list[Evaluation]:
    """The starts, before them where the cost ends with squared losses of the readings, begun at the first of them.

    Beyond a corner a loss pulls but does not bend: from afar, where all readings lie there, Newton's method gropes for
    a hundred iterations for what squares reach in five.
    """
    near = _squared(solver)
    if near is None:
        return points
    found = solved_from(near, evaluated(near.cost, points[0].data, points[0].cell_resistance))
    reached = list(evaluable(solver.cost, points[0].data, [found.cell_resistance])) if found.solved else []
    return sorted((*reached, *points), key=lambda point: point.objective)


def _squared(solver: Solver) -> Newton | None:
    """The same with squared losses of the readings; None where they are squared, or bend everywhere, already."""
    squared = tuple(replace(term, loss=Squared()) if _corners(term) else term for term in solver.cost.terms)
    if squared == solver.cost.terms or not isinstance(solver, Newton):
        return None
    return Newton(replace(solver.cost, terms=squared), solver.settings)


def _corners(term: Term) -> bool:
    """Whether a term takes readings by a loss that bends in some places alone."""
    return term.reads_measurement and not term.loss.squared and term.loss.enters == "split"


def _beside(solver: Solver, found: Solution) -> list[Array]:
    """Starts on either side of an estimate that may be one of two, as its factor tells; none where it does not.

    Second derivatives of rounded absolute losses tell of their kinks.
    """
    if not found.solved or found.at is None or not isinstance(solver, Newton) or len(solver.cost.slope):
        return []
    factor, position = found.factor or solver.factor, found.at.position
    if factor is None or factor.cell_resistance.shape != position.shape or (along := factor.softest) is None:
        return []
    return list(either_side(position, factor.cells, along))


def solved_from(solver: Solver, start: Evaluation) -> Solution:
    """Solve from one start, and, where an interior-point method stopped short of an optimum or its bounds, take the
    last steps from there; where these do not reach one either, from the start.
    """
    with suppress(*BROKEN):
        return _solved(solver, start)
    return _broken(solver.cost, start.data)


def _solved(solver: Solver, start: Evaluation) -> Solution:
    outcome = solver.solve(start.data, start)
    solution = check(start, outcome)
    settled = solution.strict and solution.kkt_residual <= POLISHED
    if (settled and start.data.readout.unique) or isinstance(solver, Newton) or outcome.status is not Status.OPTIMUM:
        return solution
    steps = LAST_STEPS if start.data.readout.unique else FINE_STEPS
    newton = Newton(solver.cost, steps if solution.solved else solver.settings)
    reached = [solution]
    for near in (evaluated(solver.cost, start.data, outcome.cell_resistance), start):
        polished = check(start, replace(newton.solve(start.data, near), iterations=outcome.iterations))
        reached.append(polished)
        if polished.strict:
            break
    solved = [one for one in reached if one.solved]
    return min(solved, key=lambda one: (not one.strict, one.objective), default=solution)


def _broken(cost: Cost, data: Data) -> Solution:
    outcome = Outcome(data.measured, np.zeros(0), Status.BREAKDOWN, 0)
    return failure(cost, data, Status.BREAKDOWN, float("nan"), outcome)
