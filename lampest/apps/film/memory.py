"""Memory of a film: operators of hysteresis and creep over the frames, and their inverses.

    p_e = hysteresis(p),   u = ln f(p_w) − ln f(p_w + p_e),   −ln(r/r_rest) = β·creep(u)

f is the response curve, p_w the pressure of the water at rest, β the cell's gain κ times the share
that bending leaves.

Hysteresis: loading follows the response curve, unloading lags behind it, and no effect remains
after a load.

    p_e = w_0 p + Σ w_i z_i,   z_i held between p and b_i p

A generalised Prandtl-Ishlinskii operator: plays z_i whose two branches are the lines p and b_i p,
b_i > 1. The memory is erased where the load crosses zero. The inverse is exact, because p_e is
strictly monotone and piecewise linear in p, w_0 > 0. From a peak P the film unloads along the
hyperbola

    p_e/P = s²t/(1 + (s² − 1)t),   t = p/P,   s = (1 + η)/(1 − η),

whose largest gap from the line is η, at t = 1/(1 + s).
Sources: Al Janaideh, Rakheja, Su, IEEE/ASME Trans. Mechatron. 16, 734 (2011), the operator and its
inverse; Kuhnen, Eur. J. Control 9, 407 (2003); for tactile films Sánchez-Durán et al., Sensors 15,
26170 (2015).

Creep: a response a that grows with the logarithm of time, and fades likewise.

    a = u + c Σ_j s_j,   ds_j/dt = (u − s_j)/τ_j,   τ_j = 1, 10, … 10⁵ s

u is the film's instantaneous response; c is the creep per decade. One Kelvin-Voigt element in each
decade makes Σ_j (1 − e^{−t/τ_j}) = log10(t/1 s) + 0.74 to within 0.02 from a second to a day. A
load that was applied for a time T leaves c u log10((T + t)/t) at a time t after it. Creep within
the first second belongs to the response curve. The creep is one of ln r, because tunnelling makes
ln r linear in the gap between conducting grains, and the gap creeps.
Sources: Zhang et al., J. Polym. Sci. B 38, 2739 (2000); data sheets of Interlink's FSR; Krejčí &
Kuhnen, IEE Proc. Control Theory Appl. 148, 185 (2001), a row of relaxations beside hysteresis, and
the inverse of both.
"""

from dataclasses import dataclass, replace
from math import hypot

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.response import PUBLISHED, VACUUM_KPA, Film, Response, Strength

# Corners of the piecewise linear hyperbola, as ln(s t/(1 − t)), 0 at the largest gap; its error is
# 0.4 % of the peak.
CUTS = np.linspace(-2.6, 2.6, 11)
DECADES = 10.0 ** np.arange(6)  # τ_j, s
# Strengths of creep per decade that `FilmKnown.estimated` compares; denser where posteriors are
# narrower.
CREEPS = Film.most["creep_per_decade"] * np.linspace(0, 1, 81) ** 2
# Compared shares of a cell's largest ln r/r0 that remain after a load and do not fade.
RESIDUES = 0.25 * np.linspace(0, 1, 26) ** 2
MIN_PERIOD = 1e-3  # s between frames whose times do not increase
# What distinguishes the memory of a film from a load: standard deviations of ln r/r0 of an
# untouched cell, in addition to the estimate's error;
RESTING_SD = 0.005
DRIFT_PER_MINUTE = 0.01
# relative errors of a cell's predicted memory, because peaks fall between frames; the second where
# cells differ;
MEMORY_SD = 0.05
CELL_MEMORY_SD = 0.2
# range of ln r/r0, uniform, under the alternative that a load still presses, of equal prior odds;
LOADED_RANGE = 4.0
OPEN_CELL = 6.0  # ln r/r0 beyond which a cell is open
INDEPENDENT_FRAMES = 3.0  # effective number of a cell's, because its errors persist
MAX_CREEP = 0.2  # mean creep beyond which a residue is not taken for creep
LASTING_SHARE = 0.5  # largest share of a load that may remain
MAX_SD_RATIO = 0.8  # posterior over prior, with which a creep counts as estimated


@dataclass(frozen=True, eq=False)
class Plays:
    """Hysteresis as a sum of plays.

    Attributes
    ----------
    weight : array, shape (1 + plays, ...)
        w_0 of p, and w_i of the plays.
    reach : array, shape (plays, ...)
        b_i.
    held : array, shape (plays, ...)
        z_i, kPa.
    """

    weight: Array
    reach: Array
    held: Array

    @classmethod
    def at_rest(cls, hysteresis: Array) -> "Plays":
        """Return the state before the first load of cells with the largest gap η, of any shape."""
        # s; corners t of the hyperbola, and p_e/P there
        steep = (1 + hysteresis) / (1 - hysteresis)
        cut = np.exp(CUTS.reshape(-1, *[1] * np.ndim(hysteresis)))
        corners = 1 / (1 + steep / cut)
        effective = 1 / (1 + 1 / (steep * cut))
        # slopes of the lines; differences of successive slopes give w_i, the last slope is w_0
        slopes = np.diff(effective, axis=0, prepend=0, append=1) / np.diff(
            corners, axis=0, prepend=0, append=1
        )
        weight = np.concatenate([slopes[-1:], -np.diff(slopes, axis=0) * corners])
        return cls(weight, 1 / corners, np.zeros_like(corners))

    def after(self, pressure: Array) -> "Plays":
        """Return the plays after a monotone change to a pressure p (...) kPa.

        Every z_i is clipped between p and b_i p.
        """
        reached = self.reach * pressure
        low = np.minimum(pressure, reached)
        high = np.maximum(pressure, reached)
        return replace(self, held=np.clip(self.held, low, high))

    def effective(self, pressure: Array) -> Array:
        """Return p_e = w_0 p + Σ w_i z_i (...) kPa of the next pressure p."""
        return np.asarray(
            self.weight[0] * pressure + (self.weight[1:] * self.after(pressure).held).sum(axis=0)
        )

    def pressure(self, effective: Array) -> Array:
        """Return the next pressure p (...) kPa from p_e, the inverse of `effective`.

        ±∞ and NaN are preserved.
        """
        if not self.weight[1:].any():  # no hysteresis, the usual case
            return np.asarray(effective / self.weight[0])
        # p_e is linear between the corners p = z_i, z_i/b_i and 0, where a play begins or ends to
        # move.
        corners = np.sort(
            np.concatenate([self.held, self.held / self.reach, np.zeros_like(self.held[:1])]),
            axis=0,
        )
        # Beyond all corners every play follows p or b_i p, so one further point on each side gives
        # the outer lines.
        corners = np.concatenate([corners[:1] - 1, corners, corners[-1:] + 1])
        play = Plays(self.weight[:, None], self.reach[:, None], self.held[:, None])
        reached = play.effective(corners)
        below = np.clip((reached <= effective).sum(axis=0) - 1, 0, len(corners) - 2)
        start, end = _neighbours(corners, below)
        low, high = _neighbours(reached, below)
        return start + (effective - low) * np.where(high > low, (end - start) / (high - low), 1.0)


def _neighbours(values: Array, below: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the values, (n, ...), at the indices `below` of the first axis, and the next ones."""
    at = np.take_along_axis(values, below[None], axis=0)[0]
    following = np.take_along_axis(values, below[None] + 1, axis=0)[0]
    return at, following


@dataclass(frozen=True, eq=False)
class Creep:
    """Creep of a film.

    Attributes
    ----------
    strength : array, shape (...)
        c, a fraction per decade.
    crept : array, shape (decades, ...)
        s_j.
    """

    strength: Array
    crept: Array

    @classmethod
    def at_rest(cls, strength: Array) -> "Creep":
        """Return the creep of a film that has lain unloaded for long: no part has crept."""
        return cls(strength, np.zeros((len(DECADES), *np.shape(strength))))

    def after(self, at_once: Array, seconds: float) -> "Creep":
        """Return the creep after an interval in s with constant u (...).

        Every s_j decays to u: s_j ← u + (s_j − u) e^{−t/τ_j}.
        """
        return replace(self, crept=at_once + (self.crept - at_once) * self._decay(seconds))

    def answer(self, at_once: Array, seconds: float) -> Array:
        """Return a = u + c Σ s_j (...) at the end of an interval with constant u."""
        return np.asarray(at_once + self.strength * self.after(at_once, seconds).crept.sum(axis=0))

    def at_once(self, answer: Array, seconds: float) -> Array:
        """Return the constant u (...) of an interval from a at its end, the inverse of `answer`."""
        decay = self._decay(seconds)
        # a = u + c Σ (u + (s_j − u) e_j) is linear in u, with e_j = e^{−t/τ_j}
        memory = self.strength * (self.crept * decay).sum(axis=0)
        return np.asarray((answer - memory) / (1 + self.strength * (1 - decay).sum(axis=0)))

    def _decay(self, seconds: float) -> Array:
        """Return e^{−t/τ_j} after an interval in s, (decades, 1, ...)."""
        return np.asarray(np.exp(-seconds / DECADES)).reshape(-1, *[1] * np.ndim(self.strength))


@dataclass(frozen=True, eq=False)
class FilmMemory:
    """State of a film before its next frame, for cells of any shape (...).

    Attributes
    ----------
    plays : Plays
    creep : Creep
    gain : array
        β.
    water : array
        p_w, kPa.
    response : Response
        f.
    """

    plays: Plays
    creep: Creep
    gain: Array
    water: Array
    response: Response = PUBLISHED

    @classmethod
    def at_rest(
        cls,
        hysteresis: Array,
        creep_per_decade: Array,
        gain: Array,
        water: Array,
        response: Response = PUBLISHED,
    ) -> "FilmMemory":
        """Return the memory of a film that has lain unloaded for long."""
        return cls(
            Plays.at_rest(hysteresis), Creep.at_rest(creep_per_decade), gain, water, response
        )

    def answered(self, pressure: Array, seconds: float) -> tuple["FilmMemory", Array]:
        """Return the film after a load, and its response.

        Parameters
        ----------
        pressure : array, shape (...)
            kPa, constant during the interval.
        seconds : float
            Duration of the interval.

        Returns
        -------
        film : FilmMemory
            State at the end of the interval.
        response : array, shape (...)
            ln(r/r_rest) at the end of the interval.
        """
        effective = self.plays.effective(pressure)
        at_once = self.response.logarithm(self.water) - self.response.logarithm(
            self.water + effective
        )
        answer = self.gain * self.creep.answer(at_once, seconds)
        return replace(
            self, plays=self.plays.after(pressure), creep=self.creep.after(at_once, seconds)
        ), -answer

    def pressure(self, change: Array, seconds: float) -> Array:
        """Return the pressure (...) kPa from ln(r/r_rest) = `change` at the end of an interval.

        The interval is in s, and the pressure at least a vacuum. ±∞ and NaN are preserved.
        """
        return self.plays.pressure(self.effective(change, seconds))

    def effective(self, change: Array, seconds: float) -> Array:
        """Return p_e (...) kPa from ln(r/r_rest) = `change` at the end of an interval in s."""
        at_once = self.creep.at_once(-change / self.gain, seconds)
        on_film = self.response.pressure(self.response.logarithm(self.water) - at_once)
        return np.maximum(on_film, VACUUM_KPA) - self.water

    def observed(self, change: Array, seconds: float) -> "FilmMemory":
        """Return the film after an interval in s from ln(r/r_rest) = `change` at its end.

        NaN leaves cells as is.
        """
        finite = np.isfinite(change)
        after, _ = self.answered(self.pressure(np.where(finite, change, 0.0), seconds), seconds)
        held = np.where(finite, after.plays.held, self.plays.held)
        crept = np.where(finite, after.creep.crept, self.creep.crept)
        return replace(
            self, plays=replace(self.plays, held=held), creep=replace(self.creep, crept=crept)
        )

    def fading(self, seconds: float) -> Array:
        """Return ln(r/r_rest) (...) after an interval in s without load.

        This is the memory of earlier loads, which fades.
        """
        return -self.gain * self.creep.answer(np.zeros(np.shape(self.creep.strength)), seconds)

    def at_once(self, change: Array, seconds: float) -> Array:
        """Return β u (...), −ln(r/r_rest) without creep, after an interval in s.

        `change` is ln(r/r_rest) with creep.
        """
        return self.gain * self.creep.at_once(-change / self.gain, seconds)


def drift_sd(minutes: float) -> float:
    """Return the standard deviation of ln r/r0 of an untouched cell, minutes after its zero."""
    return hypot(RESTING_SD, DRIFT_PER_MINUTE * minutes)


NO_CREEP = "creep not estimated: what stays after loads does not fade as creep does"


@dataclass(frozen=True)
class FilmKnown:
    """Strengths of a film's memory, and their sources.

    Attributes
    ----------
    film : Film
        As the scene specifies it.
    creep : Strength
        Mean and standard deviation.
    origin : str
        Source of the creep that the scene leaves open.
    cells : (array, array) or None
        Creep of each cell and its standard deviation, (rows, columns), estimated from a recording.
    residue : float
        Root mean square of the permanent residue after a load, as a share of the cell's largest ln
        r/r0; before a recording is evaluated its prior mean.
    """

    film: Film
    creep: Strength
    origin: str = "assumed"
    cells: tuple[Array, Array] | None = None
    residue: float = 0.02

    @classmethod
    def specified(cls, film: Film) -> "FilmKnown":
        """Return the film as its scene specifies it, without information from recordings."""
        return cls(film, film.strength("creep_per_decade"))

    @property
    def hysteresis(self) -> Strength:
        """Mean and standard deviation of the hysteresis."""
        return self.film.strength("hysteresis")

    @property
    def sentence(self) -> str:
        """Strengths that the scene leaves open and their sources, in words."""
        parts = list[str]()
        mean, sd = (100 * number for number in self.creep)
        if self.film.hysteresis == "auto":
            parts.append(
                f"hysteresis {100 * self.hysteresis.mean:.0f} +- {100 * self.hysteresis.sd:.0f} %, "
                "assumed"
            )
        if self.film.creep_per_decade == "auto":
            parts.append(
                f"creep {mean:.1f} +- {sd:.1f} % for each decade, {self.origin}" if sd else NO_CREEP
            )
        return "; ".join(parts)

    def at_rest(self, water: Array, response: Response) -> FilmMemory:
        """Return the films at rest in water, (films, rows, columns).

        The first is the mean film; each further film has one uncertain strength increased by its
        standard deviation.
        """
        # Numbers of standard deviations by which hysteresis and creep of each film are increased.
        films = [(0.0, 0.0)]
        if self.hysteresis.sd > 0:
            films.append((1.0, 0.0))
        if self.creep.sd > 0:
            films.append((0.0, 1.0))
        more_hysteresis, more_creep = np.array(films).T[..., None, None] * np.ones(water.shape)
        creep, creep_sd = self.cells or self.creep
        hysteresis = self.hysteresis.mean + more_hysteresis * self.hysteresis.sd
        gain = self.film.answer * response.gains * np.ones(hysteresis.shape)
        return FilmMemory.at_rest(hysteresis, creep + more_creep * creep_sd, gain, water, response)

    def estimated(self, change: Array, sd: Array, time: Array) -> "FilmKnown":
        """Return the film with the posterior of its creep, given a recording.

        A creep that the scene specifies is not estimated. After a load a cell still shows c Σ s_j
        and a constant share ρ of its largest response. With exponential priors

            P(c, ρ | data) ∝ P(c) P(ρ) Π [½ N(u; 0, σ) + ½/`LOADED_RANGE`]

        over frames and cells, where u is ln r/r_rest without both. Where cells may differ, each has
        its own posterior about the common one. If the mean exceeds `MAX_CREEP`, the residue is not
        taken for creep.

        Parameters
        ----------
        change, sd : array, shape (frames, rows, columns)
            ln(r/r_rest), NaN where a frame failed, and its standard deviation.
        time : array, shape (frames,)
            s.
        """
        if self.film.creep_per_decade != "auto":
            return self
        usual = self.film.strength("creep_per_decade")
        data = (self.film.answer, change, sd, time)
        likelihood = _likelihood(*data, CELL_MEMORY_SD, RESIDUES).sum(axis=(2, 3))
        logarithm = likelihood - RESIDUES[:, None] / self.residue - CREEPS / usual.mean
        # moments of c, marginal over ρ; then of ρ, integrated over c with the grid's spacing
        mean, shared = (
            float(number) for number in _moments(np.logaddexp.reduce(logarithm, axis=0), CREEPS)
        )
        volume = np.logaddexp.reduce(logarithm + np.log(np.gradient(CREEPS)), axis=1)
        residue, residue_sd = _moments(volume, RESIDUES)
        if mean > MAX_CREEP:
            return replace(self, creep=Strength(0.0, 0.0), residue=LASTING_SHARE)
        spread = float(np.hypot(shared, mean * self.film.cell_spread))
        lasting = float(np.hypot(residue, residue_sd))
        creep = Strength(mean, float(np.hypot(spread, CELL_MEMORY_SD * mean)))
        cells = None
        if spread > shared:
            by_cell = _likelihood(*data, MEMORY_SD, residue[None])[0]
            cells = _moments(by_cell - 0.5 * ((CREEPS[:, None, None] - mean) / spread) ** 2, CREEPS)
        origin = (
            f"estimated from the recording, and {100 * lasting:.1f} % of a load may stay after it"
        )
        estimate = replace(self, creep=creep, residue=lasting, cells=cells)
        narrowed = shared <= MAX_SD_RATIO * usual.sd
        return replace(estimate, origin=origin) if narrowed else estimate

    def at_once(self, change: Array, time: Array) -> tuple[Array, Array]:
        """Return ln r/r_rest without creep, and its error by the uncertainty of creep.

        Parameters
        ----------
        change : array, shape (frames, rows, columns)
            ln r/r_rest; NaN is preserved.
        time : array, shape (frames,)
            s.

        Returns
        -------
        expected, error : arrays, shape (frames, rows, columns)
            ln r/r_rest without creep; its change when the strength of creep grows by one standard
            deviation.
        """
        mean, sd = self.cells or self.creep
        strength = np.stack([np.broadcast_to(size, change.shape[1:]) for size in (mean, mean + sd)])
        creep = Creep.at_rest(strength)
        answers = list[Array]()
        last = float(time[0]) - 1.0
        for frame, frame_time in zip(change, time, strict=True):
            seconds = max(float(frame_time) - last, MIN_PERIOD)
            answers.append(creep.at_once(np.broadcast_to(frame, strength.shape), seconds))
            after = creep.after(answers[-1], seconds)
            finite = np.isfinite(frame)
            creep = replace(creep, crept=np.where(finite, after.crept, creep.crept))
            last = float(frame_time)
        expected, stronger = np.stack(answers, axis=1)
        return expected, np.abs(stronger - expected)


def _moments(logarithm: Array, grid: Array) -> tuple[Array, Array]:
    """Return the mean and the standard deviation of a strength, (...) each.

    `logarithm` is ln P at the grid of strengths, (strengths, ...).
    """
    wide = np.gradient(grid).reshape(-1, *[1] * (logarithm.ndim - 1))
    weight = np.exp(logarithm - logarithm.max(axis=0)) * wide
    weight = weight / weight.sum(axis=0)
    mean = np.tensordot(grid, weight, 1)
    return mean, np.sqrt(np.maximum(np.tensordot(grid**2, weight, 1) - mean**2, 0.0))


def _likelihood(
    gain: float, change: Array, sd: Array, time: Array, memory: float, residues: Array
) -> Array:
    """Return ln P(frames of a cell | ρ, c) up to a constant, (residues, strengths, rows, columns).

    Parameters
    ----------
    gain : float
        Share of the response that bending leaves.
    change, sd : array, shape (frames, rows, columns)
        ln(r/r_rest) and its standard deviation.
    time : array, shape (frames,)
        s.
    memory : float
        Relative standard deviation of the memory of a load.
    residues : array, shape (residues,)
        ρ.
    """
    likelihood = np.zeros((len(residues), len(CREEPS), *change.shape[1:]))
    # Other cells are explained equally by every c.
    loaded = np.nanmax(-change, axis=0, initial=0.0) > RESTING_SD
    change = change[:, loaded]
    sd = sd[:, loaded]
    share = residues[:, None, None]
    creep = Creep.at_rest(np.broadcast_to(CREEPS[:, None], (len(CREEPS), loaded.sum())))
    last = float(time[0])
    total, resting = np.zeros((2, len(residues), *creep.strength.shape))
    peak = np.zeros(change.shape[1])
    for frame, error, frame_time in zip(change, sd, time, strict=True):
        seconds = max(float(frame_time) - last, MIN_PERIOD)
        finite = np.isfinite(frame) & np.isfinite(error)
        if not finite.any():
            continue
        fading = creep.answer(np.zeros(creep.strength.shape), seconds)
        answer = np.where(finite, np.clip(-frame / gain, -OPEN_CELL, OPEN_CELL), fading)
        drift = drift_sd((frame_time - time[0]) / 60)
        stays = fading + share * peak
        variance = (np.where(finite, error, 0.0) / gain) ** 2 + drift**2 + (memory * stays) ** 2
        # N(u; 0, σ) with σ² of the estimate, drift and memory; total += ln(½ N + ½/range), resting
        # += P(no load)
        density = np.exp(-0.5 * (answer - stays) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
        density *= stays <= LASTING_SHARE * peak
        total += finite * np.log((density + 1 / LOADED_RANGE) / 2)
        resting += finite * density / (density + 1 / LOADED_RANGE)
        peak = np.fmax(peak, np.where(finite, answer[0].clip(0.0), 0.0))
        creep = creep.after(creep.at_once(answer, seconds), seconds)
        last = float(frame_time)
    # the unloaded frames of a cell count as `INDEPENDENT_FRAMES` at most
    likelihood[..., loaded] = total / np.maximum(
        resting.max(axis=1, keepdims=True) / INDEPENDENT_FRAMES, 1.0
    )
    return likelihood
