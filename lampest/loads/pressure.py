"""Pressure of a load on every cell, from the cell's resistance over its unloaded one; and the water's pressure."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from lampest.loads.film import FilmKnown, FilmTrack
from lampest.loads.response import PUBLISHED, RESPONSE_SD, VACUUM_KPA
from lampest.loads.tare import Tare, TareWatch
from lampest.panel.film import Film
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene, Water
from lampest.panel.systematic import usual

GRAVITY = 9.81  # m/s²
NORMAL_95 = 1.959964  # half the 95 % interval of a normal distribution, in standard deviations


@dataclass(frozen=True, eq=False)
class Pressure:
    """What presses on the cells or sucks at them, without the pressure of the water.

    pressure : (frames, rows, columns) kPa; NaN where the estimate is.
    lower, upper : ends of the 95 % interval, kPa. `lower` is never below an empty space; `upper` may be infinite.
    errors : half the 68 % interval, kPa: one standard deviation where the response is linear.
    saturated : 1 where the response leaves the pressure open: the interval reaches beyond `told_kpa` of the response,
        water included; of the published one −10 and 40 kPa. Without any error of the estimate this begins at 31 kPa.
    tared : (frames) why zero was taken anew after a frame; '' where it was not.
    """

    pressure: Array
    lower: Array
    upper: Array
    errors: Array
    saturated: NDArray[np.uint8]
    tared: tuple[str, ...] = ()


def pressure_of(
    ratio: Array,
    lower: Array,
    upper: Array,
    scene: Scene,
    time: Array | None = None,
    known: FilmKnown | None = None,
    tare: Tare | None = None,
) -> Pressure:
    """p = f⁻¹(f(p_w)·e^{x/κ}) − p_w with x = ln(r/r_baseline) − α (T − T_b), (frames, rows, columns) kPa.

    The interval's ends are those of x, mapped like x itself: f is monotone. Three errors are added in quadrature:
    that of the estimate (each side its own), |T − T_b|·σ_α, and the response's, `response_sd`·|x|. Where the scene
    names a film, its memory of earlier frames is taken off; what it may keep is one more error. See `PressureTrack`.

    ratio : (frames, rows, columns) r/r_baseline; NaN where a frame failed.
    lower, upper : ends of its 95 % interval; 0 and infinity where that is open, `ratio` itself at a bound.
    scene : panel, and water and temperature where it names them; the water stood there in the unloaded frames too.
    time : (frames) s; a second apart where it is None. known : of the film; None: as the scene has it.
    tare : when zero is taken anew; None: never.

    Raises ValueError where shapes disagree, a ratio is not positive and finite, or lies outside its interval.
    """
    _check(ratio, lower, upper, scene.panel)
    track = PressureTrack.begin(scene, known, tare)
    if track.film is None:
        return track.pressure(ratio, lower, upper, 0.0)
    seconds, frames, tared = np.arange(len(ratio)) if time is None else time, [], []
    for frame in zip(ratio, lower, upper, map(float, seconds), strict=True):
        frames.append(track.pressure(*frame))
        track = track.after(frame[0], frame[3])
        tared.append(track.tared)
    maps = [part.name for part in fields(Pressure) if part.name != "tared"]
    together = {name: np.stack([getattr(frame, name) for frame in frames]) for name in maps}
    return Pressure(**together, tared=tuple(tared))


@dataclass(frozen=True, eq=False)
class PressureTrack:
    """Pressures of frames as they come; with a film, where that stands after the last one.

    scene : as `pressure_of` has it. film : its memory and its zero; None where there is neither. watch : whether
    something touches the panel; None where zero stays. tared : why zero was taken anew after the last frame, or ''.
    """

    scene: Scene
    film: FilmTrack | None
    watch: TareWatch | None = None
    tared: str = ""

    @classmethod
    def begin(cls, scene: Scene, known: FilmKnown | None = None, tare: Tare | None = None) -> "PressureTrack":
        """Before the first frame. known : of the film; None: as the scene has it. tare : when zero is taken anew."""
        if scene.film is None and tare is None:
            return cls(scene, None)
        known = known or FilmKnown.specified(scene.film or Film())
        film = FilmTrack.begin(known, water_pressure(scene.panel, scene.water), scene.response or PUBLISHED)
        return cls(scene, film, None if tare is None else TareWatch(tare))

    def pressure(self, ratio: Array, lower: Array, upper: Array, time: float) -> Pressure:
        """p (rows, columns) kPa of the next frame at a time in s; of several (frames, …) where there is no film.

        What the film's strengths leave open is one more error: what p moves by if each is by its deviation more.
        """
        change, below, above = self._change(ratio), *self._beside(ratio, lower, upper, time)
        water = water_pressure(self.scene.panel, self.scene.water)
        here, *others = self._pressures(change, time)
        least, most = (self._pressures(end, time)[0] for end in (change + above, change - below))
        low, high = (self._pressures(change + part / NORMAL_95, time)[0] for part in (above, -below))
        errors = (high - low) / 2
        if others:
            open_kpa = np.sqrt(np.sum((np.stack(others) - here) ** 2, axis=0))
            least = np.maximum(here - np.hypot(here - least, NORMAL_95 * open_kpa), VACUUM_KPA - water)
            most, errors = here + np.hypot(most - here, NORMAL_95 * open_kpa), np.hypot(errors, open_kpa)
        known = (self.scene.response or PUBLISHED).told_kpa
        saturated = (least + water < known[0]) | (most + water > known[1])
        return Pressure(here, least, most, errors, saturated.astype(np.uint8))

    def after(self, ratio: Array, time: float) -> "PressureTrack":
        """Once a frame with r/r_baseline (rows, columns) has come at a time in s."""
        if self.film is None:
            return self
        change, memory = self._change(ratio), self.film.memory(time)
        film = self.film.observed(change, time)
        if self.watch is None:
            return replace(self, film=film)
        zero = self.film.zeros[0]
        watch, moved, tared = self.watch.after(change - (memory + zero), memory, time)
        if moved is not None:
            film = film.tared(moved + (film.memory(time) + zero), time)
        return replace(self, film=film, watch=watch, tared=tared)

    def rebased(self, time: float) -> "PressureTrack":
        """Against another baseline from a time in s on: the panel as it is then, with nothing on it."""
        if self.film is None:
            return self
        watch = None if self.watch is None else TareWatch(self.watch.tare, time)
        nothing = np.zeros(self.scene.panel.shape)
        return replace(self, film=self.film.tared(nothing, time), watch=watch)

    def _change(self, ratio: Array) -> Array:
        """ln(r/r_baseline) without what warmth does."""
        warmth = self.scene.temperature
        return np.asarray(np.log(ratio) - (0.0 if warmth is None else warmth.logarithm))

    def _beside(self, ratio: Array, lower: Array, upper: Array, time: float) -> tuple[Array, Array]:
        """Half the 95 % interval of the change, below and above it."""
        scene, answer = self.scene, self._change(ratio)
        kept = np.zeros(answer.shape) if self.film is None else self.film.kept(answer)
        if self.film is not None:
            answer = -self.film.at_once(answer, time)
        warmth = scene.temperature
        warming_sd = 0.0 if warmth is None else abs(warmth.difference_kelvin) * warmth.coefficient_sd_per_kelvin
        curve_sd = 0.0 if scene.film is None else scene.film.answer_sd
        shared = (
            np.hypot(np.hypot(response_sd(scene, answer), curve_sd) * answer, np.hypot(warming_sd, kept)) * NORMAL_95
        )
        with np.errstate(divide="ignore"):
            return np.hypot(np.log(ratio) - np.log(lower), shared), np.hypot(np.log(upper) - np.log(ratio), shared)

    def _pressures(self, change: Array, time: float) -> Sequence[Array]:
        """Pressures of the load under which each film shows such changes."""
        if self.film is not None:
            return list(self.film.pressures(change, time))
        water, response = water_pressure(self.scene.panel, self.scene.water), self.scene.response or PUBLISHED
        on_film = response.pressure(response.logarithm(water) + change / response.gains)
        return [np.maximum(on_film, VACUUM_KPA) - water]


def response_sd(scene: Scene, answer: Array) -> Array:
    """Relative standard deviation of ln(r/r0) of cells at a pressure, where it is `answer` (…, rows, columns).

    The scene's `response_sd`, RESPONSE_SD where it names none, or the gains' own; and that of the scene's curve.
    """
    response, named = scene.response or PUBLISHED, usual(scene)
    scatter = np.array(RESPONSE_SD if named is None or named.response_sd is None else named.response_sd)
    if response.gain_sd is not None:
        scatter = np.array(response.gain_sd)
    return np.asarray(np.hypot(scatter, response.curve_sd(response.pressure(answer / response.gains))))


def water_pressure(panel: Panel, water: Water | None) -> Array:
    """p_w = ρ g (depth + y) of cells at y, j·pitch in row j; (rows, columns) kPa, zero without water."""
    if water is None:
        return np.zeros(panel.shape)
    depth = water.top_row_depth_mm + panel.places_mm[1]
    kpa_per_mm = 1e-6 * 1000 * GRAVITY
    return np.asarray(np.nan_to_num(kpa_per_mm * depth))


def _check(ratio: Array, lower: Array, upper: Array, panel: Panel) -> None:
    if ratio.shape[1:] != panel.shape or not ratio.shape == lower.shape == upper.shape:
        raise ValueError("ratio, lower and upper must all be frames × rows × columns of the scene's panel")
    number = np.isfinite(ratio) & (ratio > 0) & (lower >= 0) & (lower <= ratio) & (upper >= ratio)
    if not np.all(number | (np.isnan(ratio) & np.isnan(lower) & np.isnan(upper))):
        raise ValueError("a resistance over its unloaded value must be positive, finite and within its interval")
