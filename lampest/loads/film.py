"""Memory of a film: hysteresis and creep as operators over the frames, forwards and backwards.

    p_e = hysteresis(p),   u = ln f(p_w) − ln f(p_w + p_e),   −ln(r/r_rest) = β·creep(u)

f is the response curve, p_w the water that was there at rest, β the cell's gain κ times the share that bending leaves.

Hysteresis: loading follows the response curve, unloading lags behind it, and a load that is gone leaves nothing.

    p_e = w_0 p + Σ w_i z_i,   z_i held between p and b_i p

A generalised Prandtl-Ishlinskii operator: plays z_i whose two branches are the lines p and b_i p, b_i > 1. It forgets
all where the load crosses zero. Its inverse is exact: p_e is strictly monotone and piecewise linear in p, w_0 > 0. From
a peak P the film unloads along the hyperbola
p_e/P = s²t/(1 + (s² − 1)t), t = p/P, with s = (1 + η)/(1 − η); its largest gap from the line is η, at t = 1/(1 + s).
Sources: Al Janaideh, Rakheja, Su, IEEE/ASME Trans. Mechatron. 16, 734 (2011), the operator and its inverse; Kuhnen,
Eur. J. Control 9, 407 (2003); for tactile films Sánchez-Durán et al., Sensors 15, 26170 (2015).

Creep: an answer that goes on growing with the logarithm of time, and fades the same way.

    a = u + c Σ_j s_j,   ds_j/dt = (u − s_j)/τ_j,   τ_j = 1, 10, … 10⁵ s

u is the film's instantaneous answer; c is the creep per decade. One Kelvin-Voigt element in each decade makes
Σ_j (1 − e^{−t/τ_j}) = log10(t/1 s) + 0.74 to within 0.02 from a second to a day; a load that lay for T leaves
c u log10((T + t)/t) at a time t after it. Creep within the first second belongs to the response curve. It is in
ln r because tunnelling makes ln r linear in the gap between conducting grains, and the gap creeps.
Sources: Zhang et al., J. Polym. Sci. B 38, 2739 (2000); data sheets of Interlink's FSR; Krejčí & Kuhnen, IEE Proc.
Control Theory Appl. 148, 185 (2001), a row of relaxations beside hysteresis, and the inverse of both.
"""

from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.response import PUBLISHED, VACUUM_KPA, Film, Response, Strength

# Where the hyperbola is cut into lines: ln(s t/(1 − t)), 0 at the largest gap. The lines miss it by 0.4 % of the peak.
CUTS = np.linspace(-2.6, 2.6, 11)
DECADES = 10.0 ** np.arange(6)  # τ_j, s
# Strengths of creep that `FilmKnown.estimated` compares, per decade: as dense as their posteriors are narrow.
CREEPS = Film.most["creep_per_decade"] * np.linspace(0, 1, 81) ** 2
# Of the largest ln r/r0 of a cell, the residue once the load is gone that does not fade: shares that are compared.
RESIDUES = 0.25 * np.linspace(0, 1, 26) ** 2
MIN_PERIOD = 1e-3  # s between frames whose times do not increase


@dataclass(frozen=True, eq=False)
class Plays:
    """Hysteresis as a sum of plays.

    Attributes
    ----------
    weight : array
        (1 + plays, ...) of p and of the plays.
    reach : array
        (plays, ...) b_i.
    held : array
        (plays, ...) z_i, kPa.
    """

    weight: Array
    reach: Array
    held: Array

    @classmethod
    def at_rest(cls, hysteresis: Array) -> "Plays":
        """Return the state before the first load of cells with their largest gap each, any shape."""
        steep = (1 + hysteresis) / (1 - hysteresis)
        cut = CUTS.reshape(-1, *[1] * np.ndim(hysteresis))
        below, above = 1 / (1 + steep * np.exp(-cut)), 1 / (1 + np.exp(-cut) / steep)
        nothing, whole = np.zeros((1, *np.shape(hysteresis))), np.ones((1, *np.shape(hysteresis)))
        rise, run = (np.diff(np.concatenate([nothing, part, whole]), axis=0) for part in (above, below))
        slopes = rise / run
        weight = np.concatenate([slopes[-1:], -np.diff(slopes, axis=0) * below])
        return cls(weight, 1 / below, np.zeros_like(below))

    def after(self, pressure: Array) -> "Plays":
        """Return the plays once the pressure (...) kPa has come, monotonously."""
        far = self.reach * pressure
        return replace(self, held=np.clip(self.held, np.minimum(pressure, far), np.maximum(pressure, far)))

    def effective(self, pressure: Array) -> Array:
        """p_e (...) kPa were the pressure the next."""
        return np.asarray(self.weight[0] * pressure + (self.weight[1:] * self.after(pressure).held).sum(axis=0))

    def pressure(self, effective: Array) -> Array:
        """p (...) kPa of the next p_e: the inverse of `effective`. ±∞ and NaN stay."""
        if not self.weight[1:].any():  # no hysteresis, which most films are taken for
            return np.asarray(effective / self.weight[0])
        corners = np.sort(np.concatenate([self.held, self.held / self.reach, np.zeros_like(self.held[:1])]), axis=0)
        # Beyond all corners every play rests on the line p itself.
        corners = np.concatenate([corners[:1] - 1, corners, corners[-1:] + 1])
        each = Plays(self.weight[:, None], self.reach[:, None], self.held[:, None])
        reached = each.effective(corners)
        below = np.clip((reached <= effective).sum(axis=0) - 1, 0, len(corners) - 2)
        start, end, low, high = (
            np.take_along_axis(values, below[None] + step, axis=0)[0]
            for values in (corners, reached)
            for step in (0, 1)
        )
        return np.asarray(start + (effective - low) * np.where(high > low, (end - start) / (high - low), 1.0))


@dataclass(frozen=True, eq=False)
class Creep:
    """Creep of a film.

    Attributes
    ----------
    strength : array
        (...) c, a fraction per decade.
    crept : array
        (decades, ...) s_j.
    """

    strength: Array
    crept: Array

    @classmethod
    def at_rest(cls, strength: Array) -> "Creep":
        return cls(strength, np.zeros((len(DECADES), *np.shape(strength))))

    def after(self, at_once: Array, seconds: float) -> "Creep":
        """Return the creep once u (...) has lasted for so long."""
        return replace(self, crept=at_once + (self.crept - at_once) * self._kept(seconds))

    def answer(self, at_once: Array, seconds: float) -> Array:
        """Return a (...) at the end of an interval in which u lasts."""
        return np.asarray(at_once + self.strength * self.after(at_once, seconds).crept.sum(axis=0))

    def at_once(self, answer: Array, seconds: float) -> Array:
        """u (...) of an interval with a at its end: the inverse of `answer`."""
        remaining = self._kept(seconds)
        left = self.strength * (self.crept * remaining).sum(axis=0)
        return np.asarray((answer - left) / (1 + self.strength * (1 - remaining).sum(axis=0)))

    def _kept(self, seconds: float) -> Array:
        return np.asarray(np.exp(-seconds / DECADES)).reshape(-1, *[1] * np.ndim(self.strength))


@dataclass(frozen=True, eq=False)
class FilmMemory:
    """A film before its next frame: where plays and creep stand, β and p_w in kPa; all (...) cells."""

    plays: Plays
    creep: Creep
    gain: Array
    water: Array
    response: Response = PUBLISHED

    @classmethod
    def at_rest(
        cls, hysteresis: Array, creep_per_decade: Array, gain: Array, water: Array, response: Response = PUBLISHED
    ) -> "FilmMemory":
        return cls(Plays.at_rest(hysteresis), Creep.at_rest(creep_per_decade), gain, water, response)

    def answered(self, pressure: Array, seconds: float) -> tuple["FilmMemory", Array]:
        """Return (the film afterwards, ln(r/r_rest)) of a pressure (...) kPa of a load that lasts for so long."""
        effective = self.plays.effective(pressure)
        at_once = self.response.logarithm(self.water) - self.response.logarithm(self.water + effective)
        answer = self.gain * self.creep.answer(at_once, seconds)
        return replace(self, plays=self.plays.after(pressure), creep=self.creep.after(at_once, seconds)), -answer

    def pressure(self, change: Array, seconds: float) -> Array:
        """p (...) kPa, at least an empty space, with ln(r/r_rest) = `change` after such an interval; ±∞, NaN stay."""
        return self.plays.pressure(self.effective(change, seconds))

    def effective(self, change: Array, seconds: float) -> Array:
        """p_e (...) kPa after such an interval."""
        at_once = self.creep.at_once(-change / self.gain, seconds)
        on_film = self.response.pressure(self.response.logarithm(self.water) - at_once)
        return np.asarray(np.maximum(on_film, VACUUM_KPA) - self.water)

    def observed(self, change: Array, seconds: float) -> "FilmMemory":
        """Return the film after an interval with ln(r/r_rest) = `change` at its end; a cell of NaN stands still."""
        known = np.isfinite(change)
        after, _ = self.answered(self.pressure(np.where(known, change, 0.0), seconds), seconds)
        held = np.where(known, after.plays.held, self.plays.held)
        crept = np.where(known, after.creep.crept, self.creep.crept)
        return replace(self, plays=replace(self.plays, held=held), creep=replace(self.creep, crept=crept))

    def fading(self, seconds: float) -> Array:
        """ln(r/r_rest) (...) after an interval without load: the residue of earlier loads."""
        return -self.gain * self.creep.answer(np.zeros(np.shape(self.creep.strength)), seconds)

    def at_once(self, change: Array, seconds: float) -> Array:
        """−ln(r/r_rest) (...) without creep, at the end of such an interval."""
        return np.asarray(self.gain * self.creep.at_once(-change / self.gain, seconds))


@dataclass(frozen=True)
class MemoryErrors:
    """Assumptions by which the memory of a film is told from a load.

    Attributes
    ----------
    unloaded, drift : float
        Standard deviation of ln r/r0 of a cell that nothing touches, beside the estimate's own error: at once, and for
        each minute.
    memory, cell_memory : float
        Relative error of a cell's predicted memory: peaks fall between frames; and the same where cells may differ.
    loaded_range : float
        The other explanation, that something still presses, is as likely beforehand; ln r/r0 is then anywhere within.
    open_cell : float
        ln r/r0 beyond which a cell is open.
    independent_frames : float
        Errors of a cell stay from frame to frame: all its frames count as so many.
    most_creep : float
        Mean creep beyond which a residue is no creep.
    lasting_share : float
        Share of a load that may stay.
    """

    unloaded: float = 0.005
    drift: float = 0.01
    memory: float = 0.05
    cell_memory: float = 0.2
    loaded_range: float = 4.0
    open_cell: float = 6.0
    independent_frames: float = 3.0
    most_creep: float = 0.2
    lasting_share: float = 0.5

    def resting_sd(self, minutes: float) -> float:
        """Return the standard deviation of ln r/r0 of a cell that nothing touches, so long after its zero."""
        return hypot(self.unloaded, self.drift * minutes)


ERRORS = MemoryErrors()


@dataclass(frozen=True)
class FilmKnown:
    """Strengths of a film's memory, and their sources.

    Attributes
    ----------
    cells : tuple or None
        (rows, columns) the creep of each cell and its deviation, estimated from a recording; else None.
    residue : float
        Of the largest ln r/r0 of a cell, the root mean square of the residue after the load that does not fade; its
        mean beforehand.
    """

    film: Film
    hysteresis: Strength
    creep: Strength
    sentence: str = ""
    cells: tuple[Array, Array] | None = None
    residue: float = 0.02

    @classmethod
    def specified(cls, film: Film) -> "FilmKnown":
        known = cls(film, film.hysteresis_strength, film.creep_strength)
        return replace(known, sentence=known._said("assumed"))

    def at_rest(self, water: Array, response: Response) -> FilmMemory:
        """(films, rows, columns) at rest in p_w: the mean film, then one with each strength by its deviation more."""
        creep, creep_sd = self.cells or self.creep
        more = [(0, 0), *([(1, 0)] if self.hysteresis.sd else []), *([(0, 1)] if self.creep.sd else [])]
        gap = np.stack(
            [np.full(water.shape, self.hysteresis.mean + deviation * self.hysteresis.sd) for deviation, _ in more]
        )
        strength = np.stack([np.broadcast_to(creep + deviation * creep_sd, water.shape) for _, deviation in more])
        gain = np.broadcast_to(self.film.answer * response.gains, gap.shape)
        return FilmMemory.at_rest(gap, strength, gain, water, response)

    def estimated(self, change: Array, sd: Array, time: Array) -> "FilmKnown":
        """Return the film with the creep that the recording shows; unchanged where the scene specifies it.

        Where a load is gone, a cell still shows c Σ s_j and a constant share ρ of its largest answer. P(c, ρ) ∝ P(c)
        P(ρ) beforehand · Π [½ N(u; 0, σ) + ½/`loaded_range`] over frames and cells, u the remainder of ln r/r_rest
        without both. Where cells differ, each has its own posterior about that of all. Where the residue is more than
        any film creeps, there is no creep.

        Parameters
        ----------
        change, sd : array, shape (frames, rows, columns)
            ln(r/r_rest), NaN where a frame failed.
        time : array
            s.
        """
        if self.film.creep_per_decade != "auto":
            return self
        usual, data = self.film.creep_strength, (self.film.answer, change, sd, time)
        each = _likelihood(*data, ERRORS.cell_memory, RESIDUES).sum(axis=(2, 3))
        logarithm = each - RESIDUES[:, None] / self.residue - CREEPS / usual.mean
        mean, shared = (float(number) for number in _moments(np.logaddexp.reduce(logarithm, axis=0)))
        volume = np.logaddexp.reduce(logarithm + np.log(np.gradient(CREEPS)), axis=1) + np.log(np.gradient(RESIDUES))
        weight = np.exp(volume - volume.max())
        weight /= weight.sum()
        residue = float(np.sqrt(weight @ RESIDUES**2))
        if mean > ERRORS.most_creep:
            message = "creep not estimated: what stays after loads does not fade as creep does"
            known = replace(self, creep=Strength(0.0, 0.0), residue=ERRORS.lasting_share)
            return replace(known, sentence=known._said("", message))
        spread = float(np.hypot(shared, mean * self.film.cell_spread))
        known = replace(self, creep=Strength(mean, float(np.hypot(spread, ERRORS.cell_memory * mean))), residue=residue)
        if spread > shared:
            own = _likelihood(*data, ERRORS.memory, weight[None] @ RESIDUES)[0]
            known = replace(known, cells=_moments(own - 0.5 * ((CREEPS[:, None, None] - mean) / spread) ** 2))
        message = f"estimated from the recording, and {100 * residue:.1f} % of a load may stay after it"
        return replace(known, sentence=known._said(message if shared <= 0.8 * usual.sd else "assumed"))

    def at_once(self, change: Array, time: Array) -> tuple[Array, Array]:
        """Return ln r/r_rest without creep, and its deviation as creep is known, (frames, rows, columns); NaN stays.

        Parameters
        ----------
        change : array, shape (frames, rows, columns)
            ln r/r_rest.
        time : array, shape (frames)
            s.
        """
        mean, sd = self.cells or self.creep
        strength = np.stack([np.broadcast_to(size, change.shape[1:]) for size in (mean, mean + sd)])
        creep, answers, last = Creep.at_rest(strength), list[Array](), float(time[0]) - 1.0
        for frame, now in zip(change, time, strict=True):
            seconds = max(float(now) - last, MIN_PERIOD)
            answers.append(creep.at_once(np.broadcast_to(frame, strength.shape), seconds))
            after, known = creep.after(answers[-1], seconds), np.isfinite(frame)
            creep, last = replace(creep, crept=np.where(known, after.crept, creep.crept)), float(now)
        expected, stronger = np.stack(answers, axis=1)
        return expected, np.abs(stronger - expected)

    def _said(self, creep_from: str, instead: str = "") -> str:
        parts = []
        if self.film.hysteresis == "auto":
            parts.append(f"hysteresis {100 * self.hysteresis.mean:.0f} +- {100 * self.hysteresis.sd:.0f} %, assumed")
        if self.film.creep_per_decade == "auto":
            mean, sd = (100 * number for number in self.creep)
            parts.append(instead or f"creep {mean:.1f} +- {sd:.1f} % for each decade, {creep_from}")
        return "; ".join(parts)


def _moments(logarithm: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of c, (...), whose ln P at CREEPS are (strengths, ...)."""
    wide = np.gradient(CREEPS).reshape(-1, *[1] * (logarithm.ndim - 1))
    weight = np.exp(logarithm - logarithm.max(axis=0)) * wide
    weight = weight / weight.sum(axis=0)
    mean = np.tensordot(CREEPS, weight, 1)
    return mean, np.sqrt(np.maximum(np.tensordot(CREEPS**2, weight, 1) - mean**2, 0.0))


def _likelihood(gain: float, change: Array, sd: Array, time: Array, own: float, residues: Array) -> Array:
    """ln P(frames of a cell | ρ, c) for every c of CREEPS, up to a common term, (residues, strengths, rows, columns).

    Parameters
    ----------
    own : float
        Relative standard deviation of the residue of a load.
    residues : array
        ρ, (residues).
    """
    likelihood = np.zeros((len(residues), len(CREEPS), *change.shape[1:]))
    felt = np.nanmax(-change, axis=0, initial=0.0) > ERRORS.unloaded  # of all others each strength explains as much
    change, sd, share = change[:, felt], sd[:, felt], residues[:, None, None]
    creep, last = Creep.at_rest(np.broadcast_to(CREEPS[:, None], (len(CREEPS), felt.sum()))), float(time[0])
    total, resting = np.zeros((2, len(residues), *creep.strength.shape))
    peak = np.zeros(change.shape[1])
    for frame, error, now in zip(change, sd, time, strict=True):
        seconds, known = max(float(now) - last, MIN_PERIOD), np.isfinite(frame) & np.isfinite(error)
        if not known.any():
            continue
        fading = creep.answer(np.zeros(creep.strength.shape), seconds)
        answer = np.where(known, np.clip(-frame / gain, -ERRORS.open_cell, ERRORS.open_cell), fading)
        drift, stays = ERRORS.resting_sd((now - time[0]) / 60), fading + share * peak
        variance = (np.where(known, error, 0.0) / gain) ** 2 + drift**2 + (own * stays) ** 2
        density = np.exp(-0.5 * (answer - stays) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
        density *= stays <= ERRORS.lasting_share * peak
        total += known * np.log((density + 1 / ERRORS.loaded_range) / 2)
        resting += known * density / (density + 1 / ERRORS.loaded_range)
        peak = np.fmax(peak, np.where(known, answer[0].clip(0.0), 0.0))
        creep, last = creep.after(creep.at_once(answer, seconds), seconds), float(now)
    likelihood[..., felt] = total / np.maximum(resting.max(axis=1, keepdims=True) / ERRORS.independent_frames, 1.0)
    return likelihood
