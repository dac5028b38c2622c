"""Acceptance of a step that lowers the cost by a share of the quadratic model's prediction.

Source: Nocedal & Wright, Numerical Optimization, 2006, algorithms 3.1 and 4.1.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lampest.panel.trust_region import SUFFICIENT_DECREASE
from lampest.solvers.bounds import MIN_DECREASE_SHARE
from lampest.solvers.iterate import Iterate


def decreases_enough(
    decrease: ArrayLike,
    predicted: ArrayLike,
    objective: ArrayLike,
    residual: ArrayLike,
    trial_residual: ArrayLike,
) -> NDArray[np.bool_]:
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
    decrease, predicted, residual, trial_residual = map(
        np.asarray, (decrease, predicted, residual, trial_residual)
    )
    rounding: Any = MIN_DECREASE_SHARE * np.abs(objective)
    falls = np.isfinite(decrease) & (decrease >= SUFFICIENT_DECREASE * predicted)
    halves = (np.abs(decrease) <= rounding) & (trial_residual <= residual / 2)
    return np.asarray(np.where(predicted > rounding, falls, halves))


def sufficient_decrease(point: Iterate, trial: Iterate, predicted: float) -> bool:
    """Return whether the step from a point to a trial is accepted, see `decreases_enough`.

    `predicted` is the decrease of the cost that the quadratic model predicts.
    """
    return bool(
        decreases_enough(
            point.objective - trial.objective,
            predicted,
            point.objective,
            point.residual,
            trial.residual,
        )
    )
