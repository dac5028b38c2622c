"""Termination of a solve that no longer makes progress.

A stalled solve is one whose cost has stopped falling although its gradient has not vanished: the data and penalties
leave a valley whose floor is flat, or a loss has corners that second derivatives do not show.
Source: Nocedal & Wright, Numerical Optimization, 2006, section 3.1 (stopping by the decrease of the cost).
"""

from dataclasses import dataclass

WINDOW = 20  # iterations over which progress is measured; well-posed frames end within 15
MIN_DECREASE = 1e-8  # of the cost over the window: a joint pair on a plateau still ends verified (test_random_problems)
MIN_REDUCTION = 0.1  # of the projected gradient over the window: a solve that still converges is not stopped


@dataclass(frozen=True)
class ProgressWindow:
    """Costs and projected gradients of the last iterations.

    Attributes
    ----------
    width : float
        Width of the smoothing of absolute losses. Another width is another cost, and begins anew.
    history : tuple of (cost, projected gradient)
        The newest last.
    """

    width: float = 0.0
    history: tuple[tuple[float, float], ...] = ()

    def after(self, width: float, cost: float, residual: float) -> "ProgressWindow":
        """Return the progress with one more iteration."""
        previous = self.history if width == self.width else ()
        return ProgressWindow(width, (*previous, (cost, residual))[-WINDOW - 1 :])

    @property
    def stalled(self) -> bool:
        """Whether neither cost nor gradient fell over the window."""
        if len(self.history) <= WINDOW:
            return False
        (first, steep), (last, residual) = self.history[0], self.history[-1]
        return first - last < MIN_DECREASE * abs(last) and residual > MIN_REDUCTION * steep
