"""Steps of two large frames that are solved together: straight in the ratios q = r₁/r₀ of their cells.

A relative penalty is a square in q. In log r it bends down wherever q < 1/2, along as many directions as cells are
pressed, each of which ends a solve by conjugate gradients. With p = δr₁/r₁ − δr₀/r₀ = δq/q, the second derivatives in
(log r₀, q) are those in (log r₀, log r₁) less ∂φ/∂log r₁·p². A cell of which one frame is held at a bound has no ratio
to change: r₁ is straight then, or 1/r₀, of which q is a multiple too.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.panel.panel import Array
from lampest.solvers.newton.curvature import Curvature

LEAST_SHARE = 0.1  # of q, to which a step may bring it


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
    def local(self) -> sparse.csr_array:
        """A sparse stand-in for both: of J only what a cell does to its own reading."""
        response = np.stack([network.own_response() for network in self.curvature.at.networks]).ravel()
        return sparse.csr_array(self._penalties + sparse.diags_array(self._weight * response**2))

    def change(self, step: Array) -> Array:
        """Of log r, for such a step."""
        if not self._in_ratios:
            return step
        first, second = np.split(step, 2)
        both, only_first, only_second = self._kinds
        moved = np.where(both, first + _log_of(1 + second - first), np.where(only_second, _log_of(1 + second), second))
        return np.concatenate([np.where(only_first, -_log_of(1 - first), first), moved])

    @property
    def _in_ratios(self) -> bool:
        """Whether a penalty is a square of ratios; others are squares of their logarithms."""
        comparing = [term for term in self.curvature.at.cost.terms if term.needs_previous]
        return not all(term.convex_in_log for term in comparing)

    @cached_property
    def _kinds(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        first, second = np.split(self.free, 2)
        return first & second, first & ~second, second & ~first

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
        first, second = np.split(slope if self._in_ratios else np.zeros_like(slope), 2)
        both, only_first, only_second = self._kinds
        tie = np.where(both, -second, 0.0)
        own = tie + np.where(only_first, first, 0.0), tie + np.where(only_second, -second, 0.0)
        return sparse.csr_array(
            sparse.block_array(
                [
                    [sparse.diags_array(own[0]), sparse.diags_array(-tie)],
                    [sparse.diags_array(-tie), sparse.diags_array(own[1])],
                ]
            )
        )


def _log_of(ratio: Array) -> Array:
    return np.asarray(np.log(np.maximum(ratio, LEAST_SHARE)))
