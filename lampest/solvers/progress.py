"""Progress of a descent: acceptance of steps, and the end of a solve without an optimum.

A step is accepted if the cost falls by a share of the quadratic model's prediction. A solve ends if
its steps have lowered the cost too little for too long, or if its time is over.
Source: Nocedal & Wright, Numerical Optimization, 2006, algorithms 3.1 and 4.1, section 3.1
(stopping by the decrease of the cost).
"""

from collections.abc import Sequence

import numpy as np

from lampest.cost.problem import Data
from lampest.panel.panel import Array, Mask
from lampest.panel.trust_region import SUFFICIENT_DECREASE
from lampest.solvers.bounds import MIN_DECREASE_SHARE
from lampest.solvers.iterate import Iterate
from lampest.solvers.solution import Status

WINDOW = 20  # iterations after which a solve counts as stalled; well-posed frames end within 15
# Relative decrease of the cost over the window. A joint pair on a plateau falls by more and still
# ends verified (test_random_problems).
MIN_DECREASE = 1e-8
# Share of the projected gradient at the window's begin below which the solve still converges
MIN_REDUCTION = 0.1
History = Sequence[tuple[float, float]]


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
