"""What is known of a film's strengths, and what a recording tells of those that its scene leaves open."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.film.creep import Creep
from lampest.loads.film.memory import FilmMemory
from lampest.loads.response import gains_of
from lampest.panel.film import MOST_CREEP, Film, Strength
from lampest.panel.panel import Array
from lampest.panel.response import Response

# Strengths that are tried: as dense as their posteriors are narrow.
CREEPS = MOST_CREEP * np.linspace(0, 1, 81) ** 2
# Of ln r/r0 of a cell that nothing touches, beside the estimate's own error: at once, and for each minute (drift).
SETTLED, DRIFT = 0.005, 0.01
# How exactly a cell's memory follows from what it has shown: peaks fall between frames; and where cells may differ.
OWN, ALIKE = 0.05, 0.2
# The other explanation, that something still presses: as likely beforehand, and ln r/r0 anywhere within so much.
RANGE = 4.0
# Errors of a cell stay from frame to frame: all its frames count as so many.
INDEPENDENT = 3.0
SOONEST = 1e-3  # s between frames of which the clock says nothing
MOST_ANSWER = 6.0  # of ln r/r0: beyond are open cells


@dataclass(frozen=True)
class FilmKnown:
    """hysteresis, creep : strengths of a cell. film : what the scene says. sentence : where they come from; ''.

    cells : (rows, columns) the creep of each cell and its deviation, where the recording has told it; else None.
    """

    film: Film
    hysteresis: Strength
    creep: Strength
    sentence: str = ""
    cells: tuple[Array, Array] | None = None

    @classmethod
    def told(cls, film: Film) -> "FilmKnown":
        """By the scene; what it leaves open as is usual."""
        found = cls(film, film.told_hysteresis, film.told_creep)
        return replace(found, sentence=found._said("assumed"))

    def memories(self, water: Array, response: Response | None = None) -> tuple[FilmMemory, ...]:
        """Films at rest in p_w (rows, columns) kPa: the mean one, then one with each strength by its deviation more."""
        gap, gain = (
            np.full(water.shape, self.hysteresis.mean),
            np.broadcast_to(self.film.answer * gains_of(response), water.shape),
        )
        creep, creep_sd = self.cells or (np.full(water.shape, strength) for strength in self.creep)
        pairs = [(gap, creep)]
        if self.hysteresis.sd:
            pairs.append((gap + self.hysteresis.sd, creep))
        if self.creep.sd:
            pairs.append((gap, creep + creep_sd))
        return tuple(FilmMemory.at_rest(*pair, gain, water, response) for pair in pairs)

    def estimated(self, change: Array, sd: Array, time: Array) -> "FilmKnown":
        """With the creep that makes cells be at rest, or clearly not, after what they have shown; if it is open.

        Where cells differ, each has its own: that of all beforehand, and what its own frames say.

        Where a load is gone, what a cell still shows is c Σ s_j and nothing else. P(c) ∝ P(c) beforehand ·
        Π [½ N(u; 0, σ) + ½/RANGE] over frames and cells, u what is left of ln r/r_rest without the memory. A recording
        in which nothing was released says nothing: then what is usual stands.

        change, sd : (frames, rows, columns) ln(r/r_rest) and its standard deviation; NaN where a frame failed.
        time : (frames) s.
        """
        if self.film.creep_per_decade != "auto":
            return self
        usual = self.film.told_creep
        each = _likelihood(self.film.answer, change, sd, time, ALIKE)
        mean, shared = (float(number) for number in _moments(each.sum(axis=(1, 2)) - CREEPS / usual.mean))
        spread = float(np.hypot(shared, mean * self.film.cell_spread))
        found = replace(self, creep=Strength(mean, spread))
        if spread > shared:
            own = _likelihood(self.film.answer, change, sd, time, OWN)
            found = replace(found, cells=_moments(own - 0.5 * ((CREEPS[:, None, None] - mean) / spread) ** 2))
        return replace(found, sentence=found._said("assumed" if shared > 0.8 * usual.sd else "from the recording"))

    def _said(self, creep_from: str) -> str:
        parts = []
        if self.film.hysteresis == "auto":
            parts.append(f"hysteresis {100 * self.hysteresis.mean:.0f} +- {100 * self.hysteresis.sd:.0f} %, assumed")
        if self.film.creep_per_decade == "auto":
            mean, sd = (100 * number for number in self.creep)
            parts.append(f"creep {mean:.1f} +- {sd:.1f} % for each decade, {creep_from}")
        return "; ".join(parts)


def _moments(logarithm: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of c, (...), whose ln P at CREEPS are (strengths, ...)."""
    wide = np.gradient(CREEPS).reshape(-1, *[1] * (logarithm.ndim - 1))
    weight = np.exp(logarithm - logarithm.max(axis=0)) * wide
    weight = weight / weight.sum(axis=0)
    mean = np.tensordot(CREEPS, weight, 1)
    return mean, np.sqrt(np.maximum(np.tensordot(CREEPS**2, weight, 1) - mean**2, 0.0))


def _likelihood(gain: float, change: Array, sd: Array, time: Array, own: float) -> Array:
    """ln P(frames of a cell | c) for every c of CREEPS, up to what all share, (strengths, rows, columns).

    own : by which part its memory may differ from what it has shown.
    """
    shape, last = (len(CREEPS), *change.shape[1:]), float(time[0])
    creep = Creep.at_rest(np.broadcast_to(CREEPS[:, None, None], shape))
    total, resting = np.zeros(shape), np.zeros(shape)
    for frame, error, now in zip(change, sd, time, strict=True):
        seconds, known = max(float(now) - last, SOONEST), np.isfinite(frame) & np.isfinite(error)
        if not known.any():
            continue
        fading = creep.answer(np.zeros(shape), seconds)
        answer = np.where(known, np.clip(-frame / gain, -MOST_ANSWER, MOST_ANSWER), fading)
        drift = np.hypot(SETTLED, DRIFT * (now - time[0]) / 60)
        spread = np.sqrt((np.where(known, error, 0.0) / gain) ** 2 + drift**2 + (own * fading) ** 2)
        rest = np.exp(-0.5 * ((answer - fading) / spread) ** 2) / (np.sqrt(2 * np.pi) * spread)
        total += np.where(known, np.log((rest + 1 / RANGE) / 2), 0.0)
        resting += np.where(known, rest / (rest + 1 / RANGE), 0.0)
        creep, last = creep.after(creep.at_once(answer, seconds), seconds), float(now)
    weight = INDEPENDENT / np.maximum(resting.max(axis=0), INDEPENDENT)
    return np.asarray(total * weight)
