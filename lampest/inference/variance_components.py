"""Variance components of repeated frames: each reading's own noise, gain, ripple, motion.

The deviation of a reading from its mean over frames is, in units of the specified σ,

    deviation = gain of the frame · voltage
                + motion of all cells and its gradients · reading
                + ripple common to all lines + ripple of the line + own noise.

The size of a gain and of a ripple has a posterior, whose mean square is the variance of the
component. Only where χ² of a ripple's deviations against the noise has a tail probability below
SIGNIFICANCE its covariance between channels is estimated: that of its deviations less the noise's,
times ν/(ν − 2), the variance of Student's t with ν degrees.

Motion is that of water, whose pressure changes all cells. Motion is a component, whatever the scene
says, where the F test of its patterns has a tail probability below SIGNIFICANCE and the remaining
noise is smaller by MIN_EXCESS.

Where no frame is unloaded, second differences of successive frames show the noise of readings at
rest.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from lampest.files.levels import MAD_TO_SIGMA, NOISE_REACH, SIGNIFICANCE, TWO_SIDED, UNUSUAL
from lampest.inference.readings.repeated import QUIET_SHARE
from lampest.panel.conditions import motion_patterns
from lampest.panel.equation import equation_of
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts.converter import mean_sigma, noise_volt
from lampest.panel.readouts.scan_order import in_scan_lines
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_tail, variance_ratio_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import Recording

# Factor on σ: a smaller excess changes no verdict, and creeping films cause it too. The ratio of
# first to second differences of noise alone is 1.00 ± 0.06 with 100 readings.
MIN_EXCESS = 1.25
# Root mean squares of a size's samples, beyond which its posterior is nothing from two samples on.
MAX_SIZES = 100.0
# Of an effect's size: less noise beside it, and sizes below this share of noise, change nothing.
MIN_NOISE_SHARE = 1e-3
TINY = 1e-300  # least divisor of a square: nothing is divided by zero
SIZES = 3000  # of a posterior: their steps are smaller than its width up to ten thousand samples
# Widths of the Tracy-Widom law beyond the edge: noise alone exceeds it once in thousands.
EDGE_WIDTHS = 3.0
# Samples for each channel, below which the smallest eigenvalues of noise come near zero, and
# rounding takes them below (tests/oracles/test_every_readout.py).
MIN_SAMPLES_PER_CHANNEL = 1.5
# Of the median size as an estimate of σ, as a share of the readings (Hampel, 1974).
MEDIAN_EFFICIENCY = 0.37
MIN_SHRUNK_FREEDOM = 3.0  # degrees of a shrunk covariance: Student's t has no variance with two
# Of the root mean square of two differences that share a frame, over √2 σ (by simulation).
PAIR_MEDIAN = 0.7960
MAX_STILL_ROUNDS = 10  # of the choice of still readings, which mostly takes three
NO_RIPPLE = np.zeros((1, 0))  # root of the covariance, for any number of channels


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
        Standard deviation of a frame's gain, as a fraction.
    common_ripple, line_ripple : array, shape (channels of a line, n)
        Roots of the covariances of the ripple that all lines of a frame share, in step with the
        scan, and of the ripple that each line has independently.
    gain_sd, ripple_sd : float
        Standard deviations of the gain, and of the ripple that all lines share, in units of σ.
    gain_tail, ripple_tail : float
        Probabilities of gains, and of a common ripple, as large in noise alone.
    motion : array, shape (3,) or (0,)
        Sizes of the patterns of motion, as fractions of the readings; none where insignificant.
    """

    own: float
    own_freedom: int
    gain: float
    common_ripple: Array
    line_ripple: Array
    gain_sd: float = 0.0
    ripple_sd: float = 0.0
    gain_tail: float = 1.0
    ripple_tail: float = 1.0
    motion: Array = field(default_factory=lambda: np.zeros(0))


def noted_excess(chi_square: float, degrees: float) -> float:
    """Return √(χ²/degrees), the factor of the noise over the specified one.

    The result is 1 where it is insignificant or small.
    """
    factor = float(np.sqrt(chi_square / degrees)) if degrees else 1.0
    noted = factor >= MIN_EXCESS and chi_square_tail(chi_square, degrees) < SIGNIFICANCE
    return factor if noted else 1.0


def unloaded_scatter(recording: Recording, resting: Readings) -> Scatter | None:
    """Return the variance components of the unloaded frames.

    The result is None where no reading is a value in two of them. Without a readout in the scene
    the voltages are unknown, and the gain multiplies the readings themselves.
    """
    circuit = recording.scene.circuit
    scene = recording.scene
    value = resting.plain_values
    if scene.readout is not None and resting.bounds.any():
        value = np.where(_beside_rails(scene, resting), np.nan, value)
    count = np.sum(~np.isnan(value), axis=0)
    if not (count > 1).any():
        return None
    value = np.where(count > 1, value, np.nan)
    middle = np.where(count > 1, np.nansum(value, axis=0) / np.maximum(count, 1), resting.value[0])
    sigma = resting.known_sigma
    # Noise of voltages is Gaussian, and that of resistances is not where a converter resolves
    # little of them.
    if scene.readout is not None:
        equation = equation_of(circuit, *middle.shape)
        value, sigma = equation.volt(value), equation.volt_sigma(value, sigma)
    deviation = (value - np.nansum(value, axis=0) / np.maximum(count, 1)) / sigma
    if scene.readout is None:
        loudness = middle / np.exp(np.log(resting.known_sigma).mean(axis=0))
    else:
        volt = circuit.volt_from_recorded(circuit.to_recorded(middle, scene))
        loudness = np.asarray(volt / np.broadcast_to(mean_sigma(scene.readout), volt.shape))
    deviation = in_scan_lines(circuit, deviation)
    loudness = in_scan_lines(circuit, loudness)
    patterns = None
    if circuit.unit == "ohm":
        usual = middle / np.exp(np.log(resting.known_sigma).mean(axis=0))
        patterns = in_scan_lines(circuit, motion_patterns(middle.shape) * usual)
    return scatter(
        deviation,
        loudness,
        len(value) - 1,
        gain=scene.gain is not None,
        ripple=scene.ripple is not None,
        patterns=patterns,
    )


def _beside_rails(scene: Scene, resting: Readings) -> Mask:
    """Return the readings (rows, columns) whose noise a rail of the converter cuts off."""
    readout = scene.circuit
    mean = resting.mean()
    steps = readout.steps_from_volt(
        readout.volt_from_recorded(readout.to_recorded(mean.value, scene))
    )
    low, high = readout.codes
    reach = NOISE_REACH * noise_volt(readout) / readout.lsb_volt
    return mean.bounds | (steps < low + reach) | (steps > high - reach)


def repeated_scatter(measured: Readings) -> Scatter | None:
    """Return the noise from second differences of successive frames.

    The result is None without three frames or without rest. Of three successive frames the second
    difference (y₀ − 2 y₁ + y₂)/(√6 σ) has unit variance, also during uniform motion. Its median
    over the still readings is that of noise, and only the quietest quarter of the triples counts.
    A reading is still if its difference is within UNUSUAL of this noise. Where first
    differences, divided by √2 σ, are larger by MIN_EXCESS, motion remains and the scatter is only
    an upper bound: it is then not taken for noise above the specified one.
    """
    value = measured.plain_values
    sigma = measured.known_sigma[1:-1]
    if len(value) < 3:
        return None
    second = np.abs(value[2:] - 2 * value[1:-1] + value[:-2]) / (np.sqrt(6) * sigma)
    to_next = value[2:] - value[1:-1]
    from_previous = value[1:-1] - value[:-2]
    first = np.sqrt((to_next**2 + from_previous**2) / 4) / sigma
    usable = np.isfinite(second).sum(axis=(1, 2)) > 1
    if not usable.any():
        return None
    second, first = second[usable], first[usable]
    still = np.isfinite(second)
    for _ in range(MAX_STILL_ROUNDS):
        noise = np.nanmedian(np.where(still, second, np.nan), axis=(1, 2), keepdims=True)
        at_rest = second <= UNUSUAL * MAD_TO_SIGMA * noise
        if (at_rest == still).all():
            break
        still = at_rest
    of_second, of_first = (
        np.nanmedian(np.where(still, size, np.nan), axis=(1, 2)) for size in (second, first)
    )
    calmest = np.argsort(of_second)[: max(1, round(QUIET_SHARE * len(of_second)))]
    quiet = float(of_second[calmest].mean()) * MAD_TO_SIGMA
    moving = float(of_first[calmest].mean()) / PAIR_MEDIAN
    if quiet > 1 and moving > MIN_EXCESS * quiet:
        return None
    count = int(still.sum() / usable.sum() * MEDIAN_EFFICIENCY)
    return Scatter(quiet, max(count, 1), 0.0, NO_RIPPLE, NO_RIPPLE)


def scatter(
    deviation: Array,
    loudness: Array,
    repeats: int,
    *,
    gain: bool = True,
    ripple: bool = True,
    patterns: Array | None = None,
) -> Scatter:
    """Return the variance components of deviations from the mean over frames.

    If neither `gain` nor `ripple` is requested, all variance is noise.

    Parameters
    ----------
    deviation : array, shape (frames, lines, channels)
        In units of σ; NaN for missing readings.
    loudness : array, shape (lines, channels)
        Response to a gain of 1, in units of σ.
    repeats : int
        Degrees of freedom of each channel, frames − 1.
    gain, ripple : bool
        Whether gains of frames, and ripples, are separated from the noise.
    patterns : array, shape (n, lines, channels), optional
        Responses to a motion of 1, in units of σ.
    """
    # Of a single line, gain and common ripple are not distinguished from its own ripple, and count
    # as that.
    gain = gain and deviation.shape[1] > 1
    # Gain of each frame by least squares, Σ deviation · loudness / Σ loudness², (frames,)
    squared_loudness = np.maximum((~np.isnan(deviation) * loudness**2).sum(axis=(1, 2)), TINY)
    gains = gain * (np.nan_to_num(deviation) * loudness).sum(axis=(1, 2)) / squared_loudness
    of_gains = gains[:, None, None] * loudness
    if patterns is not None:
        # Of gain and common motion, which resemble each other, the one that explains more is first.
        by_motion, by_gain = (_explained(deviation, one) for one in (patterns[0], loudness))
        first = of_gains if by_gain >= by_motion else np.zeros_like(of_gains)
        motion, still = _motion(deviation - first, patterns, repeats)
        if motion.size:
            parts = scatter(still + first, loudness, repeats, gain=gain, ripple=ripple)
            return replace(parts, motion=motion)
    parts = _noise_and_ripple(deviation - of_gains, repeats, gain=gain, ripple=ripple)
    if not gain:
        return parts
    # variance of the estimated gain without a true one: (noise + ripples)/Σ loudness²
    lines, channels = deviation.shape[1:]
    ripples = ((parts.line_ripple**2).sum() + lines * (parts.common_ripple**2).sum()) / channels
    variances = (parts.own**2 + ripples) / squared_loudness
    size, sd = posterior_size(float((gains**2).sum()), repeats, float(variances.mean()))
    tail = chi_square_tail((gains**2 / np.maximum(variances, TINY)).sum(), repeats)
    return replace(parts, gain=size, gain_sd=sd, gain_tail=float(tail))


def _noise_and_ripple(deviation: Array, repeats: int, *, gain: bool, ripple: bool) -> Scatter:
    """Return the variance components of deviations without gains, as `scatter` has them."""
    read = ~np.isnan(deviation)
    lines, channels = deviation.shape[1:]
    has_common_ripple = ripple and lines > 1
    # mean over lines, (frames, channels)
    common = has_common_ripple * np.nansum(deviation, axis=1) / np.maximum(read.sum(axis=1), 1)
    inner = np.nan_to_num(deviation - common[:, None, :]).reshape(-1, channels)
    # Missing readings reduce the degrees of freedom in proportion to their share.
    share = float(read.mean())
    # Without gain and ripple the mean over frames alone is taken off.
    free_lines = max(lines - 1, 1) if gain or ripple else lines
    samples = repeats * free_lines * share
    noise, line_ripple = _patterns(inner, max(samples, 1.0), separated=ripple)
    parts = Scatter(
        own=float(np.sqrt(max(noise, 0.0))),
        own_freedom=max(int(samples * (channels - line_ripple.shape[1])), 1),
        gain=0.0,
        common_ripple=np.zeros((channels, 0)),
        line_ripple=line_ripple,
    )
    if not has_common_ripple:
        return parts
    # Variance of one reading by own noise and line ripple.
    line_variance = noise + float((line_ripple**2).sum()) / channels
    root, sd, tail = _common_ripple(common, repeats, line_variance / (lines * share))
    return replace(parts, common_ripple=root, ripple_sd=sd, ripple_tail=tail)


def _explained(deviation: Array, pattern: Array) -> float:
    """Return the squares of deviations (frames, lines, channels) that a pattern explains."""
    read = ~np.isnan(deviation)
    along = (np.nan_to_num(deviation) * pattern).sum(axis=(1, 2))
    return float((along**2 / np.maximum((read * pattern**2).sum(axis=(1, 2)), TINY)).sum())


def _motion(deviation: Array, patterns: Array, repeats: int) -> tuple[Array, Array]:
    """Return the sizes of motion, (n,), or none where it is insignificant, and what remains.

    The amplitudes of each frame are those of least squares. With few frames √E[s²] of a size's
    posterior is larger than its root mean square.

    Parameters
    ----------
    deviation : array, shape (frames, lines, channels)
        In units of σ; NaN for missing readings.
    patterns : array, shape (n, lines, channels)
    repeats : int
        Degrees of freedom of each channel, frames − 1.
    """
    read = ~np.isnan(deviation)
    normal = np.einsum("ilc,jlc,flc->fij", patterns, patterns, read)
    inverse = np.linalg.pinv(normal, hermitian=True)
    amplitudes = np.einsum("fij,jlc,flc->fi", inverse, patterns, np.nan_to_num(deviation))
    still = deviation - np.tensordot(amplitudes, patterns, 1)
    seen = np.flatnonzero(np.any(patterns, axis=(1, 2)))
    moved_freedom = len(seen) * repeats
    freedom = repeats * int(np.any(read, axis=0).sum()) * float(read.mean()) - moved_freedom
    squares, remaining = (float(np.nansum(values**2)) for values in (deviation, still))
    none = np.zeros(0)
    if freedom <= 0:
        return none, deviation
    noise = max(remaining / freedom, TINY)
    ratio = max(squares - remaining, 0.0) / moved_freedom / noise
    excess = squares / (freedom + moved_freedom) / noise
    if excess < MIN_EXCESS**2 or variance_ratio_tail(ratio, moved_freedom, freedom) >= SIGNIFICANCE:
        return none, deviation
    sizes = np.zeros(len(patterns))
    for number in seen:
        variance = noise * float(inverse[:, number, number].mean())
        square = float((amplitudes[:, number] ** 2).sum())
        sizes[number] = np.hypot(*posterior_size(square, repeats, variance))
    return sizes, still


def _common_ripple(common: Array, repeats: int, variance: float) -> tuple[Array, float, float]:
    """Return the ripple that all lines share.

    Parameters
    ----------
    common : array, shape (frames, channels)
        Mean over the lines of each frame's deviations, in units of σ.
    repeats : int
        Degrees of freedom of each channel, frames − 1.
    variance : float
        Variance of that mean if no common ripple existed.

    Returns
    -------
    array, shape (channels, n)
        Root of its covariance.
    float
        Standard deviation of its size.
    float
        Probability of a ripple as large in noise alone.
    """
    channels = common.shape[1]
    squares = float((common**2).sum())
    tail = float(chi_square_tail(squares / max(variance, TINY), repeats * channels))
    size, deviation = posterior_size(squares, repeats * channels, variance)
    if not tail < SIGNIFICANCE:
        # E[s²] is the variance by an uncertain size
        return np.hypot(size, deviation) * np.eye(channels), deviation, tail
    sizes, direction = np.linalg.eigh(common.T @ common / repeats)
    sizes, freedom = _shrunk(np.maximum(sizes, 0.0), repeats)
    strong = sizes > variance
    covariance = (sizes[strong] - variance) * freedom / (freedom - 2)
    return np.asarray(direction[:, strong] * np.sqrt(covariance)), deviation, tail


def posterior_size(squares: float, freedom: float, variance: float) -> tuple[float, float]:
    """Return the posterior of the size s of an effect beside noise.

    Σ x² of n samples x ~ N(0, s² + v) is `squares`; n is `freedom`, v `variance`. The prior is p(s)
    ~ 1/(s² + v), so that the mean is unbiased for every n where an effect exceeds the noise of its
    samples: for v → 0

        E[s | x] = √(Σ x²/2) Γ(n/2)/Γ((n + 1)/2),   E[√(Σ x²)] = √2 s Γ((n + 1)/2)/Γ(n/2).

    Returns
    -------
    mean, sd : float
        Posterior mean and standard deviation, in the unit of the samples.
    """
    rms = np.sqrt(max(squares / freedom, variance, TINY))
    noise = max(variance, (rms * MIN_NOISE_SHARE) ** 2)
    sizes = np.geomspace(MIN_NOISE_SHARE * np.sqrt(noise), MAX_SIZES * rms, SIZES)
    total = sizes**2 + noise
    # −2 ln p(s) = (n + 2) ln(s² + v) + Σ x²/(s² + v), and ds = s d ln s
    costs = (freedom + 2) * np.log(total) + squares / total - 2 * np.log(sizes)
    odds = np.exp(-(costs - costs.min()) / 2)
    odds /= odds.sum()
    mean = float(odds @ sizes)
    return mean, float(np.sqrt(odds @ (sizes - mean) ** 2))


def _shrunk(sizes: Array, repeats: int) -> tuple[Array, float]:
    """Return the eigenvalues (channels,) of a shrunk sample covariance, and its degrees of freedom.

    Oracle-approximating shrinkage, (1 − ρ) S + ρ (tr S/p) 1, so that directions without a sample
    have a variance, too. Source: Chen, Wiesel, Eldar and Hero, IEEE Trans. Signal Processing
    58(10), 2010.
    """
    channels = len(sizes)
    total = float(sizes.sum())
    squares = float((sizes**2).sum())
    # ρ = ((1 − 2/p) tr S² + tr² S) / ((n + 1 − 2/p) (tr S² − tr² S/p)), at most 1
    within = (repeats + 1 - 2 / channels) * (squares - total**2 / channels)
    share = min(((1 - 2 / channels) * squares + total**2) / max(within, TINY), 1.0)
    freedom = max(repeats * (1 - share + share * channels), MIN_SHRUNK_FREEDOM)
    return (1 - share) * sizes + share * total / channels, freedom


def _patterns(rows: Array, freedom: float, *, separated: bool) -> tuple[float, Array]:
    """Return the noise variance of samples, and a root of the covariance that exceeds it.

    The root has shape (channels, k).

    Eigenvalues are removed in descending order while they exceed the largest one that noise allows,
    given the mean of the remaining eigenvalues: its edge (√n + √p)²/n and EDGE_WIDTHS times its
    width.
    Source: Johnstone, Annals of Statistics 29(2), 2001.

    Parameters
    ----------
    rows : array, shape (samples, channels)
    freedom : float
        Degrees of freedom n of the samples.
    separated : bool
        Whether the root is separated from the noise; otherwise it has no columns.
    """
    channels = rows.shape[1]
    size, direction = np.linalg.eigh(rows.T @ rows / freedom)
    first = np.sqrt(freedom)
    second = np.sqrt(channels)
    # largest eigenvalue of a white Wishart matrix: n · edge = (√n + √p)² with the width (√n +
    # √p)(1/√n + 1/√p)^⅓; `unsure` allows for the error of the mean of the others
    width = (first + second) * (1 / first + 1 / second) ** (1 / 3)
    unsure = 1 + TWO_SIDED * np.sqrt(2 / (freedom * max(channels - 1, 1)))
    edge = unsure * ((first + second) ** 2 + EDGE_WIDTHS * width) / freedom
    # Each eigenvalue against the mean of the smaller ones, from the largest down. Of white noise,
    # k of them hold what the largest one leaves of k + 1.
    smaller = np.arange(1, channels)
    left = np.maximum(smaller + 1 - (first + second) ** 2 / freedom, TINY)
    above = size[1:] > edge * np.cumsum(size)[:-1] / np.minimum(left, smaller)
    enough = separated and freedom >= MIN_SAMPLES_PER_CHANNEL * channels
    strong = int(np.argmin([*above[::-1], False])) if enough else 0
    weak = channels - strong
    noise = float(size[:weak].mean())
    return noise, np.asarray(direction[:, weak:] * np.sqrt(np.maximum(size[weak:] - noise, 0.0)))
