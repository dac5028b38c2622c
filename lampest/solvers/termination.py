"""Termination of a solve that no longer makes progress.

A stalled solve is one whose cost has stopped falling although its gradient has not vanished: the data and penalties
leave a valley whose floor is flat, or a loss has corners that second derivatives do not show.
Source: Nocedal & Wright, Numerical Optimization, 2006, section 3.1 (stopping by the decrease of the cost).
"""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class ProgressWindow:
    """Costs and projected gradients of the last iterations.

    Attributes
    ----------
    width : float
        Width of the smoothing of absolute losses. The window begins anew when it changes, because the cost does.
    history : tuple of (cost, projected gradient)
        The newest last.
    iterations : int
        Length of the window; well-posed frames end within 15 iterations.
    min_decrease : float
        Relative decrease of the cost over the window. A joint pair on a plateau falls by more and still ends verified
        (test_random_problems).
    min_reduction : float
        Share of the projected gradient at the window's begin below which the solve still converges.
    """

    width: float = 0.0
    history: tuple[tuple[float, float], ...] = ()
    iterations: int = 20
    min_decrease: float = 1e-8
    min_reduction: float = 0.1

    def after(self, width: float, cost: float, residual: float) -> "ProgressWindow":
        """Return the window after one more iteration."""
        previous = self.history if width == self.width else ()
        history = (*previous, (cost, residual))[-self.iterations - 1 :]
        return replace(self, width=width, history=history)

    @property
    def stalled(self) -> bool:
        """Whether neither cost nor projected gradient fell by the required amount over a full window."""
        if len(self.history) <= self.iterations:
            return False
        (first, steep), (last, residual) = self.history[0], self.history[-1]
        return first - last < self.min_decrease * abs(last) and residual > self.min_reduction * steep
