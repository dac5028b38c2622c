"""Where all cells go while one of them, of which no reading of its own tells, goes from end to end of what is likely.

Data and penalties leave it a valley, and that bends: a tangent leads up its sides. It is followed in short steps,

    δ = −A⁻¹ ∇φ/2 + λ A⁻¹ e_c,   λ such that cell c goes on by one step,

Gauss and Newton's step with c held, A = Jᵀ Ω J + Zᵀ Ω Z anew at every step (see `lampest.posterior.dense`). The way
ends where φ has risen by 1.96² s² C, as it would have where the tangent ends if φ were a parabola.
Source: Allgower & Georg, Introduction to Numerical Continuation Methods, 2003, chapter 2.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.panel import Array
from lampest.posterior.dense import DenseErrors
from lampest.posterior.interval import TWO_SIDED

STEPS = 3  # of the tangent's length: the way ends within a tenth of an optimum with the cell held
LONGEST = 0.5  # of log r, that of one step
FARTHEST = 3.0  # tangents: a penalty in ohm rises slowly towards a short
MOST_STEPS = 20  # which reach a factor of 20,000: where nothing tells of the cell, its tangent has no end


@dataclass(frozen=True, eq=False)
class Along:
    """errors : of the estimate, at which the cell is one of the free ones. cell : its number."""

    errors: DenseErrors
    cell: int

    @property
    def _place(self) -> int:
        return int(np.searchsorted(self.errors.model.free, self.cell))

    @property
    def tangent(self) -> Array:
        """(frames · cells) of log r, to the end of the cell's interval."""
        column, change = self.errors.inverse[:, self._place], np.zeros(self.errors.model.at.cell_resistance.size)
        far = TWO_SIDED * np.sqrt(self.errors.variance[self._place])
        change[self.errors.model.free] = column / column[self._place] * far
        return change

    def end(self, side: int) -> Array:
        """(frames · cells) where log r goes at the lower (−1) or upper (1) end."""
        model, place = self.errors.model, self._place
        most = TWO_SIDED**2 * self.errors.variance[place] / self.errors.inverse[place, place]
        far = self.tangent[self.cell]
        step, risen, before = side * min(far / STEPS, LONGEST), 0.0, 0.0
        ended = model.at.position
        for position, force in self._places(step, round(min(FARTHEST * far / abs(step), MOST_STEPS))):
            ended, risen, before = position, risen + step * (before + force), force
            if risen >= most:
                break
        return np.asarray((ended - model.at.position).ravel())

    def _places(self, step: float, most: int) -> Iterator[tuple[Array, float]]:
        """(log r (frames, rows, columns), λ) one step after the other; until a bound holds the cell."""
        errors = self.errors
        for _ in range(most):
            model = errors.model
            if self.cell not in model.free:
                return
            place = int(np.searchsorted(model.free, self.cell))
            newton, column = -errors.inverse @ model.gradient[model.free] / 2, errors.inverse[:, place]
            force = (step - newton[place]) / column[place]
            change = np.zeros(model.at.position.size)
            change[model.free] = newton + force * column
            change *= min(1.0, 2 * LONGEST / float(np.abs(change).max()))
            position = model.at.position + change.reshape(model.at.position.shape)
            position = np.clip(position, *model.at.data.log_bounds)
            yield position, float(force)
            errors = DenseErrors(replace(model, at=model.at.elsewhere(np.exp(position))))
