"""Pressures of loads from the ratio of cell resistances to their unloaded values.

`PressureTrack` follows the film from frame to frame and gives pressures with their errors.
`total_force` gives the force of a frame.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.apps.film.memory import MIN_PERIOD, FilmKnown, FilmMemory, drift_sd
from lampest.apps.film.tare import TareWatch
from lampest.estimate.estimator import Tare
from lampest.files.levels import NOISE_REACH, TWO_SIDED
from lampest.panel.conditions import water_pressure
from lampest.panel.effects import systematic_of
from lampest.panel.panel import Array
from lampest.panel.response import PUBLISHED, RESPONSE_SD, VACUUM_KPA, Film
from lampest.panel.scene import Scene

MIN_TOUCH = 0.1  # ln r/r0: less may be drift alone, half a kPa of the published film


@dataclass(frozen=True, eq=False)
class Pressure:
    """Pressure of loads on the cells, without that of the water; suction is negative.

    Attributes
    ----------
    pressure : array, shape (frames, rows, columns)
        kPa; NaN where the estimate is NaN.
    lower, upper : array, same shape
        Ends of the 95 % interval, kPa: `lower` is at least a vacuum, `upper` may be infinite.
    errors : array, same shape
        Half the 68 % interval, kPa.
    own, common : array, same shape
        Two parts of `errors`, kPa: each cell's own, and the one that cells share, such as that of
        the film's curve.
    saturated : array, same shape
        1 where the response does not determine the pressure: the interval, water included, exceeds
        `told_kpa`.
    pressing : array, same shape
        1 where a load presses: ln r/r0 without the film's memory decreased by NOISE_REACH standard
        deviations, without that of the response.
    tared : tuple of str
        Reason for a new zero after each frame; '' where there was none.
    """

    pressure: Array
    lower: Array
    upper: Array
    errors: Array
    own: Array
    common: Array
    saturated: NDArray[np.uint8]
    pressing: NDArray[np.uint8]
    tared: tuple[str, ...] = ()


def pressure_of(
    ratio: Array,
    lower: Array,
    upper: Array,
    scene: Scene,
    time: Array | None = None,
    known: FilmKnown | None = None,
    tare: Tare | None = None,
    own: Array | None = None,
) -> Pressure:
    """Return the pressure p = f⁻¹(f(p_w)·e^{x/κ}) − p_w with x = ln(r/r_baseline) − α (T − T_b).

    The ends of the interval are those of x, mapped like x, because f is monotone. Three errors are
    added in quadrature: that of the estimate, separately for both sides, |T − T_b|·σ_α, and
    `response_sd`·|x|. If the scene names a film, its memory of earlier frames is subtracted, and a
    possible residue is a further error.

    Raises ValueError where shapes disagree, a ratio is not positive and finite, or lies outside its
    interval.

    Parameters
    ----------
    ratio : array, shape (frames, rows, columns)
        r/r_baseline; NaN where a frame failed.
    lower, upper : array, same shape
        Ends of its 95 % interval; 0 and infinity where that is open, `ratio` itself at a bound.
    scene : Scene
    time : array, shape (frames,), optional
        s; by default frames are a second apart.
    known : FilmKnown, optional
        Strengths of the film's memory; by default those of the scene.
    tare : Tare, optional
        Conditions of a new zero; by default there is none.
    own : array, same shape, optional
        Standard deviation of log ratio of each cell's own error; by default that of the whole
        interval.
    """
    _check_ratio(ratio, lower, upper, scene.panel.shape)
    track = PressureTrack.begin(scene, known, tare)
    if not track.remembers:
        return track.pressure(ratio, lower, upper, 0.0, own)
    frames = list[Pressure]()
    tared = list[str]()
    times = np.arange(float(len(ratio))) if time is None else time
    for number, at in enumerate(times.tolist()):
        frame_own = None if own is None else own[number]
        frames.append(track.pressure(ratio[number], lower[number], upper[number], at, frame_own))
        track = track.after(ratio[number], at)
        tared.append(track.tared)
    maps = [name for name in vars(frames[0]) if name != "tared"]
    return Pressure(
        **{name: np.stack([getattr(frame, name) for frame in frames]) for name in maps},
        tared=tuple(tared),
    )


def _check_ratio(ratio: Array, lower: Array, upper: Array, shape: tuple[int, int]) -> None:
    """Raise ValueError unless ratios are positive, within their intervals, and maps of a panel."""
    if ratio.shape[1:] != shape or not ratio.shape == lower.shape == upper.shape:
        raise ValueError(
            "ratio, lower and upper must all be frames × rows × columns of the scene's panel"
        )
    usable = np.isfinite(ratio) & (ratio > 0) & (lower >= 0) & (lower <= ratio) & (upper >= ratio)
    if not np.all(usable | (np.isnan(ratio) & np.isnan(lower) & np.isnan(upper))):
        raise ValueError(
            "a resistance over its unloaded value must be positive, finite and within its interval"
        )


@dataclass(frozen=True, eq=False)
class PressureTrack:
    """State of the film between frames, from which the pressure of the next frame is computed.

    Attributes
    ----------
    scene : Scene
    films : FilmMemory
        The mean film, then films with one strength increased by a standard deviation, (films, rows,
        columns).
    zeros : array, shape (films, rows, columns)
        ln(r/r_rest) of the present zero, without the memory.
    peak : array, shape (rows, columns)
        Largest |ln(r/r_rest)| so far.
    residue : float
        Share of `peak` that may remain after a load.
    time, zeroed : float or None
        Times of the last frame and of the zero, s; None before them.
    watch : TareWatch or None
        State of the automatic tare; None without it.
    tared : str
        Reason for a new zero after the last frame, or ''.
    """

    scene: Scene
    films: FilmMemory
    zeros: Array
    peak: Array
    residue: float
    time: float | None = None
    zeroed: float | None = None
    watch: TareWatch | None = None
    tared: str = ""

    @classmethod
    def begin(
        cls, scene: Scene, known: FilmKnown | None = None, tare: Tare | None = None
    ) -> "PressureTrack":
        """Return the track before the first frame; `known` and `tare` as in `pressure_of`."""
        known = known or FilmKnown.specified(scene.film or Film())
        water = water_pressure(scene.panel, scene.water)
        films = known.at_rest(water, scene.response or PUBLISHED)
        residue = known.residue * known.film.remembers
        watch = None if tare is None else TareWatch(tare)
        return cls(
            scene, films, np.zeros(films.gain.shape), np.zeros(water.shape), residue, watch=watch
        )

    @property
    def remembers(self) -> bool:
        """Whether the pressure of a frame depends on earlier frames."""
        return self.scene.film is not None or self.watch is not None

    def pressure(
        self, ratio: Array, lower: Array, upper: Array, time: float, own: Array | None = None
    ) -> Pressure:
        """Return the pressure of the next frame at a time in s.

        A film without memory permits several frames at once.

        Parameters
        ----------
        ratio, lower, upper : array, shape (rows, columns) or (frames, rows, columns)
            As in `pressure_of`.
        time : float
            s.
        own : array, optional
            As in `pressure_of`.
        """
        change = self._change(ratio)
        # The mean film, and the alternatives with one strength increased: their differences are
        # errors by the film's memory.
        answer, *varied_answers = -self._of_films(self.films.at_once, change, time)
        expected, *varied_pressures = self._of_films(self.films.pressure, change, time)
        memory_kpa = _distance(varied_pressures, expected)
        of_change = self._pressure_by_change(change, expected, time)
        # Error bars: estimate, residue and temperature, and response in quadrature in ln r; then
        # mapped to pressure.
        resting_sd = self._resting_sd(ratio, time)
        shared = TWO_SIDED * self._shared_sd(answer, resting_sd)
        with np.errstate(divide="ignore"):
            fell = np.log(ratio) - np.log(lower)
            rose = np.log(upper) - np.log(ratio)
        below = np.hypot(fell, shared)
        above = np.hypot(rose, shared)
        least = expected - np.hypot(expected - of_change(above), TWO_SIDED * memory_kpa)
        least = np.maximum(least, VACUUM_KPA - self.films.water)
        most = expected + np.hypot(of_change(-below) - expected, TWO_SIDED * memory_kpa)
        errors = (of_change(-below / TWO_SIDED) - of_change(above / TWO_SIDED)) / 2
        errors = np.hypot(errors, memory_kpa)
        own_sd = (fell + rose) / (2 * TWO_SIDED) if own is None else own
        scatter = np.hypot(own_sd, scatter_sd(self.scene) * answer)
        individual, common = _own_and_common(errors, of_change, scatter)
        with np.errstate(invalid="ignore"):
            fall_sd = np.hypot(
                np.hypot(rose / TWO_SIDED, resting_sd), _distance(varied_answers, answer)
            )
            clear = -answer > NOISE_REACH * fall_sd
        pressing = clear & (expected > 0) & ~self.scene.broken
        lowest, highest = self.films.response.told_kpa
        return Pressure(
            pressure=expected,
            lower=least,
            upper=most,
            errors=errors,
            own=individual,
            common=common,
            saturated=np.asarray(
                (least + self.films.water < lowest) | (most + self.films.water > highest)
            ).astype(np.uint8),
            pressing=pressing.astype(np.uint8),
        )

    def _shared_sd(self, answer: Array, resting_sd: Array) -> Array:
        """Return the standard deviation of ln r by the film, in the mean and in each cell.

        Parameters
        ----------
        answer : array
            −ln r/r_rest without creep.
        resting_sd : array
            Standard deviation of ln r/r_rest without a load.
        """
        bent_sd = 0.0 if self.scene.film is None else self.scene.film.answer_sd
        relative_sd = np.hypot(response_sd(self.scene, answer), bent_sd)
        return np.hypot(resting_sd, relative_sd * answer)

    def _pressure_by_change(
        self, change: Array, expected: Array, time: float
    ) -> Callable[[Array], Array]:
        """Return the function of `moved` → p if ln r differed by `moved` at all times.

        Hysteresis loops scale with the load.

        Parameters
        ----------
        change, expected : array
            ln r/r_rest, and the pressure of the mean film, kPa.
        time : float
            s.
        """
        effective, *_ = self._of_films(self.films.effective, change, time)
        share = np.where(effective == 0, 1.0, expected / np.where(effective == 0, 1.0, effective))
        return lambda moved: np.asarray(
            share * self._of_films(self.films.effective, change + moved, time)[0]
        )

    def after(self, ratio: Array, time: float) -> "PressureTrack":
        """Return the track after a frame of r/r_baseline (rows, columns) at a time in s.

        NaN leaves cells unchanged.
        """
        if not self.remembers:
            return self
        change = self._change(ratio)
        seconds = self._seconds(time)
        track = self
        if np.isfinite(change).any():
            track = replace(
                self,
                films=self.films.observed(change - self.zeros, seconds),
                time=time,
                zeroed=time if self.zeroed is None else self.zeroed,
                peak=np.fmax(self.peak, np.abs(change)),
            )
        if self.watch is None:
            return track
        memory = self.films.fading(seconds)[0]
        zero = self.zeros[0]
        watch, moved, tared = self.watch.after(change - (memory + zero), memory, time)
        if moved is not None:
            remembered = track.films.fading(track._seconds(time))[0]
            track = track._zeroed(moved + (remembered + zero), time)
        return replace(track, watch=watch, tared=tared)

    def rebased(self, time: float) -> "PressureTrack":
        """Return the track with the present, unloaded panel as the baseline from a time in s on."""
        watch = None if self.watch is None else TareWatch(self.watch.tare, time)
        return replace(self._zeroed(np.zeros(self.scene.panel.shape), time), watch=watch)

    def _zeroed(self, change: Array, time: float) -> "PressureTrack":
        """Return the track after an unloaded frame.

        The change that the memory does not explain is the new zero.
        """
        zeros = change - self.films.fading(self._seconds(time))
        return replace(self, zeros=np.where(np.isfinite(change), zeros, self.zeros), zeroed=time)

    def _seconds(self, time: float) -> float:
        """Return the time since the last frame, s; 1 s for the first frame."""
        return 1.0 if self.time is None else max(time - self.time, MIN_PERIOD)

    def _change(self, ratio: Array) -> Array:
        return np.log(ratio) - self.scene.common_change[0]

    def _resting_sd(self, ratio: Array, time: float) -> Array:
        """Return the standard deviation of ln r/r_rest without a load.

        The film's residue, drift and common change cause it. Residue and drift are multiplied by
        √(1 − x²/peak²), because they show as far as the largest load is gone.
        """
        spread: Array | float = 0.0
        if self.residue and self.zeroed is not None:
            drift = drift_sd((time - self.zeroed) / 60)
            gone = 1 - (self._change(ratio) / np.maximum(self.peak, MIN_TOUCH)) ** 2
            spread = np.hypot(self.residue * self.peak, drift) * np.sqrt(np.maximum(gone, 0.0))
        return np.hypot(spread, self.scene.common_change[1])

    def _of_films(
        self, value: Callable[[Array, float], Array], change: Array, time: float
    ) -> Array:
        """Return a method of `FilmMemory` of a frame for all films, (films, …).

        The method is `at_once`, `effective` or `pressure`.

        Parameters
        ----------
        value : callable
        change : array, shape (…, rows, columns)
            ln r/r_rest.
        time : float
            s.
        """
        return np.moveaxis(value(change[..., None, :, :] - self.zeros, self._seconds(time)), -3, 0)


def _own_and_common(
    errors: Array, of_change: Callable[[Array], Array], scatter: Array
) -> tuple[Array, Array]:
    """Return each cell's own part of the errors, kPa, and the part that cells share.

    Parameters
    ----------
    errors : array
        Half the 68 % interval, kPa.
    of_change : callable
        Pressure if ln r differed by an amount.
    scatter : array
        Standard deviation of ln r by each cell's own errors.
    """
    with np.errstate(invalid="ignore"):
        own = np.minimum(np.abs(of_change(scatter) - of_change(-scatter)) / 2, errors)
        common = np.sqrt(np.maximum(errors**2 - own**2, 0.0))
    return own, np.where(np.isinf(errors), np.inf, common)


def _distance(alternatives: Iterable[Array], expected: Array) -> Array:
    """Return √Σ (alternative − expected)², of any shape."""
    return np.asarray(
        np.sqrt(np.sum([(alternative - expected) ** 2 for alternative in alternatives], axis=0))
    )


def response_sd(scene: Scene, answer: Array) -> Array:
    """Return the relative standard deviation of ln(r/r0) at a pressure.

    The scatter of the cells and the uncertain curve cause it.

    Parameters
    ----------
    scene : Scene
    answer : array, shape (…, rows, columns)
        ln(r/r0).
    """
    response = scene.response or PUBLISHED
    curve = response.curve_sd(response.pressure(answer / response.gains))
    return np.hypot(scatter_sd(scene), curve)


def scatter_sd(scene: Scene) -> Array:
    """Return each cell's own part of `response_sd`.

    The sources are, in this order, measured gains, the specified error, and RESPONSE_SD.
    """
    errors = systematic_of(scene)
    assumed = RESPONSE_SD if errors is None or errors.response_sd is None else errors.response_sd
    measured = None if scene.response is None else scene.response.gain_sd
    return np.array(assumed if measured is None else measured)


KPA_MM2 = 1e-3  # force of one kPa on a square millimetre, newton


class Force(NamedTuple):
    """Total force.

    Attributes
    ----------
    newton, deviation : float
        Force and its standard deviation in newtons; NaN where unknown.
    saturated : int
        Number of saturated cells; with any the force is a lower bound.
    """

    newton: float
    deviation: float
    saturated: int = 0


def determined(scene: Scene, pressure: Array, *errors: Array) -> tuple[Array, ...]:
    """Return p and its errors, limited to the range that the response determines.

    Shape (…, rows, columns), kPa. At the limit the error is 0.
    """
    if scene.response is None:
        return pressure, *errors
    most = scene.response.told_kpa[1] - water_pressure(scene.panel, scene.water)
    return np.minimum(pressure, most), *(np.where(pressure < most, error, 0.0) for error in errors)


def sum_sd(weight: Array | float, own: Array, common: Array) -> float:
    """Return the standard deviation of Σ w·p over cells (n,), √(Σ (w·own)² + (Σ w·common)²)."""
    return float(np.hypot(np.sqrt(np.sum((weight * own) ** 2)), np.sum(weight * common)))


def total_force(scene: Scene, load: Pressure) -> Force:
    """Return the force of one frame, Σ p·pitch² over the pressed cells."""
    area = scene.panel.pitch_mm**2 * KPA_MM2
    pressed = load.pressing != 0
    kpa, own, common = (
        part[pressed] for part in determined(scene, load.pressure, load.own, load.common)
    )
    return Force(
        float(area * kpa.sum()),
        sum_sd(area, own, common),
        int(np.sum((load.saturated != 0) & pressed)),
    )
