"""The inverse of what two frames' second derivatives look like where penalties know of their cells' ratios alone.

With the level l = x = y and the distance d = y − x of a cell in both, penalties are K(d) and what cells do to their own
readings is diagonal, a·x² + b·y² = (a + b)·l² + 2b·l·d + b·d². Levels are eliminated by a division, and what is
factored has as many unknowns as one frame: K + ab/(a + b). Penalties leave levels to the readings, which see rows and
columns of them a thousand times as strongly as cells; so a + b is inverted as one network sees it from afar. With a
division there a step took three to four times as many products.
Source: Golub & Van Loan, Matrix Computations, 2013, section 3.2 (Schur's complement).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.panel.conjugate import Linear
from lampest.panel.panel import Array
from lampest.solvers.newton.local import local_inverse

UNTIED = 1e-9  # of the largest entry of K: what is left of levels there is rounding
LEAST = 1e-12  # of the same: levels of which no reading tells


def pair_inverse(
    penalties: sparse.csr_array, own: Array, free: NDArray[np.bool_], level: Callable[[NDArray[np.bool_]], Linear]
) -> Linear:
    """(penalties + diag(own))⁻¹ over the free ones of both frames' cells (2·cells); sparse LU where penalties know of
    levels.

    Of a cell that is held in one frame the other's change is its distance. level : of the cells that are free in both,
    the inverse of what readings bend with levels (cells), zero elsewhere.
    """
    first, second = np.split(free, 2)
    both, largest = first & second, float(np.abs(penalties.diagonal()).max(initial=1e-300))
    left = (penalties[:, : len(both)] + penalties[:, len(both) :])[:, both]
    if np.abs(left.data).max(initial=0.0) > UNTIED * largest:
        return local_inverse(penalties, own, np.flatnonzero(free))
    above, below = np.split(own, 2)
    share = np.where(both, below / np.maximum(above + below, LEAST * largest), 0.0)
    lower, upper = np.where(first & ~second, -1.0, 0.0), np.where(second, 1.0, 0.0)
    ends = sparse.vstack([sparse.diags_array(lower), sparse.diags_array(upper)], format="csr")
    square = ends.T @ (penalties + sparse.diags_array(own)) @ ends - sparse.diags_array(share * below)
    between = local_inverse(sparse.csr_array(square), np.zeros(len(both)), np.flatnonzero(first | second))
    return _Levelled(free, level(both), share, lower, upper, between)


@dataclass(frozen=True, eq=False)
class _Levelled:
    """level : as above. share : b/(a + b) where both frames' cells are free, else 0. lower : −1 where only the first's
    is, upper : 1 where the second's is, else 0. between : the inverse over distances.
    """

    free: NDArray[np.bool_]
    level: Linear
    share: Array
    lower: Array
    upper: Array
    between: Linear

    def __call__(self, values: Array) -> Array:
        """Of values at the free cells."""
        whole, distance = np.zeros(len(self.free)), np.zeros(len(self.share))
        whole[self.free] = values
        first, second = np.split(whole, 2)
        both, either = self.free[: len(first)] & (self.upper > 0), self.lower + self.upper != 0
        together = np.where(both, first + second, 0.0)
        distance[either] = self.between((self.lower * first + self.upper * second - self.share * together)[either])
        level = self.level(together) - self.share * distance
        return np.concatenate([level + self.lower * distance, level + self.upper * distance])[self.free]
