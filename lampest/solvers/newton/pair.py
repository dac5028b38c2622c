"""Steps of two large frames that are solved together: straight in the first one's conductances 1/r₀ and in the ratios
q = r₁/r₀ of their cells.

A relative penalty is a square in q. In log r it bends down wherever q < 1/2, along as many directions as cells are
pressed, each of which ends a solve by conjugate gradients. How high both frames are it leaves to the readings, which
are nearly straight in 1/r₀: cells of which both frames come off arrive in a step or two. With s = ∂φ/∂log r, x =
−r₀·δ(1/r₀) and y = x + δq/q, the second derivatives in (x, y) are those in (log r₀, log r₁) and (s₀ + s₁)·x² − s₁·(y −
x)². Where one frame is held at a bound, the other's own 1/r₀ or r₁, of which q is a multiple, is what is straight.
Penalties that are convex in log r are squares of log q, and keep that.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.panel.conjugate import Linear
from lampest.panel.panel import Array
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.levels import pair_inverse

LEAST_SHARE = 0.1  # of q, to which a step may bring it
# Of log r, and of the cells: under a mouth over a third of a panel of 64 × 64 steps in conductances did not end,
# or, with 0.05, ended a quarter higher.
CHANGED, FEW = 0.5, 0.02
LEAST_OWN = 1e-12  # of the largest
LEAST_WEIGHT = 1e-6  # of the largest: readings that say nothing


@dataclass(frozen=True, eq=False)
class FramePair:
    """curvature : ∇²φ at both frames. free : (2·cells) which of r₀, r₁ move. Vectors are flat (2·cells), of log r."""

    curvature: Curvature
    free: NDArray[np.bool_]

    def product(self, step: Array) -> Array:
        """Second derivatives times a step."""
        return np.asarray(self.curvature.product(step) + self._tied @ step)

    def squares(self, step: Array) -> Array:
        """The same of penalties and of the readings' squares, JᵀWJ; they do not bend down."""
        shape = self.curvature.at.cell_resistance.shape
        forward = self._weight.reshape(shape) * self.curvature.forward(step)
        return np.asarray(self._penalties @ step + self.curvature.adjoint(forward))

    @cached_property
    def own(self) -> Array:
        """What a cell's own reading bends."""
        response = np.stack([network.own_response() for network in self.curvature.at.networks]).ravel()
        return np.asarray(self._weight * response**2)

    @cached_property
    def alike(self) -> bool:
        """Whether few cells differ between both frames; else levels are straight in log r₀, as cells come and go."""
        first, second = np.log(self.curvature.at.cell_resistance)
        return bool(np.mean(np.abs(second - first) > CHANGED) <= FEW)

    @cached_property
    def size(self) -> Array:
        """The diagonal of what stands in for both."""
        return np.asarray(self._penalties.diagonal() + self.own)

    def inverse(self, shift: Array) -> Linear:
        """Of penalties and `own`, of J only what a cell does to its own reading, with a shift of the diagonal; over the
        free cells. Levels are inverted as lines see them, too.
        """
        shape, (above, below) = self.curvature.at.cell_resistance.shape[1:], np.split(shift, 2)

        def level(both: NDArray[np.bool_]) -> Linear:
            if not self.alike:
                own = np.maximum(np.add(*np.split(self.own + shift, 2)), LEAST_OWN * self.size.max())
                return lambda values: np.where(both, values / own, 0.0)
            weight = np.add(*np.split(self._weight, 2))
            weight = np.maximum(weight, LEAST_WEIGHT * weight.max(initial=1e-300))
            lines = self.curvature.at.networks[0].normal_inverse(
                weight.reshape(shape), (above + below).reshape(shape), both.reshape(shape)
            )
            return lambda values: lines(values.reshape(shape)).ravel()

        return pair_inverse(self._penalties, self.own + shift, self.free, level)

    def change(self, step: Array) -> Array:
        """Of log r, for such a step, which is zero at cells that are held."""
        first, second = np.split(step, 2)
        logarithm = self._moving[1] & (not self.alike)
        level, apart = np.where(logarithm, first, -_log_of(1 - first)), second - first
        ratio = _log_of(1 + apart) if self._in_ratios else apart
        return np.concatenate([level, np.where(self._moving[1], level + ratio, 0.0)])

    @property
    def _in_ratios(self) -> bool:
        """Whether a penalty is a square of ratios; others are squares of their logarithms."""
        comparing = [term for term in self.curvature.at.cost.terms if term.needs_previous]
        return not all(term.convex_in_log for term in comparing)

    @property
    def _moving(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(cells) of either frame, whether they move."""
        first, second = np.split(self.free, 2)
        return first, second

    @cached_property
    def _tied(self) -> sparse.csr_array:
        return self._bends(self.curvature.gradient)

    @cached_property
    def _weight(self) -> Array:
        """W of the readings, nowhere negative."""
        terms = self.curvature.terms.diagonal()
        return np.asarray(np.maximum(terms[len(terms) // 2 :], 0.0))

    @cached_property
    def _penalties(self) -> sparse.csr_array:
        """Second derivatives of what terms say of the cells alone."""
        curvature = self.curvature
        count = len(curvature.direct)
        cells = sparse.diags_array(curvature.at.cell_resistance.ravel())
        direct = cells @ curvature.terms[:count, :count] @ cells + sparse.diags_array(curvature.direct)
        return sparse.csr_array(direct + self._bends(curvature.direct))

    def _bends(self, slope: Array) -> sparse.csr_array:
        """What second derivatives in log r lack, for the slope in log r."""
        moving = self._moving
        first, second = (np.where(moves, part, 0.0) for moves, part in zip(moving, np.split(slope, 2), strict=True))
        if not self.alike:
            first = first - np.where(moving[0] & moving[1], first + second, 0.0)
        both = moving[0] * second
        if not self._in_ratios:
            return sparse.csr_array(sparse.diags_array(np.concatenate([first + both, np.zeros_like(second)])))
        tied = sparse.diags_array(both)
        rows = [[sparse.diags_array(first), tied], [tied, sparse.diags_array(-second)]]
        return sparse.csr_array(sparse.block_array(rows))


def _log_of(ratio: Array) -> Array:
    return np.asarray(np.log(np.maximum(ratio, LEAST_SHARE)))
