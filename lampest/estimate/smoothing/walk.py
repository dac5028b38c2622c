"""What cells are expected to do from frame to frame: they hardly walk, but some jump, by any amount.

Σ κ² S/(κ² + S) over cells and steps, S = K x²/q² the square of a cell's step x in units of the walk q, averaged with
the steps before and after by K: like x²/q² for small steps, and no more than κ² for any. A jump so costs what it costs,
however far it leads, and does not pull; and where a cell jumps now it may do so just before and after.
Source: Geman & McClure, Bull. Int. Stat. Inst. 52, 1987; Black & Rangarajan, Int. J. Comput. Vision 19, 1996.
"""

from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array


@dataclass(frozen=True)
class Walk:
    """deviation : q, of log r from frame to frame. most : κ, so many q a jump costs at most."""

    deviation: float
    most: float

    def cost(self, squares: Array) -> float:
        """Of the expected squares of all steps, (frames − 1, cells)."""
        size = averaged(squares) / self.deviation**2
        return float(np.sum(self.most**2 * size / (self.most**2 + size)))

    def stiffness(self, squares: Array) -> Array:
        """∂cost/∂squares, (frames − 1, cells): the λ of Σ λ x² that has the cost's slope here, and nowhere less."""
        size = averaged(squares) / self.deviation**2
        return averaged(1 / (1 + size / self.most**2) ** 2) / self.deviation**2


def averaged(steps: Array) -> Array:
    """K x: a quarter of the step before, a half of the step, a quarter of that after; at either end it is repeated."""
    around = np.concatenate([steps[:1], steps, steps[-1:]])
    return np.asarray(around[:-2] / 4 + around[1:-1] / 2 + around[2:] / 4)
