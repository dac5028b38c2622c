"""Variance components of unloaded repeats: errors shared by a frame, by a scanned line, and each reading's own.

The deviation of a reading from its mean over frames is, in units of the specified σ,

    deviation = gain of the frame · voltage + ripple common to all lines + ripple of the line + own noise.

A component is kept where χ² of its deviations against the noise has a tail probability below SIGNIFICANCE. Its
variance is that of its deviations less the noise's, times ν/(ν − 2), the variance of Student's t with ν degrees.
"""

from dataclasses import dataclass

import numpy as np

from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANCE, TWO_SIDED
from lampest.panel.panel import Array
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import Recording

# Factor on σ: a smaller excess changes no verdict, and creeping films cause it too. The ratio of first to second
# differences of noise alone is 1.00 ± 0.06 with 100 readings.
MIN_EXCESS = 1.25
EDGE_WIDTHS = 3.0  # widths of the Tracy-Widom law beyond the edge: noise alone exceeds it once in thousands
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
        Standard deviation of each reading's own noise.
    own_freedom : int
        Degrees of freedom of that estimate.
    gain : float
        Standard deviation of a frame's gain, as a fraction; 0 where it is not significant.
    common_ripple, line_ripple : array, shape (channels of a line, n)
        Roots of the covariances of the ripple that all lines of a frame share, in step with the scan, and of the
        ripple that each line has independently.
    """

    own: float
    own_freedom: int
    gain: float
    common_ripple: Array
    line_ripple: Array


def noted_excess(chi_square: float, degrees: float) -> float:
    """Return √(χ²/degrees), the factor of the noise over the specified one; 1 where it is insignificant or small."""
    factor = float(np.sqrt(chi_square / degrees)) if degrees else 1.0
    return factor if factor >= MIN_EXCESS and chi_square_tail(chi_square, degrees) < SIGNIFICANCE else 1.0


def unloaded_scatter(recording: Recording, resting: Readings) -> Scatter | None:
    """Return the variance components of the unloaded frames; None where no reading is a value in two of them.

    Without a readout in the scene the voltages are unknown, and the gain multiplies the readings themselves.
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
    """Return the noise from second differences of successive frames; None without three frames or without rest.

    Of three successive frames the second difference (y₀ − 2 y₁ + y₂)/(√6 σ) has unit variance, also during uniform
    motion. Its median over the readings is that of the readings at rest, and only the quietest quarter of the triples
    counts. Where first differences, divided by √2 σ, are larger by MIN_EXCESS, motion remains and the scatter is only
    an upper bound: it is then not taken for noise above the specified one.
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
    """Return the variance components of deviations from the mean over frames.

    Parameters
    ----------
    deviation : array, shape (frames, lines, channels)
        In units of σ; NaN for missing readings.
    loudness : array, shape (lines, channels)
        Response to a gain of 1, in units of σ.
    repeats : int
        Degrees of freedom of each channel, frames − 1.
    """
    known = ~np.isnan(deviation)
    lines, channels = deviation.shape[1:]
    if not np.any(np.nan_to_num(deviation)):  # codes that all agree, or no noise at all
        nothing = np.zeros((channels, 0))
        return Scatter(0.0, max(int(known.sum() * repeats / len(known)), 1), 0.0, nothing, nothing)
    size = np.maximum((known * loudness**2).sum(axis=(1, 2)), 1e-300)
    # Gain of each frame by least squares, Σ deviation · loudness / Σ loudness², (frames,); then the mean over lines,
    # (frames, channels).
    slope = (np.nan_to_num(deviation) * loudness).sum(axis=(1, 2)) / size
    remaining = np.where(known, deviation - slope[:, None, None] * loudness, 0.0)
    common = remaining.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    # Missing readings reduce the degrees of freedom in proportion to their share.
    share = float(known.mean())
    inner = np.where(known, remaining - common[:, None, :], 0.0).reshape(-1, channels)
    noise, apart = _patterns(inner, max(repeats * (lines - 1) * share, 1.0))
    # Variance of one reading by own noise and line ripple, and of the mean over lines if no common ripple existed.
    line = noise + float((apart**2).sum()) / channels
    together, variance = np.zeros((channels, 0)), line / (lines * share)
    few = max(repeats, 3) / (max(repeats, 3) - 2)
    if _beyond_noise((common**2).sum() / max(variance, 1e-300), repeats * channels):
        sizes, direction = np.linalg.eigh(common.T @ common / repeats)
        sizes, freedom = _shrunk(np.maximum(sizes, 0.0), repeats)
        strong = sizes > variance
        together = np.asarray(direction[:, strong] * np.sqrt((sizes[strong] - variance) * freedom / (freedom - 2)))
    # variance of the estimated gain without a true one: (noise + ripples)/Σ loudness²
    own = (line + float((together**2).sum()) / channels * lines) / size
    gain = 0.0
    if _beyond_noise((slope**2 / np.maximum(own, 1e-300)).sum(), repeats):
        gain = float(np.sqrt(max((slope**2).sum() / repeats - own.mean(), 0.0) * few))
    degrees = repeats * (lines - 1) * (channels - apart.shape[1]) * share
    return Scatter(float(np.sqrt(max(noise, 0.0))), max(int(degrees), 1), gain, together, apart)


def _beyond_noise(squares: float, degrees: int) -> bool:
    return degrees > 0 and bool(chi_square_tail(squares, degrees) < SIGNIFICANCE)


def _shrunk(sizes: Array, repeats: int) -> tuple[Array, float]:
    """Return the eigenvalues (channels,) of a sample covariance shrunk to their mean, and its degrees of freedom.

    Oracle-approximating shrinkage, (1 − ρ) S + ρ (tr S/p) 1, so that directions without a sample have a variance, too.
    Source: Chen, Wiesel, Eldar and Hero, IEEE Trans. Signal Processing 58(10), 2010.
    """
    channels, total, squares = len(sizes), float(sizes.sum()), float((sizes**2).sum())
    # ρ = ((1 − 2/p) tr S² + tr² S) / ((n + 1 − 2/p) (tr S² − tr² S/p)), at most 1
    apart = (repeats + 1 - 2 / channels) * (squares - total**2 / channels)
    share = min(((1 - 2 / channels) * squares + total**2) / max(apart, 1e-300), 1.0)
    return (1 - share) * sizes + share * total / channels, max(repeats * (1 - share + share * channels), 3.0)


def _patterns(rows: Array, freedom: float) -> tuple[float, Array]:
    """Return the noise variance of samples, and a root (channels, k) of the covariance that exceeds it.

    Eigenvalues are removed in descending order while they exceed the largest one that noise allows, given the mean of
    the remaining eigenvalues: its edge (√n + √p)²/n and EDGE_WIDTHS times its width.
    Source: Johnstone, Annals of Statistics 29(2), 2001.

    Parameters
    ----------
    rows : array, shape (samples, channels)
    freedom : float
        Degrees of freedom n of the samples.
    """
    channels = rows.shape[1]
    size, direction = np.linalg.eigh(rows.T @ rows / freedom)
    first, second = np.sqrt(freedom), np.sqrt(channels)
    # largest eigenvalue of a white Wishart matrix: n · edge = (√n + √p)² with the width (√n + √p)(1/√n + 1/√p)^⅓;
    # `unsure` allows for the error of the mean of the others
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
