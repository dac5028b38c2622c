"""Variance components of unloaded repeats: what a frame shares, what a scanned line shares, and each reading's own.

Deviations are in units of the specified σ, channel by channel, so that an offset of volts is a constant of them, and a
frame's gain a multiple of the voltages. Each part is kept where χ² of it, against the noise, has a tail below
SIGNIFICANCE; its variance is that of its deviations, less the noise's, times ν/(ν − 2), as of Student's t.
"""

from dataclasses import dataclass

import numpy as np

from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANCE, TWO_SIDED
from lampest.panel.panel import Array
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import Recording

# Over the noise: a smaller excess changes no verdict, and films that creep have it too. First differences of noise
# alone over second ones are 1.00 ± 0.06 with 100 readings.
MIN_EXCESS = 1.25
EDGE_WIDTHS = 3.0  # widths of Tracy and Widom's law beyond the edge: noise alone goes there once in thousands
# Samples for each channel, below which the smallest eigenvalues of noise come near zero, and rounding takes them below
# (tests/oracles/test_every_readout.py).
MIN_SAMPLES_PER_CHANNEL = 1.5
MEDIAN_EFFICIENCY = 0.37  # of the median size as an estimate of σ, as a share of the readings (Hampel, 1974)
PAIR_MEDIAN = 0.7960  # of the root mean square of two differences that share a frame, over √2 σ (by simulation)
QUIET_SHARE = 0.25  # of the triples: loads that come and go make the others restless


@dataclass(frozen=True, eq=False)
class Scatter:
    """Variance components in units of the specified σ.

    Attributes
    ----------
    own : float
        Standard deviation of each reading alone.
    own_freedom : int
        Degrees behind it.
    gain : float
        Of the factor of a frame, as a fraction, or 0.
    common_ripple, line_ripple : array, shape (channels of a line, n)
        Roots of the covariances of what all lines of a frame share (a ripple in step with the scan), and of what each
        line has anew.
    """

    own: float
    own_freedom: int
    gain: float
    common_ripple: Array
    line_ripple: Array


def noted_excess(chi_square: float, degrees: float) -> float:
    """√(χ²/degrees) of noise over the specified one; 1 where it exceeds that by chance, or by too little to matter."""
    factor = float(np.sqrt(chi_square / degrees)) if degrees else 1.0
    return factor if factor >= MIN_EXCESS and chi_square_tail(chi_square, degrees) < SIGNIFICANCE else 1.0


def unloaded_scatter(recording: Recording, resting: Readings) -> Scatter | None:
    """Return the parts of the unloaded frames' scatter; None where no reading is a value in two of them.

    Without a converter there is nothing that a frame's readings could share but what they are themselves.
    """
    assert resting.sigma is not None
    circuit, scene, value = recording.scene.circuit, recording.scene, resting.plain_values
    count = np.sum(~np.isnan(value), axis=0)
    if not (count > 1).any():
        return None
    value = np.where(count > 1, value, np.nan)
    middle = np.where(count > 1, np.nansum(value, axis=0) / np.maximum(count, 1), resting.value[0])
    deviation = (value - middle) / resting.sigma
    if scene.readout is None:
        loud = middle / np.exp(np.log(resting.sigma).mean(axis=0))
    else:
        volt = circuit.volt_from_recorded(circuit.to_recorded(middle, scene))
        loud = np.asarray(volt / np.broadcast_to(scene.readout.sigma_volt(), volt.shape))
        # From readings to volts, so that an offset of the converter is one number for all channels.
        step = 1e-3 * scene.readout.lsb_volt
        ends = [circuit.from_recorded(circuit.recorded_from_volt(volt + sign * step), scene) for sign in (1, -1)]
        deviation = deviation * np.sign(ends[0] - ends[1])
    if circuit.by_columns:
        deviation, loud = deviation.swapaxes(1, 2), loud.T
    return scatter(deviation, loud, len(value) - 1)


def repeated_scatter(measured: Readings) -> Scatter | None:
    """Return the scatter of readings at rest from frame to frame; None where there is no rest, or no three frames.

    Of every three frames in a row the second difference (y₀ − 2 y₁ + y₂)/(√6 σ) has unit variance, whatever moves
    evenly. Its median size over the readings is that of those at rest, and of all triples the quietest quarter counts.
    Where motion remains, first differences /(√2 σ) are larger; then the scatter is no more than an upper bound.
    """
    assert measured.sigma is not None
    value, sigma = measured.plain_values, measured.sigma[1:-1]
    if len(value) < 3:
        return None
    second = np.abs(value[2:] - 2 * value[1:-1] + value[:-2]) / (np.sqrt(6) * sigma)
    first = np.sqrt(((value[2:] - value[1:-1]) ** 2 + (value[1:-1] - value[:-2]) ** 2) / 4) / sigma
    enough = np.isfinite(second).sum(axis=(1, 2)) > 1
    if not enough.any():
        return None
    of_second, of_first = (np.nanmedian(size[enough], axis=(1, 2)) for size in (second, first))
    calmest = np.argsort(of_second)[: max(1, round(QUIET_SHARE * len(of_second)))]
    quiet, moving = float(of_second[calmest].mean()) * MAD_TO_SIGMA, float(of_first[calmest].mean()) / PAIR_MEDIAN
    if quiet > 1 and moving > MIN_EXCESS * quiet:
        return None
    nothing, count = np.zeros((1, 0)), int(np.isfinite(second[enough]).sum() / enough.sum() * MEDIAN_EFFICIENCY)
    return Scatter(quiet, max(count, 1), 0.0, nothing, nothing)


def scatter(deviation: Array, loudness: Array, repeats: int) -> Scatter:
    """Return the scatter of deviations (frames, lines, channels) about their mean over frames, NaN for silent readings.

    Parameters
    ----------
    loudness : array, shape (lines, channels)
        What a gain of 1 would do, in σ.
    repeats : int
        Degrees of freedom of each channel.
    """
    known = ~np.isnan(deviation)
    lines, channels = deviation.shape[1:]
    if not np.any(np.nan_to_num(deviation)):  # codes that all agree, or no noise at all
        nothing = np.zeros((channels, 0))
        return Scatter(0.0, max(int(known.sum() * repeats / len(known)), 1), 0.0, nothing, nothing)
    size = np.maximum((known * loudness**2).sum(axis=(1, 2)), 1e-300)
    slope = (np.nan_to_num(deviation) * loudness).sum(axis=(1, 2)) / size
    remaining = np.where(known, deviation - slope[:, None, None] * loudness, 0.0)
    common = remaining.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    # A frame's channels that say nothing leave gaps, which are counted out as a share of all.
    share = float(known.mean())
    inner = np.where(known, remaining - common[:, None, :], 0.0).reshape(-1, channels)
    noise, apart = _patterns(inner, max(repeats * (lines - 1) * share, 1.0))
    line = noise + float((apart**2).sum()) / channels
    together, variance = np.zeros((channels, 0)), line / (lines * share)
    few = max(repeats, 3) / (max(repeats, 3) - 2)
    if _beyond_noise((common**2).sum() / max(variance, 1e-300), repeats * channels):
        sizes, direction = np.linalg.eigh(common.T @ common / repeats)
        sizes, freedom = _shrunk(np.maximum(sizes, 0.0), repeats)
        strong = sizes > variance
        together = np.asarray(direction[:, strong] * np.sqrt((sizes[strong] - variance) * freedom / (freedom - 2)))
    own = (line + float((together**2).sum()) / channels * lines) / size
    gain = 0.0
    if _beyond_noise((slope**2 / np.maximum(own, 1e-300)).sum(), repeats):
        gain = float(np.sqrt(max((slope**2).sum() / repeats - own.mean(), 0.0) * few))
    degrees = repeats * (lines - 1) * (channels - apart.shape[1]) * share
    return Scatter(float(np.sqrt(max(noise, 0.0))), max(int(degrees), 1), gain, together, apart)


def _beyond_noise(squares: float, degrees: int) -> bool:
    return degrees > 0 and bool(chi_square_tail(squares, degrees) < SIGNIFICANCE)


def _shrunk(sizes: Array, repeats: int) -> tuple[Array, float]:
    """(eigenvalues (channels) of a covariance of so few repeats, drawn in to their mean; degrees of freedom behind it).

    The oracle-approximating shrinkage of Chen, Wiesel, Eldar and Hero, IEEE Trans. Signal Processing 58(10), 2010:
    directions that no repeat showed are as loud as the others, unless most is in one.
    """
    channels, total, squares = len(sizes), float(sizes.sum()), float((sizes**2).sum())
    apart = (repeats + 1 - 2 / channels) * (squares - total**2 / channels)
    share = min(((1 - 2 / channels) * squares + total**2) / max(apart, 1e-300), 1.0)
    return (1 - share) * sizes + share * total / channels, max(repeats * (1 - share + share * channels), 3.0)


def _patterns(rows: Array, freedom: float) -> tuple[float, Array]:
    """(variance of noise, root (channels, n) of the covariance beyond it) of rows (samples, channels).

    One direction after the other is taken off while it is stronger than the mean of all others lets noise be:
    (√n + √p)²/n and EDGE_WIDTHS times its width.
    Source: Johnstone, Annals of Statistics 29(2), 2001.
    """
    channels = rows.shape[1]
    size, direction = np.linalg.eigh(rows.T @ rows / freedom)
    first, second = np.sqrt(freedom), np.sqrt(channels)
    width = (first + second) * (1 / first + 1 / second) ** (1 / 3)
    unsure = 1 + TWO_SIDED * np.sqrt(2 / (freedom * max(channels - 1, 1)))
    edge = unsure * ((first + second) ** 2 + EDGE_WIDTHS * width) / freedom
    strong = 0
    for strong in range(channels if freedom >= MIN_SAMPLES_PER_CHANNEL * channels else 0):
        others = size[: channels - strong - 1]
        if not len(others) or size[channels - strong - 1] <= edge * others.mean():
            break
    weak = channels - strong
    noise = float(size[:weak].mean())
    return noise, np.asarray(direction[:, weak:] * np.sqrt(np.maximum(size[weak:] - noise, 0.0)))
