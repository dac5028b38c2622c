"""Whether a load's suction changes periodically: Bretthorst's odds of a sinusoid (Bayesian Spectrum Analysis, 1988).

Suction and rim change the cells by slopes that follow from where these stand on the film's response. Their relative
amplitude in a window is a weighted mean of the readings; a trend is taken off. Equations are in
docs/theory/recognition.md.
"""

from dataclasses import dataclass, replace
from math import exp

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import expit, logit, logsumexp

from lampest.files.levels import MAD_TO_SIGMA
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.evidence import EVIDENCE_SHARE, RARE_LOG_ODDS
from lampest.loads.recognition.fit import MAX_ROUNDS, Fit
from lampest.loads.recognition.observation import Observation
from lampest.panel.panel import Array
from lampest.panel.response import CURVE_KPA, CURVE_RATIO, RESPONSE_SD, PublishedResponse

RATES_HZ = (0.5, 2.5)  # of breathing; sea lampreys at rest 0.8 to 1.6 Hz
MIN_RATE_HZ = 3.8  # frames a second: those of four whose clock is slow; they show rates up to 2 Hz
# A: the amplitude of mouths is 5.4 % of their suction in the mean (docs/studies/mouths.md). Of loads that do not
# breathe it is an assumption: cups tremble and leak, but at no single rate.
BREATHING_SD, TREMBLE_SD = 0.045, 0.002
WINDOW_S, MIN_WINDOW_S = 8.0, 4.5  # over which a rhythm is steady; and the least that shows one
# Largest swings of each cause, by its pattern. Suction: with more than 15 %, the unevenness of a film explains the
# swings of a shaken cup. The rim alone: by all that it presses. Movements: ten times as far as is common.
MAX_SWINGS = {"own": 0.15, "rim": 1.0, "moves": 10.0}
# An assumption: relative standard deviation of the swing of all the rim over that of suction, which may press with more
# than it bears; and of each cell's change by a movement, because where an edge crosses its film is not known.
EDGE_SD = 0.5
THRESHOLD_KPA = -2.0  # from which on suction may show, another curve through the published point than that from 0 kPa
MAX_LOG_ODDS = 10.0  # that evidence of breathing can add up to

Pair = tuple[float, float]


def too_slow(rate: float) -> str:
    """Explain why so many frames a second show no breathing; '' where they do."""
    return "" if rate >= MIN_RATE_HZ else f"breathing shows at four frames a second or more, here there are {rate:.3g}"


@dataclass(frozen=True)
class Breath:
    """Breath in one window.

    Attributes
    ----------
    odds : float
        ln of P(oscillates)/P(does not) from one window.
    hertz, depth : Pair
        With standard deviations.
    suction : float
        Probability that it is the suction that does, and not something else that moves at a breathing rate.
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
        ln of the odds that it oscillates as breathing does, and those without the last window.
    suction, last : float
        Probability that this is its suction, and that by the last window alone.
    causes : float
        ln of the odds of that in full windows, without those beforehand.
    hertz, depth : (value, standard deviation), or None
        Rate in Hz and relative amplitude, from the last window that shows them.
    """

    odds: float = 0.0
    previous_odds: float = 0.0
    suction: float = 1.0
    last: float = 0.5
    causes: float = 0.0
    hertz: Pair | None = None
    depth: Pair | None = None

    @property
    def probability(self) -> float:
        """Probability that suction changes as breathing does; 1/2 where nothing was seen."""
        return self.suction * float(expit(self.odds))

    def after(self, seen: Breath, *, full: bool) -> "Breathing":
        """Return the breath after a window; full : whether its odds stay, as do its rate and depth.

        Of one mouth in twenty no window shows the breath, since it is faint or at half the frame rate, and a mouth
        pauses in one window of twenty: assumptions. The odds of full windows multiply. Two that are not full have
        to agree that it is suction that swings: by the last of them alone two of 75 shaken cups were lampreys for a
        second (docs/studies/mouths.md).
        """
        window = np.logaddexp(-RARE_LOG_ODDS, np.log1p(-exp(-RARE_LOG_ODDS)) + seen.odds)
        odds = float(np.clip(self.previous_odds + window, -RARE_LOG_ODDS, MAX_LOG_ODDS))
        breathing = replace(self, odds=odds, previous_odds=odds if full else self.previous_odds)
        if self.hertz is not None and (seen.odds <= 0 or (self.previous_odds != 0 and not full)):
            return breathing
        described = replace(breathing, hertz=seen.hertz, depth=seen.depth, last=seen.suction)
        if not full:
            return replace(described, suction=min(seen.suction, self.last))
        window = logit(np.clip(seen.suction, 1e-9, 1 - 1e-9)) - RARE_LOG_ODDS
        causes = float(np.clip(self.causes + window, -MAX_LOG_ODDS, MAX_LOG_ODDS))
        return replace(described, suction=float(expit(causes + RARE_LOG_ODDS)), causes=causes)


@dataclass(frozen=True, eq=False)
class Patterns:
    """Effects of swings on readings of unit variance: roots of their covariance at unit amplitude, (readings, n).

    Attributes
    ----------
    own : array
        Suction with its rim; the first column is its mean, the others are possible additions of a film.
    rim : array
        The rim alone.
    moves : array
        The load's place and tilt.
    others : array
        Further changes, of any size.
    """

    own: Array
    rim: Array
    moves: Array
    others: Array

    @classmethod
    def of(cls, by_cell: Array, rise: Array, slopes: Array, spread: Array, moves: Array, others: Array) -> "Patterns":
        """Return the patterns of a load.

        Parameters
        ----------
        by_cell : array, shape (readings, cells)
        rise : array, shape (cells)
            ln r/r0, < 0 under the rim.
        moves : array
            (moves, cells).
        slopes : array
            (1 + n, cells) of ln r/r0 by ln p, and n by which all cells' may differ together.
        spread : array, shape (cells)
            σ of their own.
        """
        mean, rim = slopes[0], rise < 0
        own = np.column_stack([mean, EDGE_SD * rim * mean, slopes[1:].T, np.diag(spread)])
        alone = np.delete(own, 1, axis=1) * rim[:, None]
        changes = np.linalg.norm(moves, axis=0)
        moving = np.column_stack([moves.T, np.diag(EDGE_SD * np.hypot(changes, np.sqrt(np.mean(changes**2))))])
        return cls(by_cell @ own, by_cell @ alone, by_cell @ moving, others)

    def beside_others(self, changes: Array) -> tuple["Patterns", Array]:
        """Return the patterns and changes (frames, readings) without the effects of `others`."""
        span = np.linalg.qr(self.others)[0]
        own, rim, moves, left = (
            pattern - span @ (span.T @ pattern) for pattern in (self.own, self.rim, self.moves, changes.T)
        )
        return Patterns(own, rim, moves, self.others), left.T

    def weights(self, depth: float, noise: float, moving: float = 0.0) -> Array:
        """Return (readings) by which they sum to the amplitude of suction, by least squares about a depth.

        moving : standard deviation by which the rim alone, the place and the tilt may change too.
        """
        mean = self.own[:, 0]
        film = np.hstack([depth * self.own[:, 1:], moving * self.rim, moving * self.moves])
        weighed = np.linalg.solve(noise * np.eye(len(mean)) + film @ film.T, mean)
        return np.asarray(weighed / max(float(mean @ weighed), 1e-300))


def patterns_of(
    frame: Observation, fit: Fit, whitening: Array, detector: Detector
) -> list[tuple[tuple[float, float], Patterns]]:
    """Return (centre, patterns) of every load of a fit that sucks.

    Parameters
    ----------
    frame, fit : Fit or Observation
        The recognised frame and its fit.
    whitening : array, shape (readings, readings)
    """
    panel = detector.panel
    departure, covariance = detector.departure(frame, fit)
    rise = fit.change + departure
    by_cell = whitening @ (frame.slope(rise) / frame.measured.ravel()[:, None])
    slopes = _slopes(frame, rise, fit.scatter)
    spread = np.sqrt((slopes[1:-1] ** 2).sum(axis=0) + slopes[0] ** 2 * (fit.scatter**2 + np.diag(covariance)))
    loads, patterns = fit.loads, list[tuple[tuple[float, float], Patterns]]()
    cells = [part.pressure(panel, detector.patch_mm, own)[0].ravel() != 0 for part, own in loads]
    by_load = np.split(fit.by_parameter, np.cumsum([len(own) for _, own in loads]))
    for (part, own), under, by_parameter in zip(loads, cells, by_load, strict=False):
        disc = part.disc(own)
        if disc is not None and part.sucks:
            sways = np.array([prior.sway for prior in part.priors(panel).values()])
            moves = (sways[:, None] * by_parameter[:, under])[sways > 0]
            others = np.column_stack([whitening.sum(axis=1), by_cell[:, np.any(cells, axis=0) & ~under]])
            own_cells = by_cell[:, under], rise.ravel()[under], slopes[:, under], spread[under]
            patterns.append(((disc.x_mm, disc.y_mm), Patterns.of(*own_cells, moves, others)))
    return patterns


def breaths(
    times: Array, logarithms: Array, frame: Observation, fit: Fit, whitening: Array, detector: Detector
) -> list[tuple[tuple[float, float], Breath]]:
    """Return (centre, breath) of every load that sucks, from the frames of a window.

    Parameters
    ----------
    times : array, shape (frames)
        s.
    logarithms : array, shape (frames, readings)
        ln y. Others : as `patterns_of` has them.
    """
    pressure, _ = fit.candidate.pressure(detector.panel, detector.patch_mm, fit.parameters)
    changes = settled(logarithms - np.log(frame.measured.ravel()))
    changes = (changes - _of_water(changes, frame, fit, pressure)) @ whitening.T
    each = [(place, breath(times, changes, own)) for place, own in patterns_of(frame, fit, whitening, detector)]
    return [(place, seen) for place, seen in each if seen is not None]


def suction_weights(patterns: Patterns, whitening: Array) -> Array:
    """Return the weights (readings) by which changes of ln y sum to the relative change of a load's suction.

    Changes of all readings alike, of other loads, and of the load's place and rim by themselves count little.
    """
    own, _ = patterns.beside_others(np.zeros((1, len(whitening))))
    return np.asarray(whitening.T @ own.weights(MAX_SWINGS["own"], 1.0, EDGE_SD))


def breath(times: Array, changes: Array, patterns: Patterns) -> Breath | None:
    """Return the breath of a window; None where it is too short.

    Parameters
    ----------
    times : array, shape (frames)
        s.
    changes : array, shape (frames, readings)
        Of unit variance.
    """
    lasted = times[-1] - times[0]
    rate = (len(times) - 1) / max(lasted, 1e-9)
    if lasted < MIN_WINDOW_S or rate < MIN_RATE_HZ:
        return None
    at = (times - times[0]) / lasted
    trend = np.linalg.qr(np.column_stack([np.ones_like(at), at, at**2, np.log1p(10 * at)]))[0]
    patterns, changes = patterns.beside_others(changes - trend @ (trend.T @ changes))
    hertz = np.arange(RATES_HZ[0], min(RATES_HZ[1], rate / 2) + 1e-9, 0.25 / lasted)
    waves = np.exp(2j * np.pi * hertz[:, None] * times)
    waves = np.stack([waves.real, waves.imag], axis=2)
    axes, sizes, _ = np.linalg.svd(waves - trend @ (trend.T @ waves), full_matrices=False)
    axes, gain = np.swapaxes(axes, 1, 2), sizes**2
    swings = axes @ changes  # (rates, 2, readings)
    noise = max(1.0, float(np.quantile((swings**2).mean(axis=(1, 2)), 0.25)))  # a wave leaks into other rates
    series = changes @ patterns.weights(TREMBLE_SD, noise / gain.mean())
    amplitude, total = axes @ series, float(series @ series)
    power = (amplitude**2).sum(axis=1)
    freedom, best = len(times) - trend.shape[1], int(np.argmax(power))
    breathing, steady = (logsumexp(_evidence(total, amplitude, gain, sd, freedom)) for sd in (BREATHING_SD, TREMBLE_SD))
    left = max(total - power[best], 1e-12) / max(freedom - 2, 1)
    spread = np.sqrt(3 * left / max(power[best], 1e-12)) / (np.pi * lasted)  # Rife, Boorstyn, IEEE Trans. IT-20, 1974
    return Breath(
        float(breathing - steady),
        _suction(patterns, swings, noise, float(gain.mean())),
        (float(hertz[best]), float(np.hypot(spread, 0.25 / lasted / 12**0.5))),
        _depth(patterns, changes, waves[best] - trend @ (trend.T @ waves[best]), at, noise / float(gain.mean())),
    )


def _depth(patterns: Patterns, changes: Array, waves: Array, at: Array, noise: float) -> tuple[float, float]:
    """(relative amplitude of the suction, its σ), of a wave whose amplitude and phase may run linearly over the window.

    Parameters
    ----------
    waves : array, shape (frames, 2)
    at : array, shape (frames)
        From 0 to 1.
    noise : float
        Variance of the amplitude in each reading.
    """
    basis = np.hstack([waves, 12**0.5 * (at[:, None] - 0.5) * waves])
    inverse, depth, variance = np.linalg.pinv(basis), BREATHING_SD, 0.0
    for _ in range(MAX_ROUNDS):
        weights = patterns.weights(depth, noise)
        series = changes @ weights
        coefficients = inverse @ series
        freedom = max(len(at) - 8, 1)  # four numbers here, four of trend
        left = float(np.sum((series - basis @ coefficients) ** 2)) / freedom
        each = left * (inverse**2).sum(axis=1)
        depth = max(float(coefficients @ coefficients - each[2:].sum()), TREMBLE_SD**2) ** 0.5
        film = float(np.sum((weights @ patterns.own[:, 1:]) ** 2)) + RESPONSE_SD**2
        variance = depth**2 * film + float(each[:2].mean())
    return depth / (1 - RESPONSE_SD), variance**0.5 / (1 - RESPONSE_SD)


def _evidence(total: float, amplitude: Array, gain: Array, sd: float, freedom: int) -> Array:
    """ln P(s | f) up to a common term, (rates): summed over σ."""
    noise = np.geomspace(1e-4, 1.0, 25)[:, None, None] ** 2
    wide = noise + sd**2 * gain
    remaining = total - (amplitude**2).sum(axis=1)
    fits = -0.5 * ((amplitude**2 / wide).sum(axis=2) + np.maximum(remaining, 0.0) / noise[..., 0])
    volume = -0.5 * (np.log(wide).sum(axis=2) + (freedom - 2) * np.log(noise[..., 0]))
    return np.asarray(logsumexp(fits + volume, axis=0))


def _suction(patterns: Patterns, swings: Array, noise: float, gain: float) -> float:
    """Return the probability that suction oscillates with its rim, not the rim alone nor the load's place or tilt.

    Parameters
    ----------
    swings : array
        (rates, 2, readings). Each cause at its own rate: the square of a movement oscillates twice as fast.
    noise : float
        Their variance.
    gain : float
        Square of the swings at unit amplitude.
    """
    causes = ((gain**0.5 * getattr(patterns, name), most) for name, most in MAX_SWINGS.items())
    own, *others = (_explained(root, most, swings, noise).max() for root, most in causes)
    odds = EVIDENCE_SHARE * (own - np.array(others)) + RARE_LOG_ODDS + np.log(2)  # both together are as rare
    return float(expit(-logsumexp(-odds)))


def _explained(root: Array, most: float, swings: Array, noise: float) -> Array:
    """ln P of swings (rates, 2, readings) of a cause over that of noise, (rates), summed over its size up to `most`."""
    along, lengths, _ = np.linalg.svd(root, full_matrices=False)
    square, sizes = (swings @ along) ** 2 / noise, np.geomspace(TREMBLE_SD, most, 13)
    wide = (sizes[:, None] * lengths) ** 2 / noise
    each = np.tensordot(square.sum(axis=1), wide / (1 + wide), (1, 1)) / 2 - np.log1p(wide).sum(axis=1)
    return np.asarray(logsumexp(each, axis=1, b=1 / len(sizes)))


def _slopes(frame: Observation, rise: Array, scatter: float) -> Array:
    """(7, cells) ∂x/∂ln p of cells at x = `rise`: mean and deviations, as films differ by `scatter` and are bent.

    The last deviation is that of the published curve under suction, which has one point there: a straight line of r and
    an exponential beyond a threshold are one standard deviation each from their geometric mean.
    """
    response, water = frame.baseline.response, frame.water
    points, weights = hermegauss(5)
    gains = response.gains * np.exp(np.hypot(scatter, frame.baseline.model_errors.bent) * points[:, None, None])
    logarithm = rise / gains + response.logarithm(water)
    pressure = response.pressure(logarithm) - water
    more, less = (response.logarithm(water + by * pressure) for by in (1 + BREATHING_SD, 1 - BREATHING_SD))
    rise, delay = np.maximum(logarithm, 0.1), np.log(CURVE_RATIO[0]) / (CURVE_KPA[0] / THRESHOLD_KPA - 1)
    straight, delayed = np.log(-np.expm1(-rise) / rise), np.log1p(delay / rise)
    unknown = (logarithm > 0) & isinstance(response, PublishedResponse)
    middle, curve = unknown * (delayed + straight) / 2, unknown * (delayed - straight) / 2
    slopes = (gains * (more - less) / (2 * BREATHING_SD) * np.exp(middle)).reshape(len(points), -1)
    shares = weights / weights.sum()
    mean = shares @ slopes
    common = shares @ (slopes * curve.reshape(slopes.shape))
    return np.vstack([mean, np.sqrt(shares)[:, None] * (slopes - mean), common])


def _of_water(changes: Array, frame: Observation, fit: Fit, pressure: Array) -> Array:
    """Return the effect of the water's pressure on ln y, (frames, readings), by lines without a load.

    0 without such.
    """
    loaded = pressure != 0
    free = ~(loaded.any(axis=0) | loaded.any(axis=1)[:, None]).ravel()
    slope = frame.slope(fit.change) @ frame.change(pressure)[1].ravel() / frame.measured.ravel()
    return np.outer(changes[:, free] @ slope[free] / max(float(slope[free] @ slope[free]), 1e-300), slope)


def settled(series: Array) -> Array:
    """(frames, …) outliers, values beyond four robust standard deviations from the median, are drawn in to that."""
    middle = np.median(series, axis=0)
    most = 4 * MAD_TO_SIGMA * np.median(np.abs(series - middle), axis=0)
    return np.asarray(np.clip(series, middle - most, middle + most))
