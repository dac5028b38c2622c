"""Absolute losses exactly: Σ w|x| where some residuals stay 0 and all others keep their sign.

With the rows K at their kink as equations, A = ∂x_K/∂u, and the slopes z of all others ±1, a Newton step is
s = Y p + N v, A Y p = −x, A N = 0, (NᵀHN) v = −Nᵀ(g + H Y p), z of K follows from what is left of the gradient.
Source: Nocedal & Wright, Numerical Optimization, 2006, section 18.1 (null-space step).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array
from lampest.solvers.hessian import Hessian, block_diagonal
from lampest.solvers.smoothing import Smoothing

INSIDE = 1e-3  # of 1, by which the dual of a row at its kink is less
AT_ZERO = 1e-9  # of log r, by which cells would have to move for a row to be at its kink; of a row, what others leave
PROJECTIONS = 50  # between |z| ≤ 1 and duals that balance the gradient, where rows depend on each other


@dataclass(frozen=True, eq=False)
class Unsmoothed(Smoothing):
    """Nothing rounded: slopes are the duals, and a kink has no curvature."""

    def slope(self, residual: Array) -> Array:
        return self.dual

    def stiffness(self, residual: Array) -> Array:
        return np.zeros_like(residual)

    def objective(self, at: Evaluation) -> float:
        return at.objective


@dataclass(frozen=True, eq=False)
class Kinks:
    """The rows at their kink, as equations over the free cells.

    rows : their numbers. length : |∂x/∂u|. across : Y (free cells, p), along : N (free cells, rest), orthonormal.
    trapezoid : T (p, rows) with (A/length)ᵀ = Y T. back : Y p.
    """

    rows: NDArray[np.intp]
    length: Array
    across: Array
    along: Array
    trapezoid: Array
    back: Array

    @classmethod
    def of(cls, hessian: Hessian, standing: NDArray[np.bool_], free: NDArray[np.intp]) -> "Kinks":
        """Those of `standing` (rows) that a free cell can move."""
        rows = np.flatnonzero(standing)
        slopes = derivatives(hessian, rows)
        whole, slopes = np.linalg.norm(slopes, axis=1), slopes[:, free]
        movable = np.linalg.norm(slopes, axis=1) > AT_ZERO * whole
        rows, slopes = rows[movable], slopes[movable]
        length = np.linalg.norm(slopes, axis=1)
        if not len(rows):
            return cls(rows, length, np.zeros((len(free), 0)), np.eye(len(free)), np.zeros((0, 0)), np.zeros(len(free)))
        unit = slopes / length[:, None]
        chosen = _independent(unit, hessian.at.cost.slope[rows])
        turn, upper = linalg.qr(unit[chosen].T, check_finite=False)
        rank = len(chosen)
        missing = (hessian.at.nonsmooth[rows] / length)[chosen]
        back = -turn[:, :rank] @ linalg.solve_triangular(upper[:rank], missing, trans="T")
        return cls(rows, length, turn[:, :rank], turn[:, rank:], turn[:, :rank].T @ unit.T, back)

    def balanced(self, dual: Array, pull: Array, slope: Array) -> Array:
        """(all rows) the duals; of K changed so that they balance the gradient across, |z| ≤ 1 where that can be.

        pull : (free cells) what is left of the gradient with the duals as they are. slope : w of all rows.
        """
        if not len(self.rows):
            return dual
        scale = slope[self.rows] * self.length
        found = dual[self.rows] * scale
        goal = self.trapezoid @ found - self.across.T @ pull
        turn, upper = np.linalg.qr(self.trapezoid.T)
        for count in range(PROJECTIONS):
            found = found + turn @ linalg.solve_triangular(upper, goal - self.trapezoid @ found, trans="T")
            inside = np.clip(found, -scale, scale)
            if len(goal) == len(found) or count == PROJECTIONS - 1 or np.array_equal(inside, found):
                break
            found = inside
        moved = dual.copy()
        moved[self.rows] = found / scale
        return moved


def _independent(unit: Array, weight: Array) -> NDArray[np.intp]:
    """Numbers of rows (rows, cells) of length one on which all others depend, the heaviest first."""
    chosen = np.zeros(0, dtype=np.intp)
    for heavy in sorted(set(weight), reverse=True):
        own = np.flatnonzero(weight == heavy)
        rest = unit[own]
        if len(chosen):
            basis = linalg.qr(unit[chosen].T, mode="economic", check_finite=False)[0]
            rest = rest - (rest @ basis) @ basis.T
        upper, order = linalg.qr(rest.T, mode="r", pivoting=True, check_finite=False)
        chosen = np.append(chosen, own[order[: int(np.sum(np.abs(np.diag(upper)) > AT_ZERO))]])
    return chosen


def derivatives(hessian: Hessian, rows: NDArray[np.intp]) -> Array:
    """∂x/∂u (rows, frames · cells) of some residuals with an absolute loss."""
    at = hessian.at
    cells = at.cell_resistance.ravel()
    by_both = hessian.smoothing.jacobian(at)[rows]
    direct = (by_both[:, : len(cells)] @ sparse.diags_array(cells)).toarray()
    through = sparse.csr_array(by_both[:, len(cells) :])
    if not through.nnz:
        return np.asarray(direct)
    return np.asarray(direct + through @ block_diagonal([network.sensitivity() for network in at.networks]))


def at_kink(at: Evaluation, dual: Array) -> NDArray[np.bool_]:
    """(rows) which residuals stand at their kink: their duals lie within ±1, or but a hair parts them from 0."""
    return np.asarray((np.abs(dual) < 1 - INSIDE) | (np.abs(at.nonsmooth) <= AT_ZERO * at.nonsmooth_reach))
