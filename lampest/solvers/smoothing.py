"""Absolute losses as an interior-point method takes them: their duals z stay within |z| < 1.

Σ w |x| is the least Σ w t with t ± x ≥ 0. A barrier of parameter μ = w β, one for all rows, keeps
both slacks positive. With t eliminated, the loss is

    ψ(x) = t − β log(t/2β) − 2β,   t = β + √(β² + x²),   ψ'(x) = x/t

and with the duals as further unknowns, (1 − z²) x = 2β z, its second derivative is
(1 − z²)/(t + z x). After every step μ is a share of the mean complementarity, which is large while
duals are far from their residuals (`Iterate.sharpened`).
Source: Nocedal & Wright, Numerical Optimization, 2006, sections 16.6 and 19.2; Wächter & Biegler,
Math. Program. 106, 2006, equations (7) and (8) (μ and the share of the way to the boundary).
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array

MAX_SHARE = 0.1  # of the mean complementarity: μ of the next step
TO_BOUNDARY = 0.99  # least share of the way to the first dual that reaches ±1
LEVEL_SHARE = 1e-3  # of the cost: w β of all rows at a start whose residuals are all zero


@dataclass(frozen=True, eq=False)
class Smoothing:
    """Smoothing of absolute losses; without such losses all arrays are empty.

    Attributes
    ----------
    width : array or float
        β of each row, or of all rows, in the unit of the residuals.
    dual : array
        Duals z of the rows, |z| < 1.
    """

    width: Array | float
    dual: Array

    def _size(self, residual: Array) -> Array:
        """Return t = β + √(β² + x²)."""
        return self.width + np.sqrt(self.width**2 + residual**2)

    def slope(self, residual: Array) -> Array:
        """Return ψ'(x) = x/t."""
        return residual / self._size(residual)

    def stiffness(self, residual: Array) -> Array:
        """Return the second derivative (1 − z²)/(t + z x) with the duals as unknowns."""
        return (1 - self.dual**2) / (self._size(residual) + self.dual * residual)

    def objective(self, at: Evaluation) -> float:
        """Return φ with ψ(x) in place of |x|."""
        if not len(at.nonsmooth):
            return at.objective
        squares = at.nonsmooth**2
        # s = t − 2β = x²/(√(x² + β²) + β), without cancellation; ψ = s − β log(1 + s/2β)
        excess = squares / (np.sqrt(squares + self.width**2) + self.width)
        smoothed = excess - self.width * np.log1p(excess / (2 * self.width))
        return float(
            np.delete(at.costs, np.unique(at.cost.functions.nonsmooth_terms)).sum()
            + at.cost.slope @ smoothed
        )

    @classmethod
    def start(cls, at: Evaluation) -> "Smoothing":
        """Return the smoothing of a first point: z = 0, and μ a tenth of the mean w |x|/2."""
        slope = at.cost.slope
        level = MAX_SHARE * float(slope @ np.abs(at.nonsmooth)) / 2
        level = (level or LEVEL_SHARE * at.cost_scale) / max(len(slope), 1)
        return cls(level / np.where(slope > 0, slope, level), np.zeros(len(slope)))

    def moved(self, before: Evaluation, after: Evaluation, change: Array) -> "Smoothing":
        """Return the smoothing after a step δu of log r, with `change` ∂x/∂u·δu.

        The duals are from their linearised equation, all along the share of it that keeps every
        one within ±1: duals cut one by one misjudge how near the others are to their optimum.
        Residuals that changed by `change` up to rounding count as changed by that: between narrow
        corners the last bits of x are many digits of z.
        """
        if not len(self.dual):
            return self
        linear = before.nonsmooth + change
        rounding = before.last_bits + after.last_bits
        exact = np.abs(after.nonsmooth - linear) <= rounding
        reached = np.where(exact, linear, after.nonsmooth)
        # z⁺ = z + ((1 − z²) x⁺ − 2β z)/(t + z x)
        size = self._size(before.nonsmooth) + self.dual * before.nonsmooth
        of_dual = ((1 - self.dual**2) * reached - 2 * self.width * self.dual) / size
        room = np.where(of_dual > 0, 1 - self.dual, 1 + self.dual)
        reach = np.min(room / np.maximum(np.abs(of_dual), np.finfo(float).tiny))
        share = max(TO_BOUNDARY, 1 - self.level(before) / before.cost_scale)
        return replace(self, dual=self.dual + min(1.0, share * reach) * of_dual)

    def centred(self, at: Evaluation) -> "Smoothing":
        """Return the smoothing with the duals z = ψ'(x)."""
        return replace(self, dual=self.slope(at.nonsmooth))

    def complementarity(self, at: Evaluation) -> float:
        """Return the mean of (t − z x)/2β over the rows, 1 where the duals are ψ'(x)."""
        size = self._size(at.nonsmooth)
        return float(np.mean((size - self.dual * at.nonsmooth) / (2 * self.width)))

    def level(self, at: Evaluation) -> float:
        """Return w β summed over the rows, the duality gap where the duals are ψ'(x)."""
        return float(at.cost.slope @ self.width)
