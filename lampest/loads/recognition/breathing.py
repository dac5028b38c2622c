"""Whether a load's suction changes periodically: Bretthorst's odds of a sinusoid (Bayesian Spectrum Analysis, 1988).

Of the frames of a window the relative change s_t of a load's suction, and of the rim that bears it, is the amplitude of
their pattern by least squares, beside patterns of all that may move otherwise: the load's place and tilt, other loads,
the water over all cells, the supply. A trend is taken off: 1, t, t², and ln(1 + t) for what a film remembers. Left is

    s_t = a cos 2πft + b sin 2πft + noise,   a, b ~ N(0, A²),   noise ~ N(0, σ²), σ unknown,   f uniform,

with A = BREATH where it breathes and A = STEADY where it does not. Summed over σ and f this gives the odds. Where the
readings' oscillation at f is rather that of the place, the rim or the water than of suction, f is left out: a cup that
is shaken, and waves.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from lampest.panel.panel import Array

RATES_HZ = (0.5, 2.5)  # of breathing; sea lampreys at rest 0.8 to 1.6 Hz
LEAST_RATE = 3.8  # frames a second: those of four whose clock is slow; they show rates up to 2 Hz
# A: the amplitude of mouths is 5.4 % of their suction in the mean, of cups that leak 0.6 % (docs/studies/mouths.md)
BREATH, STEADY = 0.045, 0.005
WINDOW_S, LEAST_S = 8.0, 4.5  # over which a rhythm is steady; and the least that shows one
CLEARLY = 6.0  # times the median over all rates: noise passes that at 1.5 % of them
ALIKE = 1.2  # what a pattern may explain more than the true one does: films answer a tenth apart from cell to cell
NOISES = np.geomspace(1e-4, 1.0, 25)  # σ


@dataclass(frozen=True)
class Breath:
    """odds : ln of P(breathes)/P(does not) from one window. hertz, depth : with standard deviations.

    shaken : whether something else moves at a breathing rate, and more than suction does.
    """

    odds: float
    hertz: tuple[float, float]
    depth: tuple[float, float]
    shaken: bool


@dataclass(frozen=True, eq=False)
class Patterns:
    """What readings of unit variance do, (readings) or (readings, n).

    own : where suction and rim grow by `scale`; rim : the same of the rim alone. moves : the load's other movements.
    others : what else may move.
    """

    own: Array
    scale: float
    rim: Array
    moves: Array
    others: Array


def breath(times: Array, changes: Array, patterns: Patterns, water: Array) -> Breath | None:
    """What a window shows; None where it is too short.

    times : (frames) s. changes : (frames, readings) of unit variance. water : (frames) its pressure over the suction.
    """
    lasted = times[-1] - times[0]
    rate = (len(times) - 1) / max(lasted, 1e-9)
    if lasted < LEAST_S or rate < LEAST_RATE:
        return None
    at = (times - times[0]) / lasted
    trend = np.linalg.qr(np.column_stack([np.ones_like(at), at, at**2, np.log1p(10 * at)]))[0]
    own, rim, scale = patterns.own, patterns.rim, patterns.scale
    basis, kept = np.column_stack([own, patterns.moves, patterns.others]), 1 + patterns.moves.shape[1]
    together = np.linalg.solve(basis.T @ basis + np.eye(basis.shape[1]), basis.T @ changes.T).T[:, :kept]
    apart = changes @ np.column_stack([own / (own @ own), rim / (rim @ rim)])
    series = np.column_stack([scale * _calm(together[:, 0]), together[:, 1:], apart, water])
    weights = np.array([own @ own / scale**2, *(patterns.moves**2).sum(axis=0), own @ own, rim @ rim, 0.0])
    series = series - trend @ (trend.T @ series)
    hertz = np.arange(RATES_HZ[0], min(RATES_HZ[1], rate / 2) + 1e-9, 0.25 / lasted)
    power, total = np.empty((len(hertz), series.shape[1])), float(series[:, 0] @ series[:, 0])
    gain = np.empty((len(hertz), 2))
    own = np.empty((len(hertz), 2))
    for number, one in enumerate(hertz):
        phase = 2 * np.pi * one * times
        wave = np.column_stack([np.cos(phase), np.sin(phase)])
        wave = wave - trend @ (trend.T @ wave)
        axes, sizes, _ = np.linalg.svd(wave, full_matrices=False)
        found = axes.T @ series
        power[number], gain[number], own[number] = (found**2).sum(axis=0), sizes**2, found[:, 0]
    moved = weights * np.where(power > CLEARLY * np.median(power, axis=0), power, 0.0)
    moved[:, 0] = weights[0] * power[:, 0]
    free = (moved[:, 0] >= moved[:, 1:-3].max(axis=1)) & (ALIKE * moved[:, -3] >= moved[:, -2])
    free &= power[:, 0] >= power[:, -1]  # of waves suction follows by as much at most
    freedom = len(times) - trend.shape[1]
    breathing, steady = (_evidence(total, own, gain, scale, freedom) for scale in (BREATH, STEADY))
    against = float(logsumexp(steady)) - np.log(len(hertz))
    all_in_all = float(logsumexp(breathing)) - np.log(len(hertz)) - against
    odds = float(logsumexp(np.where(free, breathing, np.minimum(breathing, steady)))) - np.log(len(hertz)) - against
    best = int(np.argmax(np.where(free, power[:, 0], 0.0) if free.any() else power[:, 0]))
    noise = max(total - power[best, 0], 1e-12) / max(freedom - 2, 1)
    scale = float(np.mean(gain[best]))
    depth = np.sqrt(max(power[best, 0] / scale, 1e-12))
    spread = np.sqrt(6 * noise / (scale * 2)) / (np.pi * lasted * depth)  # Rife and Boorstyn, IEEE Trans. IT-20, 1974
    return Breath(
        odds,
        (float(hertz[best]), float(np.hypot(spread, 0.25 / lasted / 12**0.5))),
        (float(depth), float(np.sqrt(noise / scale))),
        all_in_all > 3.0 and odds < 0.0,
    )


def _evidence(total: float, own: Array, gain: Array, scale: float, freedom: int) -> Array:
    """ln P(s | f) up to what all share, (rates): summed over σ."""
    noise = NOISES[:, None, None] ** 2
    wide = noise + scale**2 * gain
    rest = total - (own**2).sum(axis=1)
    fits = -0.5 * ((own**2 / wide).sum(axis=2) + np.maximum(rest, 0.0) / noise[..., 0])
    volume = -0.5 * (np.log(wide).sum(axis=2) + (freedom - 2) * np.log(noise[..., 0]))
    return np.asarray(logsumexp(fits + volume, axis=0))


def _calm(series: Array) -> Array:
    """Values farther than four robust standard deviations from the median are drawn in to that: outliers."""
    middle = np.median(series)
    most = 4 * 1.4826 * np.median(np.abs(series - middle))
    return np.asarray(np.clip(series, middle - most, middle + most))
