"""Primal-dual active set for absolute losses: from a point where they are smoothed to the minimum where they are not.

After a Newton step, a row whose residual changes its sign joins those at their kink, one whose dual leaves ±1 goes.
Source: Hintermüller, Ito & Kunisch, SIAM J. Optim. 13, 2003.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array
from lampest.panel.trust_region import LONGEST
from lampest.solvers.bounds import free_cells, moved_by
from lampest.solvers.certificate import Certificate, Definiteness, at_kinks
from lampest.solvers.hessian import DENSE_STIFF_CELLS, Hessian
from lampest.solvers.kinks import AT_ZERO, Kinks, Unsmoothed, at_kink

MOST_ROUNDS = 12  # near the minimum two or three
MOST_CHANGED, FEW = 0.05, 4  # of all rows, and rows: where more change in a round the point is not near
LAST = 1e-7  # of log r: such a Newton step leaves rounding; of the cost's scale: such a gradient
MET = 1e-6  # of a residual, after a step to its kink; of those that depend on heavier ones more is left


def unsmoothed_minimum(at: Evaluation, dual: Array) -> tuple[Evaluation, Array, Certificate] | None:
    """(point, duals, certificate) of the minimum near a point with smoothed duals; None where steps end at none."""
    if not len(at.nonsmooth) or at.cell_resistance.size > DENSE_STIFF_CELLS:
        return None
    begun, active = at, at_kink(at, dual)
    for _ in range(MOST_ROUNDS):
        dual = np.where(active, np.clip(dual, -1, 1), np.sign(at.nonsmooth))
        hessian = Hessian(at, Unsmoothed(0.0, dual))
        free = np.flatnonzero(free_cells(at, hessian.gradient))
        kinks = Kinks.of(hessian, active, free)
        found = at_kinks(hessian, free, kinks)
        longest = float(np.abs(found.step).max(initial=0.0))
        if found.definiteness is Definiteness.INDEFINITE or not np.isfinite(longest):
            return None
        dual, further = _corrected(hessian, free, kinks, found.step, active)
        changed = np.count_nonzero(further != active)
        if changed > max(FEW, MOST_CHANGED * len(dual)):
            return None
        there = moved_by(at, found.step * min(1.0, LONGEST / max(longest, LONGEST)))
        if there is None:
            return None
        at, active = there, further
        if longest <= LAST and not changed:
            return _ended(begun, at, np.clip(dual, -1, 1))
    return None


def _corrected(
    hessian: Hessian, free: NDArray[np.intp], kinks: Kinks, step: Array, active: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    """(duals, rows at their kink) after a step."""
    at, before = hessian.at, hessian.smoothing.dual
    left = hessian.gradient[free] + (hessian.matrix @ step)[free]
    dual = kinks.balanced(before, left, at.cost.slope)
    both = [at.cell_resistance.ravel() * step, hessian.forward(step).ravel()]
    residual = at.nonsmooth + hessian.smoothing.jacobian(at) @ np.concatenate(both)
    stays = np.abs(residual) <= np.maximum(MET * np.abs(at.nonsmooth), AT_ZERO * at.nonsmooth_reach)
    crossed = ~active & (residual * before < 0)
    dual = np.where(active & ~stays, np.sign(residual), dual)
    return dual, (active & stays & ~_released(at, active, dual)) | crossed


def _released(at: Evaluation, active: NDArray[np.bool_], dual: Array) -> NDArray[np.bool_]:
    """(rows) which leave their kink: duals beyond ±1; only the farthest where readings have absolute losses."""
    beyond = active & (np.abs(dual) > 1)
    if not beyond.any() or not any(term.reads_measurement and term.loss.enters == "dual" for term in at.cost.terms):
        return beyond
    return np.asarray(beyond & (np.abs(dual) == np.abs(dual[beyond]).max()))


def _ended(begun: Evaluation, at: Evaluation, dual: Array) -> tuple[Evaluation, Array, Certificate] | None:
    """The minimum, where it is one, and no higher than the point."""
    hessian = Hessian(at, Unsmoothed(0.0, dual))
    free = np.flatnonzero(free_cells(at, hessian.gradient))
    found = at_kinks(hessian, free, Kinks.of(hessian, at_kink(at, dual), free))
    residual = at.projected_gradient(hessian.gradient.reshape(at.cell_resistance.shape))
    balanced = residual <= LAST or found.converged(at.cost_scale)
    lower = at.objective <= begun.objective + begun.rounding + at.rounding
    known = found.settled or found.definiteness is Definiteness.UNDETERMINED
    return (at, dual, found) if balanced and lower and known else None
