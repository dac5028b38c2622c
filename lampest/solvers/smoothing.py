"""Smoothing of absolute losses for a Newton method.

Σ √(x² + β²) replaces Σ |x|, with the duals as further unknowns.

Source: Chan, Golub & Mulet, SIAM J. Sci. Comput. 20, 1999 (primal-dual method for total variation).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from lampest.cost.problem import Evaluation
from lampest.panel.compiled import with_entries
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Smoothing:
    """Smoothing of absolute losses.

    Without absolute losses all arrays are empty.

    Attributes
    ----------
    width : float
        β in the unit of the residuals.
    dual : array
        Duals z, |z| ≤ 1, one for each residual; they replace x/√(x² + β²) in second derivatives.
    """

    width: float
    dual: Array

    def slope(self, residual: Array) -> Array:
        """Return x/√(x² + β²), the derivative of the smoothed loss."""
        slope: Array = residual / np.sqrt(residual**2 + self.width**2)
        return slope

    def stiffness(self, residual: Array) -> Array:
        """Return (1 − z·x/√(x² + β²))/√(x² + β²), the second derivative of the smoothed loss.

        The derivative is that of a system with the duals z as further unknowns.
        """
        size = np.sqrt(residual**2 + self.width**2)
        stiffness: Array = (1 - self.dual * residual / size) / size
        return stiffness

    def objective(self, at: Evaluation) -> float:
        """Return φ with √(x² + β²) − β in place of |x|.

        The constant β is subtracted so that rows of large weight whose residual is zero cost no
        digits.
        """
        if not len(at.nonsmooth):
            return at.objective
        squares = at.nonsmooth**2
        # √(x² + β²) − β = x²/(√(x² + β²) + β), without cancellation
        smoothed = squares / (np.sqrt(squares + self.width**2) + self.width)
        return float(
            np.delete(at.costs, np.unique(at.cost.functions.nonsmooth_terms)).sum()
            + at.cost.slope @ smoothed
        )

    def jacobian(self, at: Evaluation) -> sparse.csc_array:
        """Return ∂x/∂(r; y), sparse (rows, 2·cells)."""
        function = at.cost.functions.nonsmooth_jacobian
        return with_entries(function.structure, at.call(function, self.dual))

    @classmethod
    def start(cls, at: Evaluation) -> "Smoothing":
        """Return the smoothing of a first point.

        β is a tenth of the largest residual, and z = x/√(x² + β²).
        """
        width = 0.1 * float(np.abs(at.nonsmooth).max(initial=0)) or 1.0
        return cls(width, at.nonsmooth / np.sqrt(at.nonsmooth**2 + width**2))

    def moved(self, before: Evaluation, after: Evaluation) -> "Smoothing":
        """Return the smoothing after a step.

        The duals are from their linearised equation, clipped to |z| ≤ 1.
        """
        if not len(self.dual):
            return self
        moves = [
            after.cell_resistance - before.cell_resistance,
            after.reading - before.reading,
        ]
        change = self.jacobian(before) @ np.concatenate([move.ravel() for move in moves])
        # z⁺ = x/√(x² + β²) + (1 − z·x/√(x² + β²))/√(x² + β²)·δx
        dual = self.slope(before.nonsmooth) + self.stiffness(before.nonsmooth) * change
        return Smoothing(self.width, np.clip(dual, -1, 1))
