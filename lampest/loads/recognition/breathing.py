"""Whether a load's suction changes periodically: Bretthorst's odds of a sinusoid (Bayesian Spectrum Analysis, 1988).

Suction is the amplitude of its pattern in the readings of a window, beside patterns of what else may move; a trend is
taken off. Equations are in docs/theory/recognition.md.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from lampest.loads.recognition.evidence import RARER
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.observation import Observation
from lampest.loads.response import RESPONSE_SD
from lampest.panel.panel import Array

RATES_HZ = (0.5, 2.5)  # of breathing; sea lampreys at rest 0.8 to 1.6 Hz
LEAST_RATE = 3.8  # frames a second: those of four whose clock is slow; they show rates up to 2 Hz
# A: the amplitude of mouths is 5.4 % of their suction in the mean (docs/studies/mouths.md). Of what does not breathe it
# is an assumption: cups tremble and leak, but at no single rate.
BREATH, STEADY = 0.045, 0.002
WINDOW_S, LEAST_S = 8.0, 4.5  # over which a rhythm is steady; and the least that shows one
# Standard deviations of what may move with time: suction, rim and supply, relative; mm; tilts. Assumptions.
MOVES = {"suction": 0.1, "push": 0.1, "supply": 0.01, "x": 1.0, "y": 1.0, "tilt_x": 0.1, "tilt_y": 0.1}


def too_slow(rate: float) -> str:
    """Why so many frames a second show no breathing; '' where they do."""
    return "" if rate >= LEAST_RATE else f"breathing shows at four frames a second or more, here there are {rate:.3g}"


@dataclass(frozen=True)
class Breath:
    """odds : ln of P(oscillates)/P(does not) from one window. hertz, depth : with standard deviations.

    suction : probability that it is the suction that does, and not something else that moves at a breathing rate.
    """

    odds: float
    suction: float
    hertz: tuple[float, float]
    depth: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Patterns:
    """What readings of unit variance do, (readings) or (readings, n), for each move of MOVES.

    own : where suction and rim grow alike; rim : the rim alone. moves : the load's other movements. others : what else.
    """

    own: Array
    rim: Array
    moves: Array
    others: Array


def breaths(
    times: Array, logarithms: Array, frame: Observation, fit: Fit, whitening: Array, pressure: Array
) -> list[tuple[tuple[float, float], Breath]]:
    """(centre, breath) of every load that sucks, from the frames of a window.

    times : (frames) s. logarithms : (frames, readings) ln y. frame, fit : what was recognised, and of what. whitening :
    (readings, readings). pressure : (rows, columns) kPa of the fit.
    """
    model = frame.measured.ravel()
    of_cells = frame.slope(fit.change)
    slopes = iter((whitening @ (of_cells @ fit.by_parameter.T / model[:, None])).T)
    centres, patterns = list[tuple[float, float]](), list[list[Array]]()
    for part, own in fit.loads:
        names = part.priors(frame.baseline.scene.panel)
        by_name = dict(zip(names, slopes, strict=False))
        disc, moved = part.disc(own), {name: sd * by_name[name] for name, sd in MOVES.items() if name in by_name}
        if disc is not None and "suction" in moved and "push" in moved:
            suction, rim, *moves = moved.values()
            centres.append((disc.x_mm, disc.y_mm))
            patterns.append([suction + rim, rim, *moves])
    changes, found = logarithms - np.log(model), []
    changes = changes - _of_water(changes, frame, fit, pressure)
    for number, (centre, (own, rim, *moves)) in enumerate(zip(centres, patterns, strict=True)):
        others = [MOVES["supply"] * whitening.sum(axis=1)]
        for beside, _, *moving in (*patterns[:number], *patterns[number + 1 :]):
            others += [beside, *moving]
        seen = Patterns(own, rim, np.array(moves).T, np.array(others).T)
        heard = breath(times, changes @ whitening.T, seen)
        found += [] if heard is None else [(centre, heard)]
    return found


def breath(times: Array, changes: Array, patterns: Patterns) -> Breath | None:
    """What a window shows; None where it is too short.

    times : (frames) s. changes : (frames, readings) of unit variance.
    """
    lasted = times[-1] - times[0]
    rate = (len(times) - 1) / max(lasted, 1e-9)
    if lasted < LEAST_S or rate < LEAST_RATE:
        return None
    at = (times - times[0]) / lasted
    trend = np.linalg.qr(np.column_stack([np.ones_like(at), at, at**2, np.log1p(10 * at)]))[0]
    basis = np.column_stack([patterns.own, patterns.others])
    together = np.linalg.solve(basis.T @ basis + np.eye(basis.shape[1]), basis.T @ changes.T)[0]
    series = MOVES["suction"] * _calm(together)
    series = series - trend @ (trend.T @ series)
    hertz = np.arange(RATES_HZ[0], min(RATES_HZ[1], rate / 2) + 1e-9, 0.25 / lasted)
    waves = np.exp(2j * np.pi * hertz[:, None] * times)
    waves = np.stack([waves.real, waves.imag], axis=2)
    axes, sizes, _ = np.linalg.svd(waves - trend @ (trend.T @ waves), full_matrices=False)
    axes, gain = np.swapaxes(axes, 1, 2), sizes**2
    amplitude, total = axes @ series, float(series @ series)
    power = (amplitude**2).sum(axis=1)
    freedom, best = len(times) - trend.shape[1], int(np.argmax(power))
    breathing, steady = (logsumexp(_evidence(total, amplitude, gain, sd, freedom)) for sd in (BREATH, STEADY))
    noise = max(total - power[best], 1e-12) / max(freedom - 2, 1)
    moving = axes @ (changes - trend @ (trend.T @ changes))
    spread = np.sqrt(3 * noise / max(power[best], 1e-12)) / (np.pi * lasted)  # Rife, Boorstyn, IEEE Trans. IT-20, 1974
    return Breath(
        float(breathing - steady),
        _suction(patterns, moving, best),
        (float(hertz[best]), float(np.hypot(spread, 0.25 / lasted / 12**0.5))),
        _depth(patterns, moving[best] / sizes[best][:, None], float(np.mean(sizes[best] ** -2))),
    )


def _depth(patterns: Patterns, swing: Array, noise: float) -> tuple[float, float]:
    """(relative amplitude of suction and rim together, its σ), beside what the rim does more or less than that.

    swing : (2, readings) of unit amplitude and phase. noise : its variance in each reading. What is beside the patterns
    is the film's, which answers unevenly; along them there is as much, shared by the readings that suction reaches.
    Films answer a swing by less than a load that stays, by their hysteresis.
    """
    apart = np.linalg.qr(patterns.others)[0]
    basis, swing = (one - apart @ (apart.T @ one) for one in (np.column_stack([patterns.own, patterns.rim]), swing.T))
    span = np.linalg.qr(basis)[0]
    film = float(((swing - span @ (span.T @ swing)) ** 2).sum()) / _reached(patterns)
    normal = basis.T @ basis / (noise + film) + np.eye(2)
    depth = MOVES["suction"] * float(np.hypot(*np.linalg.solve(normal, basis.T @ swing)[0] / (noise + film)))
    return depth, float(np.hypot(MOVES["suction"] * np.sqrt(np.linalg.inv(normal)[0, 0]), RESPONSE_SD * depth))


def _reached(patterns: Patterns) -> float:
    """How many readings suction reaches: (Σ a²)²/Σ a⁴."""
    return float((patterns.own @ patterns.own) ** 2 / (patterns.own**4).sum())


def _evidence(total: float, amplitude: Array, gain: Array, sd: float, freedom: int) -> Array:
    """ln P(s | f) up to what all share, (rates): summed over σ."""
    noise = np.geomspace(1e-4, 1.0, 25)[:, None, None] ** 2
    wide = noise + sd**2 * gain
    rest = total - (amplitude**2).sum(axis=1)
    fits = -0.5 * ((amplitude**2 / wide).sum(axis=2) + np.maximum(rest, 0.0) / noise[..., 0])
    volume = -0.5 * (np.log(wide).sum(axis=2) + (freedom - 2) * np.log(noise[..., 0]))
    return np.asarray(logsumexp(fits + volume, axis=0))


def _suction(patterns: Patterns, moving: Array, at: int) -> float:
    """How probable it is that suction oscillates with its rim, not the rim alone nor the load's place or tilt.

    moving : (rates, 2, readings). at : the rate in question. Rims are compared by what they leave unexplained at that
    rate, where errors have one unknown scale; places, at any rate, by what they explain above the median of all rates,
    because the square of a movement oscillates twice as fast. As many readings count as suction reaches.
    """
    apart = np.linalg.qr(patterns.others)[0]
    moving = moving - moving @ apart @ apart.T

    def along(columns: Array) -> Array:
        """(rates) of the square of what moves, the part in their span beside `others`."""
        span = np.linalg.qr(columns - apart @ (apart.T @ columns))[0]
        return np.asarray(((moving @ span) ** 2).sum(axis=(1, 2)))

    whole = float((moving[at] ** 2).sum())
    own, rim, moves = (along(one) for one in (patterns.own[:, None], patterns.rim[:, None], patterns.moves))
    left = max(whole - rim[at], 1e-12) / max(whole - own[at], 1e-12)
    above = max(own[at] - np.median(own), 1e-12) / max(float(np.max(moves) - np.median(moves)), 1e-12)
    odds = RARER + np.log(2) + _reached(patterns) / 2 * np.log([left, above])  # both together are as rare
    return float(expit(-logsumexp(-odds)))


def _of_water(changes: Array, frame: Observation, fit: Fit, pressure: Array) -> Array:
    """(frames, readings) of ln y: what the water's pressure does, as lines without a load show it; 0 without such."""
    loaded = pressure != 0
    free = ~(loaded.any(axis=0) | loaded.any(axis=1)[:, None]).ravel()
    slope = frame.slope(fit.change) @ frame.change(pressure)[1].ravel() / frame.measured.ravel()
    return np.outer(changes[:, free] @ slope[free] / max(float(slope[free] @ slope[free]), 1e-300), slope)


def _calm(series: Array) -> Array:
    """Values farther than four robust standard deviations from the median are drawn in to that: outliers."""
    middle = np.median(series)
    most = 4 * 1.4826 * np.median(np.abs(series - middle))
    return np.asarray(np.clip(series, middle - most, middle + most))
