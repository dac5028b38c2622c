"""Termination of a solve that does not end at an optimum.

Source: Nocedal & Wright, Numerical Optimization, 2006, section 3.1 (stopping by the decrease of the
cost).
"""

from collections.abc import Sequence

from lampest.cost.problem import Data
from lampest.solvers.solution import Status
from lampest.solvers.steps import STEPS

History = Sequence[tuple[float, float]]


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

    Neither of them then fell by the required amount.

    A stalled solve is one whose cost has stopped falling although its gradient has not vanished:
    the data and penalties leave a valley whose floor is flat, or a loss has corners that second
    derivatives do not show.

    Parameters
    ----------
    history : sequence of (cost, projected gradient)
        One pair for each iteration with the same smoothing.
    """
    if len(history) <= STEPS.window:
        return False
    first, steep = history[-STEPS.window - 1]
    last, residual = history[-1]
    return first - last < STEPS.min_decrease * abs(last) and residual > STEPS.min_reduction * steep
