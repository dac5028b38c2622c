"""Detection of periodic changes of a load's suction, by Bayesian odds of a sinusoid.

Changes of suction and rim are proportional to the slopes ∂x/∂ln p of the cells on the film's response. The relative
amplitude s_t in a window is a weighted mean of the readings, less a trend, with the model

    s_t = a cos 2πft + b sin 2πft + noise,   a, b ~ N(0, A²),   noise ~ N(0, σ²).

The odds compare the A of breathing with that of tremble, summed over f and σ.
Source: Bretthorst, Bayesian Spectrum Analysis and Parameter Estimation, 1988; docs/theory/recognition.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, inf, log
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.special import expit, logit, logsumexp

from lampest.files.levels import MAD_TO_SIGMA, NOISE_REACH, SIGNIFICANT
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import EVIDENCE_SHARE, MAX_ROUNDS, RARE_LOG_ODDS, Fit
from lampest.loads.recognition.observation import Observation
from lampest.loads.recognition.suction import MIN_FALL
from lampest.panel.panel import Array
from lampest.panel.response import CURVE_KPA, CURVE_RATIO, RESPONSE_SD, PublishedResponse

RATES_HZ = (0.5, 2.5)  # of breathing; sea lampreys at rest 0.8 to 1.6 Hz
PRIOR_ODDS = 10.0  # assumed, of suction that oscillates to the rim alone, and to the place or the tilt
LEAKS = 2.0  # over the duration: distance of rates beyond which a tapered wave does not leak
MAX_RATE_SHARE = 0.475  # of the frame rate: at half of it a wave may show nothing
MIN_FRAMES = 13  # that determine a rhythm: six numbers of wave and trend, and as many again
MIN_PART = 4  # frames between two steps, with which a part says more than its mean
MIN_RATE_HZ = 3.8  # frames per second: four with a slow clock; they resolve rates up to 2 Hz
# A: the mean amplitude of mouths is 5.4 % of their suction (docs/studies/mouths.md). That of loads that do not breathe
# is an assumption: cups tremble and leak, but at no single rate.
BREATHING_SD = 0.045
TREMBLE_SD = 0.002
# duration over which a rhythm is steady, and the least that determines one
WINDOW_S = 8.0
MIN_WINDOW_S = 4.5
# Largest amplitude of each cause, in units of its pattern. Suction: above 15 % the unevenness of a film would explain
# the swings of a shaken cup. The rim alone: all of its pressure. Movements: ten times their usual size.
MAX_SWINGS = {"own": 0.15, "rim": 1.0, "moves": 10.0}
# Assumed relative standard deviation of the whole rim's swing against that of suction, because the rim may press with
# more than it bears; and of each cell's change by a movement, because the places of edges on its film are unknown.
EDGE_SD = 0.5
# Assumed: of each cell's swing with the suction, over the root mean square of all cells; and of the depth of breath, by
# a curve under suction that was not measured.
OWN_SD = 0.1
CURVE_SD = 0.27
MAX_PULL = 3.0  # largest suction that counts over that of the recognised frame, and the inverse of the smallest
THRESHOLD_KPA = -2.0  # suction from which an alternative curve through the published point may begin, instead of 0 kPa
MAX_LOG_ODDS = 10.0  # upper limit of accumulated ln odds of breathing

Pair = tuple[float, float]


def too_slow(rate: float) -> str:
    """Return the reason why a frame rate is too low to determine breathing, in words; '' where it suffices."""
    return "" if rate >= MIN_RATE_HZ else f"breathing shows at four frames a second or more, here there are {rate:.3g}"


@dataclass(frozen=True)
class Breath:
    """Breath in one window.

    Attributes
    ----------
    odds : float
        ln of P(window | oscillation)/P(window | none).
    suction : float
        Probability that the suction oscillates, and not the rim alone, the place or the tilt.
    hertz, depth : (float, float)
        Rate in Hz and relative amplitude, each with its standard deviation.
    """

    odds: float
    suction: float
    hertz: Pair
    depth: Pair


@dataclass(frozen=True)
class Breathing:
    """Breath of an attachment, from all windows.

    Attributes
    ----------
    odds, previous_odds : float
        ln odds of an oscillation at a breathing rate, with and without the last window.
    suction, last : float
        Probability that the suction oscillates, by all windows, and by the last window alone.
    causes : float
        ln odds of the same by full windows, without the prior odds.
    hertz, depth : (float, float) or None
        Rate in Hz and relative amplitude, each with its standard deviation, from the last window that determines them.
    full_s, judged_s : float
        Times of the last frame of the last full window, and of the last window, s.
    """

    odds: float = 0.0
    previous_odds: float = 0.0
    suction: float = 1.0
    last: float = 0.5
    causes: float = 0.0
    hertz: Pair | None = None
    depth: Pair | None = None
    full_s: float = -inf
    judged_s: float = -inf

    @property
    def probability(self) -> float:
        """Probability that suction oscillates at a breathing rate; 1/2 before any observation."""
        return self.suction * float(expit(self.odds))

    def parted(self, steps: Sequence[float]) -> "Breathing":
        """Return the breath after steps at times in s: one ends a window that determined a rhythm.

        The swings after a pull are others. They begin a window of their own, and do not replace the odds of this one.
        """
        if self.odds == self.previous_odds or not any(step > self.judged_s for step in steps):
            return self
        return replace(self._caused(self.last), previous_odds=self.odds, full_s=self.judged_s)

    def _caused(self, suction: float) -> "Breathing":
        """Return the breath with one more window, in which suction oscillates with this probability."""
        window = logit(suction) - np.log(PRIOR_ODDS / 2)
        causes = float(np.clip(self.causes + window, -MAX_LOG_ODDS, MAX_LOG_ODDS))
        return replace(self, suction=float(expit(causes + np.log(PRIOR_ODDS / 2))), causes=causes)

    def after(self, seen: Breath | None, time: float, *, full: bool) -> "Breathing":
        """Return the breath after a window that ends at a time in s; of a full one the odds are kept.

        Assumptions: one mouth in twenty never shows its breath, because it is faint or at half the frame rate, and a
        mouth pauses in one window of twenty. The odds of full windows multiply. Of incomplete windows, two successive
        ones have to agree that the suction oscillates: with the last one alone, two of 75 shaken cups were taken for
        lampreys for a second (docs/studies/mouths.md).
        """
        judged = replace(self, judged_s=time, full_s=time if full else self.full_s)
        return judged if seen is None else judged._weighed(seen, full=full)

    def _weighed(self, seen: Breath, *, full: bool) -> "Breathing":
        # ln odds ← clip(ln odds + ln(0.05 + 0.95 B), −ln 20, 10)
        window = np.logaddexp(-RARE_LOG_ODDS, np.log1p(-exp(-RARE_LOG_ODDS)) + seen.odds)
        odds = float(np.clip(self.previous_odds + window, -RARE_LOG_ODDS, MAX_LOG_ODDS))
        breathing = replace(self, odds=odds, previous_odds=odds if full else self.previous_odds)
        if self.hertz is not None and (seen.odds <= 0 or (self.previous_odds != 0 and not full)):
            return breathing
        described = replace(breathing, hertz=seen.hertz, depth=seen.depth, last=seen.suction)
        if not full:
            return replace(described, suction=min(seen.suction, self.last))
        return described._caused(seen.suction)


class Patterns(NamedTuple):
    """Effects of swings on whitened readings, as roots of their covariance at unit amplitude, (readings, n) each.

    Attributes
    ----------
    own : array
        Suction with its rim: the first column is the mean effect, the others are possible deviations of the film.
    rim : array
        The rim alone.
    moves : array
        Place and tilt of the load.
    others : array
        Further changes of any size, which are projected out.
    curve : float
        Relative standard deviation of the depth by a curve under suction that was not measured.
    """

    own: Array
    rim: Array
    moves: Array
    others: Array
    curve: float = 0.0

    @classmethod
    def of(
        cls,
        by_cell: Array,
        rise: Array,
        slopes: Array,
        spread: Array,
        moves: Array,
        others: Array,
        *,
        curve: float = 0.0,
    ) -> "Patterns":
        """Return the patterns of a load.

        Parameters
        ----------
        by_cell : array, shape (readings, cells)
            Derivatives of the whitened readings by ln r.
        rise : array, shape (cells,)
            ln r/r0, negative under the rim.
        slopes : array, shape (1 + n, cells)
            Mean of ∂(ln r/r0)/∂ln p, and n common deviations of it.
        spread : array, shape (cells,)
            Standard deviation of each cell's own slope.
        moves : array, shape (moves, cells)
            Changes of ln r/r0 by movements of usual size.
        others : array, shape (readings, m)
            Further changes.
        curve : float
        """
        mean = slopes[0]
        rim = rise < 0
        spread = np.hypot(spread, OWN_SD * np.sqrt(np.mean(mean**2)))
        suction = np.column_stack([mean, EDGE_SD * rim * mean, slopes[1:].T, np.diag(spread)])
        rigid = np.delete(suction, 1, axis=1) * rim[:, None]
        changes = np.linalg.norm(moves, axis=0)
        moving = np.column_stack([moves.T, np.diag(EDGE_SD * np.hypot(changes, np.sqrt(np.mean(changes**2))))])
        return cls(by_cell @ suction, by_cell @ rigid, by_cell @ moving, others, curve)

    def beside_others(self, changes: Array) -> tuple["Patterns", Array]:
        """Return the patterns and the changes (frames, readings), projected on the complement of `others`."""
        span = np.linalg.qr(self.others)[0]
        suction, rim, moves, left = (
            pattern - span @ (span.T @ pattern) for pattern in (self.own, self.rim, self.moves, changes.T)
        )
        return Patterns(suction, rim, moves, self.others, self.curve), left.T

    def seen_by(self, whitening: Array) -> "Patterns":
        """Return the patterns of readings that are whitened once more, by (readings, readings)."""
        own, rim, moves, others = (whitening @ pattern for pattern in self[:4])
        return Patterns(own, rim, moves, others, self.curve)

    def weights(self, depth: float, noise: float, moving: float = 0.0) -> Array:
        """Return the weights (readings,) with which readings sum to the amplitude of suction, with least variance.

        Parameters
        ----------
        depth : float
            Amplitude at which the film's deviations are taken.
        noise : float
            Variance of each reading.
        moving : float
            Standard deviation of simultaneous changes of the rim alone, the place and the tilt.
        """
        mean = self.own[:, 0]
        film = np.hstack([depth * self.own[:, 1:], moving * self.rim, moving * self.moves])
        # w = C⁻¹ m/(mᵀ C⁻¹ m), with C = noise + F Fᵀ of the film's deviations and movements
        weighed = np.linalg.solve(noise * np.eye(len(mean)) + film @ film.T, mean)
        return np.asarray(weighed / max(float(mean @ weighed), 1e-300))

    def suction_weights(self, whitening: Array) -> Array:
        """Return the weights (readings,) with which changes of ln y sum to the relative change of the load's suction.

        Changes common to all readings and those of other loads are excluded; those of the load's place and of its rim
        alone have little weight. `whitening` (readings, readings) whitens changes of ln y.
        """
        suction, _ = self.beside_others(np.zeros((1, len(whitening))))
        return np.asarray(whitening.T @ suction.weights(MAX_SWINGS["own"], 1.0, EDGE_SD))


def patterns_of(frame: Observation, fit: Fit, whitening: Array, detector: Detector) -> list[Patterns | None]:
    """Return the patterns of every load of a fit; None for loads that do not suck.

    Parameters
    ----------
    frame : Observation
        The recognised frame.
    fit : Fit
        Its fit.
    whitening : array, shape (readings, readings)
        Whitens changes of ln y.
    detector : Detector
    """
    loads = fit.loads
    panel = frame.panel
    first = 0
    patterns: list[Patterns | None] = [None] * len(loads)
    if not any(part.sucks for part, _ in loads):
        return patterns
    departure, covariance = detector.departure(frame, fit)
    rise = fit.change + departure
    by_cell = whitening @ (frame.slope(rise) / frame.measured.ravel()[:, None])
    slopes = _slopes(frame, rise, fit.scatter)
    spread = np.sqrt((slopes[1:-1] ** 2).sum(axis=0) + slopes[0] ** 2 * (fit.scatter**2 + np.diag(covariance)))
    cells = [part.pressure(panel, detector.patch_mm, own)[0].ravel() != 0 for part, own in loads]
    # cells of other loads, and of bodies beside, which move by themselves
    changed = (
        np.any(cells, axis=0) | (np.abs(frame.free_map) > np.maximum(MIN_FALL, NOISE_REACH * frame.free_sd)).ravel()
    )
    curve = CURVE_SD if isinstance(frame.baseline.response, PublishedResponse) else 0.0
    _, by_parameter = detector.fitting(fit.candidate, frame).effect(fit.parameters)
    for number, ((part, own), under) in enumerate(zip(loads, cells, strict=True)):
        if part.sucks:
            sways = np.array([prior.sway for prior in part.priors(panel).values()])[:, None]
            moves = (sways * by_parameter[first : first + len(own), under])[sways[:, 0] > 0]
            others = np.column_stack([whitening.sum(axis=1), by_cell[:, changed & ~under]])
            own_cells = by_cell[:, under], rise.ravel()[under], slopes[:, under], spread[under]
            patterns[number] = Patterns.of(*own_cells, moves, others, curve=curve)
        first += len(own)
    return patterns


class SteadyFrames(NamedTuple):
    """Frames of a window without those in which the readings step.

    Attributes
    ----------
    times : array, shape (frames,)
        s.
    logarithms : array, shape (frames, readings)
        ln y.
    part : integer array, shape (frames,)
        Number of the steps before each frame.
    period : float
        Median step of time, s.
    """

    times: Array
    logarithms: Array
    part: NDArray[np.intp]
    period: float

    @classmethod
    def of(cls, times: Array, logarithms: Array, steps: Sequence[float] = ()) -> "SteadyFrames":
        """Return the interval of all frames but the ones about steps, and but parts of less than MIN_PART frames."""
        none = np.zeros(len(times), dtype=np.intp)
        return cls(times, logarithms, none, float(np.median(np.diff(times)))).parted(steps)[0]

    def parted(self, steps: Sequence[float]) -> tuple["SteadyFrames", NDArray[np.bool_]]:
        """Return the interval with further steps, and which of its frames are left, (frames,)."""
        at = np.array(sorted(steps))
        apart = np.searchsorted(at, self.times) + (len(at) + 1) * self.part
        still = np.all(np.abs(self.times - at[:, None] - self.period / 2) > 1.6 * self.period, axis=0)
        still &= np.array([np.sum(still & (apart == number)) >= MIN_PART for number in apart], dtype=bool)
        _, part = np.unique(apart[still], return_inverse=True)
        return SteadyFrames(self.times[still], self.logarithms[still], part, self.period), still

    def only(self, frames: NDArray[np.bool_]) -> "SteadyFrames":
        """Return the interval of some frames, (frames,)."""
        _, part = np.unique(self.part[frames], return_inverse=True)
        return SteadyFrames(self.times[frames], self.logarithms[frames], part, self.period)

    def pulled(self, series: Array, wave: float) -> tuple[float, ...]:
        """Return the times between which a series, (frames,), is at another level; () where a wave explains it better.

        Both ends of the best level, or one, are compared by the squares that they explain, `wave` by the best wave.
        """
        trend = self.trend()
        count = len(series)
        begins, ends = np.triu_indices(count + 1, MIN_PART)
        numbers = np.arange(count)[:, None]
        level = ((numbers >= begins) & (numbers < ends)).astype(float)
        level -= trend @ (trend.T @ level)
        size = np.sum(level**2, axis=0)
        explained = np.where(size > 1e-3, (level.T @ series) ** 2 / np.maximum(size, 1e-3), 0.0)
        best = int(np.argmax(explained))
        total = float(series @ series)
        scatter = (total - explained[best]) / max(count - trend.shape[1] - 1, 1)
        if explained[best] <= max(wave, SIGNIFICANT**2 * scatter):
            return ()
        edges = (int(edge) for edge in (begins[best], ends[best]))
        return tuple(float(self.times[edge - 1]) for edge in edges if 0 < edge < count)

    def trend(self) -> Array:
        """Return an orthonormal basis of 1, t, t², ln(1 + t), the last for creep, and of a step between the parts."""
        at = (self.times - self.times[0]) / max(float(np.ptp(self.times)), self.period)
        steps = [self.part > number for number in range(self.part.max(initial=0))]
        return np.linalg.qr(np.column_stack([np.ones_like(at), at, at**2, np.log1p(10 * at), *steps]))[0]


def breath(interval: SteadyFrames, changes: Array, patterns: Patterns) -> Breath | None:
    """Return the breath of a window; None where it is too short or frames are too few.

    The breath is steady in the whole window, or in one of its parts, because a pull changes the swings: each is as
    probable as the others.

    Parameters
    ----------
    interval : SteadyFrames
    changes : array, shape (frames, readings)
        Whitened changes of ln y.
    patterns : Patterns
    """
    suction: Array = np.ones(len(interval.times))
    spans: list[NDArray[np.bool_]] = [np.ones(len(interval.times), dtype=bool)]
    if interval.part.any():
        suction = _relative_suction(interval, changes, patterns)
        spans += [interval.part == number for number in range(interval.part.max() + 1)]
    breaths = [_steady_breath(interval.only(span), changes[span], patterns, suction[span]) for span in spans]
    known = [steady for steady in breaths if steady is not None]
    best = max(known, key=attrgetter("odds"), default=None)
    return None if best is None else replace(best, odds=best.odds - log(len(known)))


def _steady_breath(interval: SteadyFrames, changes: Array, patterns: Patterns, suction: Array) -> Breath | None:
    """Return the breath of a window in which it is steady, with the relative `suction`, (frames,)."""
    times = interval.times
    rate = 1 / interval.period
    if len(times) < MIN_FRAMES or rate < MIN_RATE_HZ:
        return None
    lasted = float(times[-1] - times[0])
    # Remove the trend, and the changes of `others`.
    at = (times - times[0]) / lasted
    trend = interval.trend()
    all_patterns = patterns
    all_changes = changes
    patterns, changes = patterns.beside_others(changes - trend @ (trend.T @ changes))
    # Sine and cosine at every rate without their trend, as orthonormal axes (rates, 2, frames) with their gains.
    hertz = np.arange(RATES_HZ[0], min(RATES_HZ[1], MAX_RATE_SHARE * rate), 0.25 / lasted)
    waves = np.exp(2j * np.pi * hertz[:, None] * times)
    waves = np.stack([waves.real, waves.imag], axis=2)
    even_waves = waves
    waves = suction[:, None] * waves
    axes, sizes, _ = np.linalg.svd(waves - trend @ (trend.T @ waves), full_matrices=False)
    axes = np.swapaxes(axes, 1, 2)
    gain = sizes**2
    swings = axes @ changes  # (rates, 2, readings)
    # Movements at all rates, and noise, by tapered waves at rates that the strongest one does not leak into.
    strongest = hertz[np.argmax((swings**2).sum(axis=(1, 2)))]
    far = even_waves[np.abs(hertz - strongest) > LEAKS / lasted] * (np.sin(np.pi * at) ** 2)[:, None]
    far = np.swapaxes(far / np.linalg.norm(far, axis=1, keepdims=True), 1, 2)
    others = far @ changes
    noise = max(1.0, float(np.quantile((others**2).mean(axis=(1, 2)), 0.25))) if len(others) else 1.0
    loud = max(1.0, float(np.quantile((swings**2).mean(axis=(1, 2)), 0.25)))  # with what the wave leaks into others
    others = others.reshape(-1, swings.shape[2])
    root = cholesky(noise * np.eye(swings.shape[2]) + others.T @ others / max(len(others), 1), lower=True)
    whitening = solve_triangular(root, np.eye(len(root)), lower=True)
    steadied = patterns.seen_by(whitening)
    swings = swings @ whitening.T
    # Amplitudes a, b of s_t at every rate, and the odds of A = BREATHING_SD against A = TREMBLE_SD.
    series = changes @ whitening.T @ steadied.weights(TREMBLE_SD, 1 / gain.mean())
    amplitude = axes @ series
    total = float(series @ series)
    power = (amplitude**2).sum(axis=1)
    if pulled := interval.pulled(series, float(power.max())):
        interval, left = interval.parted(pulled)
        return breath(interval, all_changes[left], all_patterns)
    freedom = len(times) - trend.shape[1]
    best = int(np.argmax(power))
    breathing, steady = (logsumexp(_evidence(total, amplitude, gain, sd, freedom)) for sd in (BREATHING_SD, TREMBLE_SD))
    left = max(total - power[best], 1e-12) / (freedom - 2)
    spread = np.sqrt(3 * left / max(power[best], 1e-12)) / (np.pi * lasted)  # Rife, Boorstyn, IEEE Trans. IT-20, 1974
    return Breath(
        float(breathing - steady),
        _suction(steadied, swings, 1.0, float(gain.mean())),
        (float(hertz[best]), float(np.hypot(spread, 0.25 / lasted / 12**0.5))),
        _depth(patterns, changes, waves[best] - trend @ (trend.T @ waves[best]), at, loud / float(gain.mean())),
    )


def _relative_suction(interval: SteadyFrames, changes: Array, patterns: Patterns) -> Array:
    """Return the suction of each frame's part over that of the recognised frame, (frames,).

    A breath swings by a share of the suction. While that is pulled, it is larger, and so are the swings.
    """
    level = changes @ patterns.suction_weights(np.eye(changes.shape[1]))
    means = np.bincount(interval.part, level) / np.bincount(interval.part)
    return np.asarray(np.clip(1 + means, 1 / MAX_PULL, MAX_PULL)[interval.part])


def _depth(patterns: Patterns, changes: Array, waves: Array, at: Array, noise: float) -> tuple[float, float]:
    """Return the relative amplitude of the suction and its standard deviation.

    The amplitude and the phase of the wave may change linearly over the window. A film with hysteresis shows the share
    1 − RESPONSE_SD of a swing, by which both are divided.

    Parameters
    ----------
    patterns : Patterns
    changes : array, shape (frames, readings)
        Whitened changes of ln y.
    waves : array, shape (frames, 2)
        Sine and cosine at the best rate.
    at : array, shape (frames,)
        Time within the window, from 0 to 1.
    noise : float
        Variance of the amplitude in each reading.
    """
    basis = np.hstack([waves, 12**0.5 * (at[:, None] - 0.5) * waves])
    depth = BREATHING_SD
    variance = 0.0
    square = basis.T @ basis
    for _ in range(MAX_ROUNDS):
        weights = patterns.weights(depth, noise)
        series = changes @ weights
        # amplitudes with the prior N(0, MAX_SWINGS²), which near half the frame rate alone decides
        freedom = max(len(at) - 8, 1)  # four numbers here, four of trend
        residual = series - basis @ np.linalg.lstsq(basis, series, rcond=None)[0]
        left = max(float(residual @ residual) / freedom, 1e-12)
        covariance = np.linalg.inv(square / left + np.eye(4) / MAX_SWINGS["own"] ** 2)
        coefficients = covariance @ (basis.T @ series) / left
        variances = np.diag(covariance)
        # A² from all four coefficients, less the noise of the two of linear change
        depth = max(float(coefficients @ coefficients - variances[2:].sum()), TREMBLE_SD**2) ** 0.5
        film = float(np.sum((weights @ patterns.own[:, 1:]) ** 2)) + RESPONSE_SD**2 + patterns.curve**2
        variance = depth**2 * film + float(variances[:2].mean())
    return depth / (1 - RESPONSE_SD), variance**0.5 / (1 - RESPONSE_SD)


def _evidence(total: float, amplitude: Array, gain: Array, sd: float, freedom: int) -> Array:
    """Return ln P(s | f) up to a constant, (rates,), summed over σ.

    Parameters
    ----------
    total : float
        Σ s².
    amplitude : array, shape (rates, 2)
        Projections of s on the axes.
    gain : array, shape (rates, 2)
        Squares of the axes' singular values.
    sd : float
        A.
    freedom : int
        Degrees of freedom of s.
    """
    noise = np.geomspace(1e-4, 1.0, 25)[:, None, None] ** 2
    wide = noise + sd**2 * gain
    remaining = total - (amplitude**2).sum(axis=1)
    # amplitude ~ N(0, σ² + A² gain), all other directions ~ N(0, σ²); axes (noises, rates, 2)
    fits = -0.5 * ((amplitude**2 / wide).sum(axis=2) + np.maximum(remaining, 0.0) / noise[..., 0])
    volume = -0.5 * (np.log(wide).sum(axis=2) + (freedom - 2) * np.log(noise[..., 0]))
    return np.asarray(logsumexp(fits + volume, axis=0))


def _suction(patterns: Patterns, swings: Array, noise: float, gain: float) -> float:
    """Return the probability that suction oscillates with its rim, not the rim alone nor the load's place or tilt.

    Each cause is taken at its own best rate, because the square of a movement oscillates at twice its rate.

    Parameters
    ----------
    patterns : Patterns
    swings : array, shape (rates, 2, readings)
        Projections of the readings on sine and cosine.
    noise : float
        Variance of the swings.
    gain : float
        Square of the swings at unit amplitude.
    """
    causes = ((gain**0.5 * getattr(patterns, name), most) for name, most in MAX_SWINGS.items())
    suction, *others = (_explained(root, most, swings, noise).max() for root, most in causes)
    # 1/w = 1 + Σ_causes (E_cause/E_own)^½/PRIOR_ODDS
    odds = EVIDENCE_SHARE * (suction - np.array(others)) + np.log(PRIOR_ODDS)
    return float(expit(-logsumexp(-odds)))


def _explained(root: Array, most: float, swings: Array, noise: float) -> Array:
    """Return ln of the ratio of P(swings | cause) to P(swings | noise), (rates,), averaged over sizes up to `most`.

    Parameters
    ----------
    root : array, shape (readings, n)
        Root B of the cause's covariance at unit amplitude.
    most : float
        Largest size a.
    swings : array, shape (rates, 2, readings)
    noise : float
        Variance σ² of the swings.
    """
    along, lengths, _ = np.linalg.svd(root, full_matrices=False)
    square = (swings @ along) ** 2 / noise
    sizes = np.geomspace(TREMBLE_SD, most, 13)
    wide = (sizes[:, None] * lengths) ** 2 / noise
    # swings ~ N(0, σ² + a² B Bᵀ): ½ Σ z² w/(1 + w) − ½ · 2 Σ ln(1 + w), with w = a² l²/σ² along each axis of B, for
    # sine and cosine
    evidence = np.tensordot(square.sum(axis=1), wide / (1 + wide), (1, 1)) / 2 - np.log1p(wide).sum(axis=1)
    return np.asarray(logsumexp(evidence, axis=1, b=1 / len(sizes)))


def _slopes(frame: Observation, rise: Array, scatter: float) -> Array:
    """Return ∂x/∂ln p of cells at x = `rise`, (7, cells): the mean, five deviations by the gain, and one by the curve.

    The gain differs by `scatter` and by bending; its distribution is sampled at Gauss-Hermite points. The published
    curve has one point under suction: a straight line of r, and an exponential beyond a threshold, are each one
    standard deviation from their geometric mean.
    """
    response = frame.baseline.response
    water = frame.water
    points, weights = hermegauss(5)
    gains = response.gains * np.exp(np.hypot(scatter, frame.baseline.model_errors.bent) * points[:, None, None])
    logarithm = rise / gains + response.logarithm(water)
    pressure = response.pressure(logarithm) - water
    more, lower = (response.logarithm(water + by * pressure) for by in (1 + BREATHING_SD, 1 - BREATHING_SD))
    rise = np.maximum(logarithm, 0.1)
    delay = np.log(CURVE_RATIO[0]) / (CURVE_KPA[0] / THRESHOLD_KPA - 1)
    straight = np.log(-np.expm1(-rise) / rise)
    delayed = np.log1p(delay / rise)
    unknown = (logarithm > 0) & isinstance(response, PublishedResponse)
    middle = unknown * (delayed + straight) / 2
    curve = unknown * (delayed - straight) / 2
    slopes = (gains * (more - lower) / (2 * BREATHING_SD) * np.exp(middle)).reshape(len(points), -1)
    shares = weights / weights.sum()
    mean = shares @ slopes
    common = shares @ (slopes * curve.reshape(slopes.shape))
    return np.vstack([mean, np.sqrt(shares)[:, None] * (slopes - mean), common])


def changes_without_water(interval: SteadyFrames, frame: Observation, fit: Fit) -> Array:
    """Return the changes of ln y, (frames, readings), since the recognised frame, less those by the water's pressure.

    Outliers of each part between steps are drawn in. The water's effect is estimated from lines without a load; it is 0
    if all lines are loaded.

    Parameters
    ----------
    interval : SteadyFrames
    frame : Observation
        The recognised frame.
    fit : Fit
        Its fit.
    """
    changes = interval.logarithms - np.log(frame.measured.ravel())
    for number in range(interval.part.max(initial=-1) + 1):
        own = interval.part == number
        changes[own] = settled(changes[own])
    loaded = fit.change != 0
    response = frame.baseline.response
    free = ~(loaded.any(axis=0) | loaded.any(axis=1)[:, None]).ravel()
    pressure = response.pressure(fit.change / response.gains + response.logarithm(frame.water)) - frame.water
    slope = frame.slope(fit.change) @ frame.change(pressure)[1].ravel() / frame.measured.ravel()
    return changes - np.outer(changes[:, free] @ slope[free] / max(float(slope[free] @ slope[free]), 1e-300), slope)


def settled(series: Array) -> Array:
    """Return a series (frames, …) clipped at four robust standard deviations from its median."""
    middle = np.median(series, axis=0)
    most = 4 * MAD_TO_SIGMA * np.median(np.abs(series - middle), axis=0)
    return np.asarray(np.clip(series, middle - most, middle + most))
