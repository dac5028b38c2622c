"""Direction of a step by the quadratic model within trust radius and bounds, and its acceptance.

The unknowns are relative changes s of the conductances, g ← g·(1 − s), in which readings are
closest to quadratic. With u = log r, δu = −log(1 − s) = s + s²/2 + …, so that the Hessian in s is
∇²φ + diag(∇φ).

A step is accepted if the cost falls by a share of the model's prediction. A solve ends if its steps
have lowered the cost too little for too long, or if its time is over.
Source: Nocedal & Wright, Numerical Optimization, 2006, algorithms 3.1 and 4.1, section 3.1
(stopping by the decrease of the cost).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array, Mask
from lampest.panel.trust_region import (
    SUFFICIENT_DECREASE,
    Linear,
    SubproblemStep,
    restricted,
    steihaug,
)
from lampest.solvers.bounds import MIN_DECREASE_SHARE
from lampest.solvers.iterate import Iterate
from lampest.solvers.preconditioners import (
    Cholesky,
    Preconditioner,
    gauss_newton_factor,
    preconditioner,
)
from lampest.solvers.solution import Status

# Of log r of a cell in one step: beyond, the quadratic model of a cell is wrong.
MAX_CHANGE = log(4.0)
# Solves of one direction, each of which may stop further cells at bounds; tries of one step, whose
# radius is then 4⁻¹⁵, within rounding; and further steps at a point that is stationary but not
# settled
MAX_TRIES = 15
RADIUS_FACTOR = 0.25  # next trust radius over the length of a rejected step
# Products in one solve, (sparse, dense): a new factor is cheaper on small problems.
MAX_PRODUCTS = (400, 40)
# Change of log r beyond which the preconditioner is made anew. Without it small panels take a third
# more products.
MAX_REUSE_DISTANCE = 0.7
# (moving cells, step s, lowest and highest s) → cells that keep moving; the others stay at the
# bound that they reached.
ActiveSet = Callable[[Mask, Array, Array, Array], Mask]
WINDOW = 20  # iterations after which a solve counts as stalled; well-posed frames end within 15
# Relative decrease of the cost over the window. A joint pair on a plateau falls by more and still
# ends verified (test_random_problems).
MIN_DECREASE = 1e-8
# Share of the projected gradient at the window's begin below which the solve still converges
MIN_REDUCTION = 0.1
History = Sequence[tuple[float, float]]


def log_resistance_change(share: Array) -> Array:
    """Return the change δu = −log(1 − s) of log r for a relative change s of a conductance."""
    return -np.log1p(-share)


def conductance_change(change: Array) -> Array:
    """Return the relative change s = 1 − exp(−δu) of a conductance for a change δu of log r."""
    return -np.expm1(-change)


def shares_conductance(at: Evaluation) -> bool:
    """Return whether lines touch and no penalty determines how parallel cells share conductance.

    Steps in log r then keep the shares near those of the start.
    """
    wiring = at.data.wiring
    return (
        wiring is not None
        and bool(wiring.joined)
        and all(term.reads_measurement for term in at.cost.terms)
    )


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """Quadratic model gᵀs + ½ sᵀHs of the cost about a point.

    Attributes
    ----------
    product : callable
        s → H s over all cells.
    preconditioner : Preconditioner
        M ≈ H.
    exact : bool
        Whether H has all second derivatives of the cost; otherwise it is the Gauss–Newton matrix.
    """

    product: Linear
    preconditioner: Preconditioner
    exact: bool = True

    @classmethod
    def of(cls, point: Iterate) -> "QuadraticModel":
        """Return the exact model about a point.

        The preconditioner is the newest one if the point is near enough to it, else a new one.
        """
        hessian = point.hessian
        in_log_r = shares_conductance(point.at)
        curved = np.zeros_like(hessian.gradient) if in_log_r else hessian.gradient
        cached: Preconditioner | None = None
        if hessian.dense and len(point.at.nonsmooth):
            # Corners change the matrix from step to step. Products with H keep the digits that its
            # factor loses under heavy weights.
            free = np.flatnonzero(hessian.free)
            cached = Cholesky.of(hessian.cells, free, hessian.matrix + np.diag(curved))
        cached = cached or point.newest_preconditioner
        if cached is None or cached.distance(hessian.cells) > MAX_REUSE_DISTANCE:
            cached = preconditioner(hessian, hessian.free)
        return cls(lambda step: hessian.product(step) + curved * step, cached)

    def gauss_newton(self, point: Iterate) -> "QuadraticModel":
        """Return the model with the Gauss–Newton matrix, which has no negative curvature."""
        hessian = point.hessian
        factor = gauss_newton_factor(hessian, hessian.free) or self.preconditioner
        return QuadraticModel(hessian.gauss_newton_product, factor, exact=False)


def hold_beyond_bounds(moving: Mask, step: Array, low: Array, high: Array) -> Mask:
    """Return the moving cells whose step stays within the bounds."""
    return moving & ~((step < low) | (step > high))


def newton_direction(
    point: Iterate, model: QuadraticModel, radius: float, active_set: ActiveSet
) -> SubproblemStep:
    """Return the minimiser δu of the quadratic model within the trust radius and the bounds.

    Conjugate gradients solve the model over the moving cells. Cells that the active set stops are
    fixed at their bound, and the model is solved again over the others.

    Parameters
    ----------
    point : Iterate
    model : QuadraticModel
    radius : float
        Trust radius in the norm of the preconditioner.
    active_set : callable
        Which cells keep moving, see `hold_beyond_bounds`.
    """
    at = point.at
    gradient = point.hessian.gradient
    in_log_r = shares_conductance(at)
    room = (bound.ravel() - at.position.ravel() for bound in at.data.log_bounds)
    limits = [np.clip(change, -MAX_CHANGE, MAX_CHANGE) for change in room]
    low, high = limits if in_log_r else map(conductance_change, limits)
    # Forcing term: superlinear convergence (Nocedal & Wright 2006, section 7.1). The gradient of
    # smoothed absolute losses stays large between narrow corners, so that it is no measure.
    smooth = not len(at.nonsmooth)
    accuracy = min(0.1, point.residual**0.5 if smooth else point.error ** (1 / 3))
    limit = MAX_PRODUCTS[point.hessian.dense]
    moving = point.hessian.free
    step = np.zeros(moving.size)
    slope = gradient
    products = 0
    negative = False
    clipped = False
    for _ in range(MAX_TRIES):
        chosen = np.flatnonzero(moving)
        part = restricted(model.product, chosen, moving.size)
        inverse = model.preconditioner.over(moving, at.cell_resistance)
        solved = steihaug(part, inverse, slope[chosen], accuracy, radius, most_products=limit)
        products = max(products, solved.products)
        negative = negative or solved.negative
        step[chosen] = solved.step
        staying = active_set(moving, step, low, high)
        within = np.clip(step, low, high)
        clipped = clipped or not np.array_equal(within, step)
        step = within
        if np.array_equal(staying, moving) or not staying.any():
            break
        moving = staying
        # Gradient of the model over the moving cells, with the others at their bounds: g + H
        # s_fixed
        slope = gradient + model.product(np.where(moving, 0.0, step))
    decrease = solved.decrease
    if clipped:
        decrease = -float(gradient @ step + 0.5 * step @ model.product(step))
    change = step if in_log_r else log_resistance_change(step)
    return SubproblemStep(change, solved.length, decrease, negative, products)


def decreases_enough(
    decrease: Array | float,
    predicted: Array | float,
    objective: Array | float,
    residual: Array | float,
    trial_residual: Array | float,
) -> Mask:
    """Return whether steps are accepted, (…,).

    The cost must fall by a share SUFFICIENT_DECREASE of the predicted decrease. Where that decrease
    is within rounding of the cost, the gradient must halve instead.

    Parameters
    ----------
    decrease, predicted : array, shape (…,)
        Decrease of the cost φ, and the one that the model predicts.
    objective : array, shape (…,)
        φ before the step.
    residual, trial_residual : array, shape (…,)
        Largest entry of the projected gradient before and after the step.
    """
    rounding = MIN_DECREASE_SHARE * np.abs(objective)
    falls = np.isfinite(decrease) & (decrease >= SUFFICIENT_DECREASE * predicted)
    halves = (np.abs(decrease) <= rounding) & (trial_residual <= residual / 2)
    return np.where(predicted > rounding, falls, halves)


def exceeds_rounding(point: Iterate, predicted: float) -> bool:
    """Return whether a predicted decrease of the cost exceeds the rounding of the cost."""
    return predicted > MIN_DECREASE_SHARE * abs(point.objective)


def sufficient_decrease(point: Iterate, trial: Iterate, predicted: float) -> bool:
    """Return whether the step from a point to a trial is accepted, see `decreases_enough`.

    `predicted` is the decrease of the cost that the quadratic model predicts. The trial's gradient
    is computed only where that decrease is within rounding.
    """
    certain = exceeds_rounding(point, predicted)
    trial_residual = point.residual if certain else trial.residual
    return bool(
        decreases_enough(
            point.objective - trial.objective,
            predicted,
            point.objective,
            point.residual,
            trial_residual,
        )
    )


def late_or_stalled(data: Data, history: History) -> Status | None:
    """Return the status of a solve that is overdue or stalled, or None.

    Parameters
    ----------
    data : Data
    history : sequence of (cost, projected gradient)
        One pair for each iteration with the same smoothing.
    """
    if data.overdue:
        return Status.TIME
    return Status.STALLED if stalled(history) else None


def stalled(history: History) -> bool:
    """Return whether cost and projected gradient have stalled over a full window.

    Neither cost nor gradient fell by the required amount in the window.

    A stalled solve is one whose cost has stopped falling although its gradient has not vanished:
    the data and penalties leave a valley whose floor is flat, or a loss has corners that second
    derivatives do not show.

    Parameters
    ----------
    history : sequence of (cost, projected gradient)
        One pair for each iteration with the same smoothing.
    """
    if len(history) <= WINDOW:
        return False
    first, steep = history[-WINDOW - 1]
    last, residual = history[-1]
    return first - last < MIN_DECREASE * abs(last) and residual > MIN_REDUCTION * steep
