"""Check of a solver's outcome: conditions of an optimum, computed outside of the solver."""

from dataclasses import replace

import numpy as np

from lampest.cost.problem import ROUNDING, Evaluation
from lampest.panel.panel import Array
from lampest.solvers.bounds import MILLIONTH, bounds_matter
from lampest.solvers.certificate import Definiteness, certificate
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.solution import (
    UNSETTLED,
    VERIFIED,
    Outcome,
    Solution,
    Status,
    failure,
    solution_at,
)

# A frame is MISSED where more than this share of its readings deviates by FAR standard deviations
# (test_relaxation.py).
FAR = 10.0
MAX_FAR = 0.1
# Width of the smoothing in a certificate, over the largest residual with an absolute loss.
SMOOTHING_WIDTH = 1e-8


def check(start: Evaluation, outcome: Outcome) -> Solution:
    """Return the solution of an outcome, with cost and KKT residual recomputed outside the solver.

    An estimate is kept only if its KKT residual is at most VERIFIED, or its certificate converged,
    and its cost is not higher than at the start.

    Parameters
    ----------
    start : Evaluation
        Evaluation at the start of the solve.
    outcome : Outcome
    """
    cost = start.cost
    data = start.data
    dual = outcome.dual
    cells = np.clip(outcome.cell_resistance, data.lower, data.upper)
    if not np.all(np.isfinite(cells)):
        status = Status.BREAKDOWN if outcome.status is Status.OPTIMUM else outcome.status
        return failure(cost, data, status, float("nan"), outcome)
    # Evaluation at the clipped cells, reused where the solver's is the same.
    at = outcome.at
    if at is None or not np.array_equal(at.cell_resistance, cells):
        at = start.elsewhere(cells)
    gradient = at.log_gradient(dual)
    residual = at.kkt_residual(dual, gradient)
    # First order: the cost is not above that of the start, and the KKT residual is small.
    worse = at.objective - start.objective > VERIFIED * start.cost_scale + at.rounding
    stationary = residual <= VERIFIED
    # A large KKT residual can be rounding: of residuals at the corner of an absolute loss, whose
    # subgradients then balance the rest, or else of a heavy penalty, whose Newton step is short.
    ended = outcome.status is not Status.TIME and np.all(np.isfinite(gradient))
    if not worse and not stationary and ended and at.dual_gap(dual) <= VERIFIED * at.cost_scale:
        hessian = sharp_hessian(at, dual)
        verdict = outcome.certificate or certificate(hessian, outcome.preconditioner)
        balanced = _balanced_residual(hessian)
        if balanced is None:
            stationary = verdict.converged(at.cost_scale)
        else:
            residual = balanced
            stationary = verdict.short and residual <= VERIFIED
        outcome = replace(outcome, certificate=verdict)
    if worse or not stationary:
        fault = outcome.status
        if fault is Status.OPTIMUM:
            fault = Status.WORSE if stationary else Status.UNVERIFIED
        return failure(cost, data, _cause(at, gradient, outcome, fault), residual, outcome)
    # Second order: definiteness of the Hessian and length of the next Newton step.
    verdict = outcome.certificate or certificate(sharp_hessian(at, dual), outcome.preconditioner)
    if verdict.definiteness is Definiteness.INDEFINITE:
        return failure(cost, data, Status.SADDLE, residual, outcome)
    if not verdict.settled:
        return solution_at(at, residual, outcome, UNSETTLED[verdict.definiteness])
    if misses_many(at):
        return solution_at(at, residual, outcome, Status.MISSED)
    held = bounds_matter(at, gradient, dual)
    return solution_at(at, residual, outcome, Status.HELD if held else Status.OPTIMUM)


def misses_many(at: Evaluation) -> bool:
    """Return whether a share of more than MAX_FAR of the readings deviates by FAR of their noise.

    The test concerns misfits whose loss is not convex, because such a loss ignores deviating
    readings.
    """
    data = at.data
    ignores = any(term.reads_measurement and not term.loss.convex for term in at.cost.terms)
    if not (ignores and data.noise_known):
        return False
    far = np.abs(at.reading - data.measured) > FAR * data.sigma
    return bool(far[data.plain].sum() > MAX_FAR * data.plain.sum())


def sharp_hessian(at: Evaluation, dual: Array) -> Hessian:
    """Return the Hessian with smoothed absolute losses.

    The smoothing width is SMOOTHING_WIDTH of the largest residual.
    """
    largest = np.abs(at.nonsmooth).max(initial=0.0) or 1.0
    return Hessian(at, Smoothing(SMOOTHING_WIDTH * largest, dual))


def _balanced_residual(hessian: Hessian) -> float | None:
    """Return the projected gradient with the subgradients that balance it best.

    The subgradients |z| ≤ 1 of residuals x near the corner of an absolute loss minimise
    |g + Aᵀ diag(w) z|², A = ∂x/∂u over the cells that no bound holds; g has the other residuals.
    They need no digit of x, which may be rounding there. The smoothed loss is stiff at a corner, so
    that a Newton step is short there even where the cost falls steeply beyond. What rounding of
    cells changes of the gradient, which a heavy penalty multiplies, is no residual.

    Returns None where no residual is near its corner, and on panels too large for a matrix.
    Source: Stark & Parker, Comput. Stat. 10, 1995 (bounded least squares).
    """
    from scipy.optimize import lsq_linear

    if not hessian.dense:
        return None
    at = hessian.at
    dual = hessian.smoothing.dual
    cells = at.cell_resistance
    jacobian = hessian.kinked
    by_log = (jacobian[:, : cells.size] * cells.ravel()).toarray()
    for row, by_reading in enumerate(jacobian[:, cells.size :].toarray()):
        by_log[row] += hessian.adjoint(by_reading.reshape(cells.shape)) if by_reading.any() else 0.0
    # A change of log r by a millionth, as the certificate allows, reaches their corner.
    corner = np.abs(at.nonsmooth) <= MILLIONTH * np.abs(by_log).sum(axis=1)
    if not corner.any():
        return None
    weighted = (by_log[corner] * at.cost.slope[corner, None]).T
    subgradient = np.where(corner, 0.0, dual)
    target = -at.log_gradient(subgradient).ravel()
    # A cell at a bound may keep a gradient that points outward; first none is needed.
    lower, upper = at.data.log_bounds
    inside = ((at.position > lower) & (at.position < upper)).ravel()
    signs = (-1.0) ** np.arange(cells.size).reshape(cells.shape)
    rounded = at.elsewhere(cells * (1 + ROUNDING * signs))
    least = np.inf
    for free in (np.ones_like(inside), inside):
        subgradient[corner] = lsq_linear(weighted[free], target[free], (-1.0, 1.0), method="bvls").x
        gradient = at.log_gradient(subgradient)
        rounding = np.abs(rounded.log_gradient(subgradient) - gradient).max() / at.cost_scale
        least = min(least, float(at.projected_gradients(gradient) - rounding))
    return max(least, 0.0)


def _cause(at: Evaluation, gradient: Array, outcome: Outcome, fault: Status) -> Status:
    """Return the fault; ROUNDED where the second derivatives are within rounding."""
    may_be_rounding = (Status.BREAKDOWN, Status.ITERATIONS, Status.STALLED, Status.UNVERIFIED)
    if fault not in may_be_rounding or not np.all(np.isfinite(gradient)):
        return fault
    rounded = certificate(sharp_hessian(at, outcome.dual)).definiteness is Definiteness.UNDETERMINED
    return Status.ROUNDED if rounded else fault
