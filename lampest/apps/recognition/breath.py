"""Detection of a periodic change of a load's suction in one window, by Bayesian odds of a sinusoid.

The relative amplitude s_t in a window is a weighted mean of the readings, less a trend, with the
model

    s_t = Σ_k √q_k (a_k cos 2πf_k t + b_k sin 2πf_k t) + noise,   a_k, b_k ~ N(0, A²),
    noise ~ N(0, σ²),

where the rates f_k with shares q_k are those of a rate f that wanders. The odds compare the A of
breathing with that of jitter, summed over f and σ.
Source: Bretthorst, Bayesian Spectrum Analysis and Parameter Estimation, 1988;
docs/theory/recognition.md.
"""

from dataclasses import dataclass, replace
from math import log
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import expit, logsumexp

from lampest.apps.recognition.hypotheses import (
    BESIDE,
    BREATH,
    BREATHING_SD,
    EVIDENCE_SHARE,
    LEAK_SD,
    LEAK_SHARE,
    MOVES,
    RATES_HZ,
    RIM,
    TREMBLE_SD,
    WANDER,
    Cause,
)
from lampest.apps.recognition.most_probable import Whitening
from lampest.apps.recognition.steady_frames import SteadyFrames
from lampest.apps.recognition.swings import EDGE_SD, Patterns
from lampest.files.levels import SIGNIFICANT
from lampest.panel.panel import Array, Mask
from lampest.panel.response import RESPONSE_SD
from lampest.posterior.gaussian import Information

RATE_STEP = 0.25  # over the duration: distance of the rates that are compared
LEAKS = 2.0  # over the duration: distance of rates beyond which a tapered wave does not leak
MAX_RATE_SHARE = 0.475  # of the frame rate: at half of it a wave may show nothing
MIN_FRAMES = 13  # that determine a rhythm: six numbers of wave and trend, and as many again
MIN_RATE_HZ = 3.8  # frames per second: four with a slow clock; they resolve rates up to 2 Hz
# Largest suction that counts over that of the recognised frame, and the inverse of the smallest.
MAX_PULL = 3.0
SIZES = 13  # of a cause that are compared
DEPTH_ROUNDS = 4  # of weights at the depth of the round before

Pair = tuple[float, float]


def too_slow(rate: float) -> str:
    """Return the reason why a frame rate is too low to determine breathing, in words.

    The result is '' where it suffices.
    """
    if rate >= MIN_RATE_HZ:
        return ""
    return f"breathing shows at four frames a second or more, here there are {rate:.3g}"


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

    @property
    def probability(self) -> float:
        """Probability that the suction oscillates, with even prior odds of an oscillation."""
        return self.suction * float(expit(self.odds))


def breath(interval: SteadyFrames, changes: Array, patterns: Patterns) -> Breath | None:
    """Return the breath of a window; None where it is too short or frames are too few.

    The breath is steady in the whole window, or in one of its parts, because a pull changes the
    swings: each is as probable as the others.

    Parameters
    ----------
    interval : SteadyFrames
    changes : array, shape (frames, readings)
        Whitened changes of ln y.
    patterns : Patterns
    """
    suction = np.ones(len(interval.times))
    spans = [np.ones(len(interval.times), dtype=bool)]
    if interval.part.any():
        # A breath swings by a share of the suction. While that is pulled, it is larger, and so are
        # the swings.
        level = changes @ patterns.suction_weights(np.eye(changes.shape[1]))
        means = np.bincount(interval.part, level) / np.bincount(interval.part)
        suction = np.clip(1 + means, 1 / MAX_PULL, MAX_PULL)[interval.part]
        spans += [interval.part == number for number in range(interval.part.max() + 1)]
    breaths = [
        _steady_breath(interval.only(span), changes[span], patterns, suction[span])
        for span in spans
    ]
    determined = [steady for steady in breaths if steady is not None]
    best = max(determined, key=attrgetter("odds"), default=None)
    return None if best is None else replace(best, odds=best.odds - log(len(determined)))


def _steady_breath(
    interval: SteadyFrames, recorded: Array, patterns: Patterns, suction: Array
) -> Breath | None:
    """Return the breath of a window in which it is steady.

    The result is None where it is too short or frames are too few. Other movements hide a breath
    that is weaker than they are, unless they are its background. The strongest rate, and that at
    which the suction swings most besides, therefore have backgrounds of their own; each is as
    probable as the other.

    Parameters
    ----------
    interval : SteadyFrames
    recorded : array, shape (frames, readings)
        Whitened changes of ln y.
    patterns : Patterns
    suction : array, shape (frames,)
        Suction over that of the recognised frame.
    """
    times = interval.times
    rate = 1 / interval.period
    if len(times) < MIN_FRAMES or rate < MIN_RATE_HZ:
        return None
    lasted = float(times[-1] - times[0])
    with_bodies = interval.without_trend(recorded)
    own_patterns, changes = patterns.beside_others(with_bodies)
    hertz = np.arange(RATES_HZ[0], min(RATES_HZ[1], MAX_RATE_SHARE * rate), RATE_STEP / lasted)
    even_waves = _waves(hertz, times)
    waves = interval.without_trend(suction[:, None] * even_waves)
    even = _Axes.of(waves)
    level = changes @ own_patterns.weights(BREATH.largest, 1.0, EDGE_SD)
    pulled_s, pull = interval.pulled(level, even.axes)
    leaking_s, leak = interval.leaking(level, even.axes)
    if interval.leak_s == np.inf and leak > max(pull, SIGNIFICANT**2):
        return _steady_breath(interval._replace(leak_s=leaking_s), recorded, patterns, suction)
    if pull > SIGNIFICANT**2 and pulled_s:
        parts, remaining = interval.parted(pulled_s)
        return breath(parts, recorded[remaining], patterns)
    within = (times - times[0]) / lasted
    faded = even_waves * (np.sin(np.pi * within) ** 2)[:, None]
    window = _Window(
        lasted=lasted,
        within=within,
        hertz=hertz,
        waves=waves,
        even=even,
        wide=_Axes.of(interval.without_trend(suction[:, None] * _wandering(hertz, times))),
        leak=_Axes.of(interval.without_trend(interval.ramps()[1]).T[:, :, None]),
        tapered=np.swapaxes(faded / np.linalg.norm(faded, axis=1, keepdims=True), 1, 2),
        changes=changes,
        patterns=own_patterns,
        with_bodies=with_bodies,
        bodies=patterns,
        freedom=len(times) - interval.trend().shape[1],
    )
    breaths = [window.breath(*rates) for rates in window.rates(level, rate)]
    best = max(breaths, key=attrgetter("probability"))
    return replace(best, odds=best.odds - log(len(breaths)))


class _Axes(NamedTuple):
    """Orthonormal axes of waves, and the squares of their singular values.

    Attributes
    ----------
    axes : array, shape (rates, n, frames)
    gain : array, shape (rates, n)
    """

    axes: Array
    gain: Array

    @classmethod
    def of(cls, waves: Array) -> "_Axes":
        """Return the axes of waves (rates, frames, n)."""
        axes, sizes, _ = np.linalg.svd(waves, full_matrices=False)
        return cls(np.swapaxes(axes, 1, 2), sizes**2)

    def evidence(self, series: Array, sd: float, freedom: int) -> Array:
        """Return ln P(s | f) up to a constant, (rates,), summed over σ.

        Parameters
        ----------
        series : array, shape (frames,)
            s.
        sd : float
            A.
        freedom : int
            Degrees of freedom of s.
        """
        amplitude = self.axes @ series
        noise = np.geomspace(1e-4, 1.0, 25)[:, None, None] ** 2
        wide = noise + sd**2 * self.gain
        remaining = series @ series - (amplitude**2).sum(axis=1)
        # amplitude ~ N(0, σ² + A² gain), all other directions ~ N(0, σ²); axes (noises, rates, n)
        squares = (amplitude**2 / wide).sum(axis=2) + np.maximum(remaining, 0.0) / noise[..., 0]
        others = (freedom - amplitude.shape[1]) * np.log(noise[..., 0])
        return np.asarray(logsumexp(-0.5 * (squares + np.log(wide).sum(axis=2) + others), axis=0))


class _Window(NamedTuple):
    """A window between steps, without its trend.

    Attributes
    ----------
    lasted : float
        Duration, s.
    within : array, shape (frames,)
        Time within the window, from 0 to 1.
    hertz : array, shape (rates,)
        Rates in Hz.
    waves : array, shape (rates, frames, 2)
        Sine and cosine in proportion to the suction.
    even, wide, leak : _Axes
        Axes of these waves, of waves whose rate wanders, and of a suction that falls steadily from
        a time on.
    tapered : array, shape (rates, 2, frames)
        Waves that fade towards the ends of the window, of unit length.
    changes : array, shape (frames, readings)
        Whitened changes of ln y.
    patterns : Patterns
    with_bodies : array, shape (frames, readings)
        Changes with those of other loads and bodies.
    bodies : Patterns
        Patterns with these.
    freedom : int
        Degrees of freedom of a series in the window.
    """

    lasted: float
    within: Array
    hertz: Array
    waves: Array
    even: _Axes
    wide: _Axes
    leak: _Axes
    tapered: Array
    changes: Array
    patterns: Patterns
    with_bodies: Array
    bodies: Patterns
    freedom: int

    @property
    def swings(self) -> Array:
        """Swings of the readings at every rate, (rates, 2, readings)."""
        return self.even.axes @ self.changes

    def rates(self, level: Array, rate: float) -> list[tuple[int, Mask, Mask]]:
        """Return the rates that may be the breath's, with the rates of its background.

        A rate comes with its number, the rates that it stands for, and those of the background,
        (rates,). The first is the strongest of all readings. The second is the strongest of the
        suction elsewhere. Its background lacks the rates whose double it may be, because the square
        of a movement resembles a breath.

        Parameters
        ----------
        level : array, shape (frames,)
            Relative suction.
        rate : float
            Frames per second.
        """
        distance = LEAKS / self.lasted
        strongest = int(np.argmax((self.swings**2).sum(axis=(1, 2))))
        elsewhere = np.abs(self.hertz - self.hertz[strongest]) > distance
        rates = [(strongest, np.ones(len(self.hertz), dtype=bool), elsewhere)]
        if elsewhere.any():
            second = int(np.argmax(elsewhere * ((self.even.axes @ level) ** 2).sum(axis=1)))
            hertz = self.hertz[second]
            halves = np.array([hertz, hertz / 2, (rate - hertz) / 2])
            apart = np.abs(self.hertz[:, None] - halves) > distance
            rates.append((second, ~apart[:, 0], apart.all(axis=1)))
        return rates

    def breath(self, centre: int, near: Mask, background: Mask) -> Breath:
        """Return the breath at one of the rates `near`, each as probable as any rate of all.

        Parameters
        ----------
        centre : int
            Number of the rate without which the background is estimated.
        near, background : boolean arrays, shape (rates,)
            Rates of the breath, and of its background.
        """
        mean_gain = float(self.even.gain.mean())
        swings = self.swings
        # without the wave itself, which gaps between the parts of a window spread over all rates
        without_wave = self.changes - self.even.axes[centre].T @ swings[centre]
        # Movements at all rates that the strongest one does not leak into, and noise, are whitened.
        moved = self.tapered[background] @ without_wave
        samples = moved.reshape(-1, moved.shape[2])
        noise = _background(moved) * np.eye(samples.shape[1])
        whitening = Whitening.of(noise + samples.T @ samples / max(len(samples), 1)).matrix
        steadied = self.patterns.whitened(whitening)
        # A rim that swings less than the suction lets expect cancels it in a mean of both. Weights
        # that leave movements out see such a breath, but less of a faint one; each is as probable.
        white = self.changes @ whitening.T
        courses = [
            white @ steadied.weights(BREATHING_SD, 1 / mean_gain, moving)
            for moving in (0.0, EDGE_SD)
        ]
        odds = [self._odds(suction, near) for suction in courses]
        suction = courses[np.argmax(odds)]
        power = near * ((self.even.axes @ suction) ** 2).sum(axis=1)
        best = int(np.argmax(power))
        remaining = max(suction @ suction - power[best], 1e-12) / (self.freedom - 2)
        # Rife, Boorstyn, IEEE Trans. IT-20, 1974
        spread = np.sqrt(3 * remaining / max(power[best], 1e-12)) / (np.pi * self.lasted)
        # a rate is uniform within a step of the grid
        hertz_sd = float(np.hypot(spread, RATE_STEP / self.lasted / 12**0.5))
        return Breath(
            odds=float(logsumexp(odds) - log(len(odds))),
            suction=self._suction(steadied, swings @ whitening.T, best),
            hertz=(float(self.hertz[best]), hertz_sd),
            depth=self._depth(best, _background(swings) / mean_gain),
        )

    def _suction(self, patterns: Patterns, swings: Array, best: int) -> float:
        """Return the probability that suction oscillates with its rim, against all other causes.

        Cells beside the load may swing in any case, by the size that explains the swing best at the
        rate of the suction. Other causes may oscillate at half the rate as well, also beyond half
        the frame rate, because the square of a movement oscillates at twice its rate.

        Parameters
        ----------
        patterns : Patterns
        swings : array, shape (rates, 2, readings)
            Projections of the readings on sine and cosine, with noise of unit variance.
        best : int
            Number of the rate of the suction.
        """
        hertz = self.hertz[best]
        frames_hz = (len(self.within) - 1) / self.lasted
        same = np.abs(self.hertz - hertz) < 1 / (2 * self.lasted)
        halves = np.array([hertz / 2, (frames_hz - hertz) / 2])[:, None]
        halved = (np.abs(self.hertz - halves) < 1 / (4 * self.lasted)).any(axis=0)
        own = swings[same]
        root = self.even.gain.mean() ** 0.5  # swings at unit amplitude
        by_rate = logsumexp(_explained(root * patterns.own, BREATH.largest, own), axis=0)
        beside = root * patterns.beside
        by_size = _explained(beside, BESIDE.largest, own[np.argmax(by_rate)][None])
        size = _sizes(BESIDE.largest)[np.argmax(by_size)]
        whitening = Whitening.of(np.eye(len(beside)) + size**2 * beside @ beside.T).matrix

        def evidence(cause: Cause, rates: Mask) -> float:
            pattern = root * whitening @ getattr(patterns, cause.pattern)
            explained = _explained(pattern, cause.largest, swings[rates] @ whitening.T)
            return float(logsumexp(explained, axis=0).max()) - log(SIZES)

        breathes = evidence(BREATH, same)
        pushed = self._pushed(best)
        # 1/w = 1 + Σ_causes (E_cause/E_breath)^½/odds
        against = [
            EVIDENCE_SHARE * (explained - breathes)
            + np.log(pushed / cause.odds_adjoined + (1 - pushed) / cause.odds)
            for cause, explained in (
                (RIM, evidence(RIM, same | halved)),
                (MOVES, evidence(MOVES, same | halved)),
                (BESIDE, 0.0),
            )
        ]
        return float(expit(-logsumexp(against)))

    def _pushed(self, best: int) -> float:
        """Return the probability that a body that adjoins the load swings at one rate.

        It moves the load at the rates at which it moves itself.
        """
        if not self.bodies.adjoining.size:
            return 0.0
        gain = self.even.gain.mean()
        breathing = BREATHING_SD**2 * gain * self.bodies.own @ self.bodies.own.T
        whitening = Whitening.of(np.eye(len(breathing)) + breathing)
        swing = whitening @ (self.even.axes[best] @ self.with_bodies).T
        adjoining = whitening @ (gain**0.5 * self.bodies.adjoining)
        by_size = _explained(adjoining, BREATH.largest, swing.T[None])
        evidence = logsumexp(by_size) - log(SIZES)
        return float(expit(EVIDENCE_SHARE * evidence - log(RIM.odds)))

    def _odds(self, suction: Array, near: Mask) -> float:
        """Return ln of the odds of A = BREATHING_SD against A = TREMBLE_SD, or a leak.

        `suction` (frames,) is the relative suction, `near` (rates,) has the rates of the breath.
        """
        breathing, jitter = (
            logsumexp(self.wide.evidence(suction, sd, self.freedom)[near]) - log(near.sum())
            for sd in (BREATHING_SD, TREMBLE_SD)
        )
        leaks = self.leak.evidence(suction, LEAK_SD, self.freedom)
        leaking = logsumexp(leaks) - log(len(leaks))
        steady = np.logaddexp(log(1 - LEAK_SHARE) + jitter, log(LEAK_SHARE) + leaking)
        return float(breathing - steady + np.log(near.mean()))

    def _depth(self, best: int, noise: float) -> Pair:
        """Return the relative amplitude of the suction and its standard deviation.

        The amplitude and the phase of the wave may change linearly over the window. The readings
        show the depth times an unknown gain g of the film, which is taken as log-normal with mean 1
        and variance v. The median of 1/g is √(1 + v), by which the depth is multiplied. A film with
        hysteresis shows the share 1 − RESPONSE_SD of a swing, by which it is divided.

        Parameters
        ----------
        best : int
            Number of the rate.
        noise : float
            Variance of the amplitude in each reading.
        """
        waves = self.waves[best]
        # times the standard deviation of the amplitudes' prior
        changing = 12**0.5 * (self.within[:, None] - 0.5) * waves
        basis = BREATH.largest * np.hstack([waves, changing])
        depth = BREATHING_SD
        film = variance = 0.0
        square = basis.T @ basis
        for _ in range(DEPTH_ROUNDS):
            weights = self.patterns.weights(depth, noise)
            series = self.changes @ weights
            # amplitudes with the prior N(0, largest²), which near half the frame rate alone decides
            freedom = len(series) - 8  # four numbers here, four of trend
            residual = series - basis @ np.linalg.lstsq(basis, series, rcond=None)[0]
            variance_left = max(float(residual @ residual) / freedom, 1e-12)
            known = Information(square / variance_left, basis.T @ series / variance_left)
            coefficients = BREATH.largest * known.mean
            variances = BREATH.largest**2 * np.diag(known.covariance)
            # A² from all four coefficients, less the noise of the two of linear change
            power = float(coefficients @ coefficients - variances[2:].sum())
            depth = max(power, TREMBLE_SD**2) ** 0.5
            film = float(np.sum((weights @ self.patterns.own[:, 1:]) ** 2))
            film += RESPONSE_SD**2 + self.patterns.curve**2
            variance = depth**2 * film + float(variances[:2].mean())
        scale = (1 + film) ** 0.5 / (1 - RESPONSE_SD)
        return scale * depth, scale * variance**0.5


def _waves(hertz: Array, times: Array) -> Array:
    """Return cosine and sine at every rate, (rates, frames, 2)."""
    waves = np.exp(2j * np.pi * hertz[:, None] * times)
    return np.stack([waves.real, waves.imag], axis=2)


def _wandering(hertz: Array, times: Array) -> Array:
    """Return waves whose rates are N(f, (WANDER f)²), by Gauss-Hermite points.

    The result has shape (rates, frames, 10).
    """
    points, weights = hermegauss(5)
    shares = (weights / weights.sum()) ** 0.5
    waves = [
        share * _waves(hertz * (1 + WANDER * point), times)
        for point, share in zip(points, shares, strict=True)
    ]
    return np.concatenate(waves, axis=2)


def _background(swings: Array) -> float:
    """Return the variance of swings (rates, 2, readings) at most rates.

    The lower quartile estimates it; the variance of noise is the lower limit.
    """
    if not len(swings):
        return 1.0
    return max(1.0, float(np.quantile((swings**2).mean(axis=(1, 2)), 0.25)))


def _sizes(largest: float) -> Array:
    """Return sizes of a cause up to its largest, each as probable as the others, (SIZES,)."""
    return np.geomspace(TREMBLE_SD, largest, SIZES)


def _explained(root: Array, largest: float, swings: Array) -> Array:
    """Return ln of the ratio of P(swings | size of a cause) to P(swings | noise), (SIZES, rates).

    Parameters
    ----------
    root : array, shape (readings, n)
        Root B of the cause's covariance at unit amplitude.
    largest : float
        Largest size a.
    swings : array, shape (rates, 2, readings)
        With noise of unit variance.
    """
    along, lengths, _ = np.linalg.svd(root, full_matrices=False)
    square = (swings @ along) ** 2
    wide = (_sizes(largest)[:, None] * lengths) ** 2
    # swings ~ N(0, 1 + a² B Bᵀ): ½ Σ z² w/(1 + w) − ½ · 2 Σ ln(1 + w), with w = a² l² along each
    # axis of B, for sine and cosine
    power = square.sum(axis=1)
    return np.asarray((wide / (1 + wide)) @ power.T / 2 - np.log1p(wide).sum(axis=1)[:, None])
