"""A film before its next frame: pressure → answer and back, with all that it remembers.

    p_e = hysteresis(p),   u = ln f(p_w) − ln f(p_w + p_e),   −ln(r/r_rest) = β·creep(u)

f is the response curve, p_w the water that was there at rest, β the cell's gain κ times what bending leaves of it.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.film.creep import Creep
from lampest.loads.film.hysteresis import Plays
from lampest.loads.response import VACUUM_KPA, log_ratio_from_pressure, pressure_from_logarithm
from lampest.panel.panel import Array
from lampest.panel.response import Response


@dataclass(frozen=True, eq=False)
class FilmMemory:
    """plays, creep : where they stand. gain : β. water : p_w, kPa. All (...) cells, or to be broadcast to them.

    response : the scene's own curve; None: the published one.
    """

    plays: Plays
    creep: Creep
    gain: Array
    water: Array
    response: Response | None = None

    @classmethod
    def at_rest(
        cls, hysteresis: Array, creep_per_decade: Array, gain: Array, water: Array, response: Response | None = None
    ) -> "FilmMemory":
        """Before the first load, long in the water; all of one shape."""
        return cls(Plays.at_rest(hysteresis), Creep.at_rest(creep_per_decade), gain, water, response)

    def answered(self, pressure: Array, seconds: float) -> tuple["FilmMemory", Array]:
        """(the film afterwards, ln(r/r_rest)) of a pressure (...) kPa of a load that lasts for so long."""
        at_once = self._at_once(self.plays.effective(pressure))
        answer = self.gain * self.creep.answer(at_once, seconds)
        return self._after(pressure, at_once, seconds), -answer

    def pressure(self, change: Array, seconds: float) -> Array:
        """p (...) kPa of a load under which ln(r/r_rest) is `change` at the end of such an interval; ±∞ and NaN stay.

        Never below an empty space.
        """
        return self.plays.pressure(self._effective(change, seconds))

    def told(self, change: Array, seconds: float) -> "FilmMemory":
        """The film after an interval with ln(r/r_rest) = `change` at its end; a cell of NaN stands still."""
        known = np.isfinite(change)
        effective = self._effective(np.where(known, change, 0.0), seconds)
        pressure = self.plays.pressure(effective)
        after = self._after(pressure, self._at_once(effective), seconds)
        plays = replace(after.plays, held=np.where(known, after.plays.held, self.plays.held))
        creep = replace(after.creep, crept=np.where(known, after.creep.crept, self.creep.crept))
        return replace(self, plays=plays, creep=creep)

    def fading(self, seconds: float) -> Array:
        """ln(r/r_rest) (...) after an interval without load: what the film remembers of those before."""
        nothing = np.zeros(np.shape(self.creep.strength))
        return -self.gain * self.creep.answer(nothing, seconds)

    def _after(self, pressure: Array, at_once: Array, seconds: float) -> "FilmMemory":
        return replace(self, plays=self.plays.after(pressure), creep=self.creep.after(at_once, seconds))

    def _at_once(self, effective: Array) -> Array:
        return self._rest - log_ratio_from_pressure(self.water + effective, self.response)

    @property
    def _rest(self) -> Array:
        """ln f(p_w)."""
        return log_ratio_from_pressure(self.water, self.response)

    def at_once(self, change: Array, seconds: float) -> Array:
        """−ln(r/r_rest) (...) without what crept, at the end of such an interval."""
        return np.asarray(self.gain * self.creep.at_once(-change / self.gain, seconds))

    def _effective(self, change: Array, seconds: float) -> Array:
        at_once = self.creep.at_once(-change / self.gain, seconds)
        on_film = pressure_from_logarithm(self._rest - at_once, self.response)
        return np.asarray(np.maximum(on_film, VACUUM_KPA) - self.water)
