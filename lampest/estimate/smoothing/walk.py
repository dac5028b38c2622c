"""What cells are expected to do from frame to frame: most stand still, some never do, and any may jump.

    n k Σ_i log(1 + a_i) + Σ x²/LEAP²,   a_i the mean over the n steps of cell i of κ² S/(κ² + S)

S = K x²/q² is the square of a step x in units of the walk q, averaged with the steps before and after by K. What a step
costs grows like x²/q² at first, and hardly beyond κ²: a jump costs what it costs, however far it leads, and hardly
pulls; where a cell jumps now it may do so just before and after. What a cell costs grows like the logarithm of that: of
one whose steps are all a little larger than noise each is taken for a step. k is such that a cell whose steps are as
large as the walk is tied by 1/q².
Source: Geman & McClure, Bull. Int. Stat. Inst. 52, 1987; Black & Rangarajan, Int. J. Comput. Vision 19, 1996; of sums
in a logarithm: Candès, Wakin & Boyd, J. Fourier Anal. Appl. 14, 2008.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.panel import Array

LEAP = 1.0  # of log r: how far jumps lead; what no reading tells strays no farther
FAST, SLOW = 0.6, 0.8  # from one walk to the next; slowly where the ties make a step's variance, which then must follow
TIED = 0.5  # of q²: the median of squared steps of still cells from where on that is so
FOLLOWED = 1.5  # the same, where ties have followed the walk


@dataclass(frozen=True)
class Walk:
    """deviation : q, of log r from frame to frame. most : κ, so many q a jump costs at most."""

    deviation: float
    most: float

    def cost(self, squares: Array) -> float:
        """Of the expected squares of all steps, (frames − 1, cells)."""
        jumps = len(squares) * self._scale * np.sum(np.log1p(self.unrest(squares)))
        return float(jumps + np.sum(squares) / LEAP**2)

    def stiffness(self, squares: Array) -> Array:
        """∂cost/∂squares, (frames − 1, cells): the λ of Σ λ x² that has the cost's slope here, and nowhere less."""
        slope = averaged(1 / (1 + self._size(squares) / self.most**2) ** 2) / self.deviation**2
        return np.asarray(self._scale * slope / (1 + self.unrest(squares)) + LEAP**-2)

    def unrest(self, squares: Array) -> Array:
        """a, (cells)."""
        size = self._size(squares)
        return np.asarray(np.mean(self.most**2 * size / (self.most**2 + size), axis=0))

    def drawn_down(self, squares: Array, stiffness: Array, least: float) -> tuple["Walk", float]:
        """(the next walk, how far it may go on), never beyond `least`: until still cells step further than it says.

        Still is the half of the cells with the least unrest. stiffness : that the squares were found with. A cell's
        likeliest walk is where λ E x² is 1 in the mean.
        """
        unrest = self.unrest(squares)
        still = unrest <= np.median(unrest)
        if np.mean((stiffness * squares)[:, still]) > 1:
            least = self.deviation
        size = np.median(squares[:, still]) / self.deviation**2
        factor = 1.0 if size > FOLLOWED else SLOW if size > TIED else FAST
        return replace(self, deviation=max(self.deviation * factor, least)), least

    @property
    def _scale(self) -> float:
        """k."""
        return (1 + self.most**2 / (1 + self.most**2)) * (1 + self.most**-2) ** 2

    def _size(self, squares: Array) -> Array:
        """S."""
        return averaged(squares) / self.deviation**2


def averaged(steps: Array) -> Array:
    """K x: a quarter of the step before, a half of the step, a quarter of that after; at either end it is repeated."""
    around = np.concatenate([steps[:1], steps, steps[-1:]])
    return np.asarray(around[:-2] / 4 + around[1:-1] / 2 + around[2:] / 4)
