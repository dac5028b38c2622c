"""Hold of a load on its cells, which shows whether it has left."""

from typing import NamedTuple

import numpy as np

from lampest.apps.recognition.suction import MIN_RISE
from lampest.files.levels import NOISE_REACH
from lampest.panel.panel import Array, Mask

# Of the square of a load's change, which a later recognition of it shows in the same place. A slide
# gives less, and a rim that begins to suck.
KEPT_SHARE = 0.8


class Hold(NamedTuple):
    """Change of the cells of one load.

    Attributes
    ----------
    change, sd : array, shape (rows, columns)
        ln r/r0 and its standard deviation; the change is 0 beside the load.
    """

    change: Array
    sd: Array

    @property
    def _clear(self) -> Mask:
        """Cells that have clearly changed, boolean (rows, columns)."""
        return np.abs(self.change) > NOISE_REACH * self.sd

    @property
    def risen(self) -> Mask:
        """Cells that clearly rose as under suction, boolean (rows, columns)."""
        return self._clear & (self.change > MIN_RISE)

    def followed_by(self, later: "Hold") -> "Hold":
        """Return the hold of the load when it was weakest in its place.

        Where a later recognition shows what the load changed before, that stays, whatever else has
        changed beside it. Cells that the later one does not show say nothing.
        """
        size = np.abs(self.change)
        counts = self._clear & (size > later.sd)
        shown = np.clip(later.change * np.sign(self.change), 0.0, size)
        kept = np.sum((shown * size)[counts]) >= KEPT_SHARE * np.sum(size[counts] ** 2)
        return self if kept and np.any(self._clear) else later

    def has_left(self, change: Array, sd: Array, reached: Array, residue: float) -> bool:
        """Return whether the cells show no more of the load than the film's residue.

        With the change h of the load, and the residue ρR of the largest change R of each cell, it
        has left if

            Σ |h| x sgn h ≤ Σ |h| min(NOISE_REACH ρR, (|h| + ρR)/2):

        the readings are nearer to the residue than to the load. Cells whose standard deviation is
        larger than h say nothing. If that holds for all of them, the load has not left.

        Parameters
        ----------
        change, sd : array, shape (rows, columns)
            x = ln r/r0 and its standard deviation.
        reached : array, shape (rows, columns)
            R, the largest |ln r/r0| since the load arrived.
        residue : float
            ρ, the standard deviation of the residue over R.
        """
        size = np.abs(self.change)
        residues = residue * np.maximum(reached, size)
        counts = self._clear & (size > sd)
        if np.any(self._clear) and not np.any(counts):
            return False
        most = np.minimum(NOISE_REACH * residues, (size + residues) / 2)
        return bool(np.sum((change * self.change)[counts]) <= np.sum((size * most)[counts]))
