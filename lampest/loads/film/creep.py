"""Creep: an answer that goes on growing with the logarithm of time, and fades the same way.

    a = u + c Σ_j s_j,   ds_j/dt = (u − s_j)/τ_j,   τ_j = 1, 10, … 10⁵ s

u is what the film answers at once, −ln r/r0; c is the creep per decade. One Kelvin-Voigt element in each decade makes
Σ_j (1 − e^{−t/τ_j}) = log10(t/1 s) + 0.74 to within 0.02 from a second to a day; by superposition a load that lay for T
leaves c u log10((T + t)/t) at a time t after it. What creeps within the first second belongs to the response curve.

ln r, because it is the gap between conducting grains that creeps, and tunnelling makes ln r linear in it. Sources:
Zhang et al., J. Polym. Sci. B 38, 2739 (2000), time dependence of piezoresistance of filled polymers; data sheets of
Interlink's FSR, logarithmic drift; Krejčí & Kuhnen, IEE Proc. Control Theory Appl. 148, 185 (2001), a row of
relaxations beside hysteresis, and the inverse of both.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.panel import Array

DECADES = 10.0 ** np.arange(6)


@dataclass(frozen=True, eq=False)
class Creep:
    """strength : (...) c, a fraction per decade. crept : (decades, ...) s_j."""

    strength: Array
    crept: Array

    @classmethod
    def at_rest(cls, strength: Array) -> "Creep":
        """Before the first load."""
        return cls(strength, np.zeros((len(DECADES), *np.shape(strength))))

    def after(self, at_once: Array, seconds: float) -> "Creep":
        """Once u (...) has lasted for so long."""
        return replace(self, crept=at_once + (self.crept - at_once) * self._kept(seconds))

    @property
    def memory(self) -> Array:
        """c Σ s_j, (...): what remains of −ln r/r0 at the moment when all load is gone."""
        return np.asarray(self.strength * self.crept.sum(axis=0))

    def answer(self, at_once: Array, seconds: float) -> Array:
        """a (...) at the end of an interval in which u lasts."""
        kept = self._kept(seconds)
        crept = (self.crept * kept).sum(axis=0) + at_once * (1 - kept).sum(axis=0)
        return np.asarray(at_once + self.strength * crept)

    def at_once(self, answer: Array, seconds: float) -> Array:
        """u (...) of an interval with a at its end: the inverse of `answer`."""
        kept = self._kept(seconds)
        left = self.strength * (self.crept * kept).sum(axis=0)
        return np.asarray((answer - left) / (1 + self.strength * (1 - kept).sum(axis=0)))

    def _kept(self, seconds: float) -> Array:
        return np.asarray(np.exp(-seconds / DECADES)).reshape(-1, *[1] * np.ndim(self.strength))
