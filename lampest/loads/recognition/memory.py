"""What a film remembers of the loads that were recognised: a panel at rest is not what it was before them.

After a load a cell shows ln r/r0 = −c S − k P. S = Σ_j s_j is the creep of what it has answered (see
`lampest.loads.film.creep`); P is the largest answer of late, which some films keep a part of, for minutes, however long
the load was there. Both look like the load, only weaker: what has risen in a mouth stays up a little, what has fallen
under its rim stays down. c and k are known to a common error each, and each cell's memory to one of its own, because a
fit tells shapes and no single cell.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.film.creep import Creep
from lampest.loads.recognition.baseline import Baseline
from lampest.panel.panel import Array

OWN = 0.3  # of a cell's memory: films answer with a scatter of a tenth to a quarter, edges lie beside their places
FAINT = 2e-3  # of ln r/r0, that of a cell at rest apart from drift: less is not worth a new baseline
MOST = 3.0  # of ln r/r0 in a fit: beyond are open cells and dead shorts
TAKEN, KEPT = 3.0, 600.0  # s in which P follows an answer that grows, and fades to one that is less; assumptions


@dataclass(frozen=True, eq=False)
class Remembered:
    """creep : of (rows, columns), with a strength of 1. held : P (rows, columns).

    seconds : since the baseline, of the last frame. before : (2, rows, columns) S and P when the baseline was taken; 0
    where nothing had been there.
    """

    creep: Creep
    held: Array
    seconds: float = 0.0
    before: Array | float = 0.0

    @classmethod
    def nothing(cls, shape: tuple[int, ...]) -> "Remembered":
        """Before the first frame."""
        return cls(Creep.at_rest(np.ones(shape)), np.zeros(shape))

    def after(self, change: Array, seconds: float) -> "Remembered":
        """Once a load has changed ln r by so much, (rows, columns), until so many seconds after the baseline."""
        answer, lasted = -np.clip(change, -MOST, MOST), max(seconds - self.seconds, 0.0)
        kept = np.exp(-lasted / np.where(np.abs(answer) > np.abs(self.held), TAKEN, KEPT))
        held = answer + (self.held - answer) * kept
        return replace(self, creep=self.creep.after(answer, lasted), held=held, seconds=seconds)

    def against(self, then: "Remembered", seconds: float) -> "Remembered":
        """The same against a baseline that was taken so many seconds after this one, when the film was as `then`."""
        return replace(self, seconds=self.seconds - seconds, before=then.patterns(seconds))

    def patterns(self, seconds: float) -> Array:
        """S and P, (2, rows, columns), at a time since the baseline, if nothing comes until then."""
        nothing, lasts = np.zeros(self.held.shape), max(seconds - self.seconds, 0.0)
        return np.stack([self.creep.answer(nothing, lasts), self.held * np.exp(-lasts / KEPT)])

    def rest(self, baseline: Baseline, seconds: float) -> Baseline:
        """The panel at rest so many seconds after the baseline; the baseline itself while nothing is remembered."""
        errors, shape = baseline.model_errors, baseline.logarithm.shape
        patterns = (self.patterns(seconds) - self.before).reshape(2, -1)
        common = np.array([errors.creep_sd, errors.remanence_sd])
        size = np.hypot([errors.creep, 0.0], common)
        if np.abs(size @ np.abs(patterns)).max() < FAINT:
            return baseline
        covariance, cells = baseline.covariance.copy(), patterns.shape[1]
        spread = common[:, None] * patterns
        own = OWN * size[:, None] * patterns
        covariance[:cells, :cells] += spread.T @ spread + np.diag((own**2).sum(axis=0))
        remembered = errors.creep * patterns[0].reshape(shape)
        return replace(baseline, logarithm=baseline.logarithm - remembered, covariance=covariance)
