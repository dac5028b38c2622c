"""What a film remembers of the loads that were recognised: a panel at rest is not what it was before them.

After a load a cell shows ln r/r0 = −c S, S = Σ_j s_j the creep of what it has answered (`lampest.loads.film.creep`). It
looks like the load, only weaker: what has risen in a mouth stays up a little, what has fallen under its rim stays down.
c is known to a common error, and each cell's S to one of its own, because a fit tells shapes and no single cell.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.film.creep import Creep
from lampest.loads.recognition.baseline import Baseline
from lampest.panel.panel import Array

OWN = 0.3  # of a cell's memory: films answer with a scatter of a tenth to a quarter, edges lie beside their places
FAINT = 2e-3  # of ln r/r0, that of a cell at rest apart from drift: less is not worth a new baseline
MOST = 3.0  # of ln r/r0 in a fit: beyond are open cells and dead shorts


@dataclass(frozen=True, eq=False)
class Remembered:
    """creep : of (rows, columns), with a strength of 1. seconds : since the baseline, of the last frame.

    before : (rows, columns) S when the baseline was taken; 0 where nothing had been there.
    """

    creep: Creep
    seconds: float = 0.0
    before: Array | float = 0.0

    @classmethod
    def nothing(cls, shape: tuple[int, ...]) -> "Remembered":
        """Before the first frame."""
        return cls(Creep.at_rest(np.ones(shape)))

    def after(self, change: Array, seconds: float) -> "Remembered":
        """Once a load has changed ln r by so much, (rows, columns), until so many seconds after the baseline."""
        answer = -np.clip(change, -MOST, MOST)
        return replace(self, creep=self.creep.after(answer, max(seconds - self.seconds, 0.0)), seconds=seconds)

    def against(self, then: "Remembered", seconds: float) -> "Remembered":
        """The same against a baseline that was taken so many seconds after this one, when the film was as `then`."""
        return replace(self, seconds=self.seconds - seconds, before=then._sum(seconds))

    def _sum(self, seconds: float) -> Array:
        """S (rows, columns) at a time since the baseline, if nothing comes until then."""
        nothing = np.zeros(self.creep.strength.shape)
        return self.creep.answer(nothing, max(seconds - self.seconds, 0.0))

    def rest(self, baseline: Baseline, seconds: float) -> Baseline:
        """The panel at rest so many seconds after the baseline; the baseline itself while nothing is remembered."""
        errors = baseline.model_errors
        crept = (self._sum(seconds) - self.before).ravel()
        if np.abs(crept).max() * np.hypot(errors.creep, errors.creep_sd) < FAINT:
            return baseline
        covariance, cells = baseline.covariance.copy(), crept.size
        own = OWN * np.hypot(errors.creep, errors.creep_sd) * crept
        covariance[:cells, :cells] += errors.creep_sd**2 * np.outer(crept, crept) + np.diag(own**2)
        remembered = errors.creep * crept.reshape(baseline.logarithm.shape)
        return replace(baseline, logarithm=baseline.logarithm - remembered, covariance=covariance)
