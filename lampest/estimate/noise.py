"""Estimation of a recording's noise from its own frames, and of readings with the corresponding σ.

The deviation of a reading from its mean over frames is, in units of the specified σ,

    deviation = gain of the frame · voltage + ripple common to all lines + ripple of the line + own noise.

The size of a gain and of a ripple has a posterior, whose mean square is the variance of the component. Only where χ² of
a ripple's deviations against the noise has a tail probability below SIGNIFICANCE its covariance between channels is
estimated: that of its deviations less the noise's, times ν/(ν − 2), the variance of Student's t with ν degrees.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import fitted
from lampest.estimate.deciding import MAX_NEIGHBOURS
from lampest.estimate.nuisances import CircuitEffects, remaining_errors, without_effects_of
from lampest.estimate.outliers import MAX_SHARE, MIN_FRAMES, QUIET_SHARE
from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANCE, TWO_SIDED
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import ENDLESS
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import ESTIMATED, Scene, Systematic, plain_size
from lampest.panel.systematic import READING_ERROR, SHARED_ERRORS, Possible
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording

MIN_UNLOADED_FRAMES = 5  # unloaded frames from which noise is estimated if the scene does not specify it
MAX_NAMED = 3  # modules in one sentence

SHARES = np.linspace(0, 1, 6)  # of the time between frames that a scan takes

# Factor on σ: a smaller excess changes no verdict, and creeping films cause it too. The ratio of first to second
# differences of noise alone is 1.00 ± 0.06 with 100 readings.
MIN_EXCESS = 1.25
MAX_SIZES = 100.0  # root mean squares of a size's samples, beyond which its posterior is nothing from two samples on
MIN_NOISE_SHARE = 1e-3  # of an effect's size: less noise beside it, and sizes below this share of noise, change nothing
SIZES = 3000  # of a posterior: their steps are smaller than its width up to ten thousand samples
EDGE_WIDTHS = 3.0  # widths of the Tracy-Widom law beyond the edge: noise alone exceeds it once in thousands
# Samples for each channel, below which the smallest eigenvalues of noise come near zero, and rounding takes them below
# (tests/oracles/test_every_readout.py).
MIN_SAMPLES_PER_CHANNEL = 1.5
MEDIAN_EFFICIENCY = 0.37  # of the median size as an estimate of σ, as a share of the readings (Hampel, 1974)
PAIR_MEDIAN = 0.7960  # of the root mean square of two differences that share a frame, over √2 σ (by simulation)
MIN_MEDIAN_NOISE = 0.5  # LSB: with less, most codes repeat, and the median of their differences shows no noise
NO_RIPPLE = np.zeros((1, 0))  # root of the covariance, for any number of channels

# Errors that the readings of a frame share, in the summary.
SHARED = ("{:.2g} % gain", "{:.2g} LSB along a scan", "{:.2g} LSB of a line")


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of a recording, estimated from its unloaded frames and from neighbours in time.

    Attributes
    ----------
    outliers : boolean array, shape (frames, rows, columns)
    warnings : tuple of str
        Contradictions of the scene and pitfalls, a line each.
    readings : Readings
        Readings of all frames, with corrections and the estimated σ.
    factor, factor_error : float
        Measured over specified standard deviation of each reading's own noise, and the error of this ratio; NaN where
        the frames do not determine it.
    sigma_factor : float
        Applied factor on σ; 1 where nothing contradicts the scene.
    frame : FrameNoise or None
        Errors that the readings of a frame share; None where none is significant.
    possible_errors : Possible or None
        Errors that all frames share, as far as the still cells leave them possible; None where that is unknown.
    motion : float
        Share of the time between frames that a scan takes while loads move; 0: none.
    of_modules : tuple of NoiseEstimate or None
        Noise of each module, None for a dead one; () for a single network.
    corrected_effects : CircuitEffects or None
        Effects that are taken off the readings; None where there are none.
    model_factor : float
        Part of `sigma_factor` that is the model's error.
    estimated : dict
        Key of the scene → (number, standard deviation) of each effect that the recording determined.
    """

    outliers: NDArray[np.bool_]
    warnings: tuple[str, ...]
    readings: Readings
    factor: float = np.nan
    factor_error: float = np.nan
    sigma_factor: float = 1.0
    frame: FrameNoise | None = None
    possible_errors: Possible | None = None
    motion: float = 0.0
    of_modules: tuple["NoiseEstimate | None", ...] = ()
    corrected_effects: CircuitEffects | None = None
    model_factor: float = 1.0
    estimated: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """All warnings in one sentence."""
        return "; ".join(self.warnings)

    @property
    def reading_error(self) -> float:
        """Standard deviation of ln of a factor on each reading that is constant in time; 0 where none is observed."""
        return 0.0 if self.possible_errors is None else READING_ERROR.size(self.possible_errors.sizes)

    @property
    def error_in_sigma(self) -> float:
        """The part of `reading_error` that σ of the readings includes, as a fraction of the reading."""
        return 0.0 if self.possible_errors is None else self.possible_errors.in_sigma

    @property
    def shared_sizes(self) -> tuple[float, float, float]:
        """Standard deviations of a frame's gain, %, of the ripple common to all lines and of each line's own, LSB."""
        if self.frame is None:
            return 0.0, 0.0, 0.0
        roots = (self.frame.common_ripple, self.frame.line_ripple)
        lsb_volt = self.frame.scene.circuit.lsb_volt
        common_lsb, line_lsb = (float(np.sqrt((root**2).sum() / len(root))) / lsb_volt for root in roots)
        return 100 * self.frame.gain, common_lsb, line_lsb

    @property
    def summary(self) -> str:
        """Noise of the frames in one line; '' where it is unknown."""
        if np.isnan(self.factor):
            return ""
        taken = "not rescaled" if self.sigma_factor == 1 else f"rescaled by {self.sigma_factor:.3g}"
        shared = ", ".join(text.format(size) for text, size in zip(SHARED, self.shared_sizes, strict=True) if size)
        messages = (
            f"scatter {self.factor:.3g} +- {self.factor_error:.1g} times as specified, {taken}",
            f"frames share {shared or 'nothing'}",
            f"{int(self.outliers.sum())} of {self.outliers.size} readings are outliers",
            "" if self.possible_errors is None else _sizes_in_words(self.possible_errors),
        )
        return "; ".join(filter(None, messages))

    def determined(self, key: str, size: tuple[float, float]) -> "NoiseEstimate":
        """Return the noise with a number of the scene that the recording determined.

        Parameters
        ----------
        key : str
            Key of the scene.
        size : (float, float)
            Number and standard deviation.
        """
        return replace(self, estimated={**self.estimated, key: size})

    def undetermined(self, key: str, reason: str) -> "NoiseEstimate":
        """Return the noise with a sentence on a number that the recording cannot determine: why, and what to record."""
        return self.with_warnings(f"{key}: estimated, but this recording cannot determine it: {reason}")

    def with_warnings(self, *sentences: str) -> "NoiseEstimate":
        """Return the noise with further warnings; empty ones are ignored."""
        return replace(self, warnings=(*self.warnings, *filter(None, sentences)))

    def with_sigma(self, sigma: Array) -> "NoiseEstimate":
        """Return the noise with other σ of the readings."""
        return replace(self, readings=replace(self.readings, sigma=sigma))

    def with_motion(self, scene: Scene, measured: NDArray[np.intp], share: float) -> "NoiseEstimate":
        """Return the noise with wider σ where readings were taken while loads moved.

        Parameters
        ----------
        scene : Scene
        measured : integer array
            Numbers of the measured frames.
        share : float
            Share of the time between frames that a scan takes.
        """
        sigma = self.readings.known_sigma
        moved = share * np.abs(steps_within_scan(scene, self.readings, measured)).max(axis=0)
        return replace(self.with_sigma(np.hypot(sigma, moved)), motion=share)


def without_effects(noise: NoiseEstimate, recording: Recording, besides: CircuitEffects | None) -> NoiseEstimate:
    """Return the noise with the effects of leaks and contacts taken off the readings."""
    if besides is None or besides.pair is None:
        return noise
    unloaded = recording.role == UNLOADED
    frame = noise.frame or FrameNoise(recording.scene, int(unloaded.sum()), 0.0, NO_RIPPLE, NO_RIPPLE)
    readings = without_effects_of(besides.pair, noise.readings, unloaded)
    frame = replace(frame, effect_errors=remaining_errors(besides.pair))
    return replace(noise, readings=readings, frame=frame, corrected_effects=besides)


def estimate_noise(recording: Recording, outliers: NDArray[np.bool_], cleaned: Readings) -> NoiseEstimate:
    """Return the noise of a single network from its unloaded frames, or from measured frames at rest.

    Specified noise is replaced only if the measured one is significantly larger, or smaller for a converter, whose
    least noise is known: its step. That is the residual scale, which `systematic: {model_error: 0}` excludes.
    Unspecified noise of a converter is taken from MIN_UNLOADED_FRAMES or more.

    Parameters
    ----------
    recording : Recording
    outliers : boolean array, shape (frames, rows, columns)
    cleaned : Readings
        Readings of all frames without outliers.
    """
    scene = recording.scene
    readout = recording.scene.readout
    unloaded = int((recording.role == UNLOADED).sum())
    unscaled = NoiseEstimate(outliers, _outlier_messages(outliers, cleaned, recording.role == UNLOADED), cleaned)
    unscaled = _with_specified_frame_noise(unscaled, scene, unloaded)
    asked = None if readout is None else readout.noise_lsb == ESTIMATED
    if cleaned.sigma is None or (parts := _scatter_of(recording, cleaned)) is None:
        reason = "record five or more unloaded frames"
        return unscaled.undetermined("readout.noise_lsb", reason) if asked else unscaled
    ratio = parts.own
    message = ""
    used = 1.0
    squares = ratio**2 * parts.own_freedom
    error = ratio / np.sqrt(2 * parts.own_freedom)
    specified = readout is None or recording.sigma is not None or readout.noise_specified
    if specified and not excludes_model_error(scene):
        used = noted_excess(squares, parts.own_freedom)
        smaller = ratio <= 1 / MIN_EXCESS and 1 - chi_square_tail(squares, parts.own_freedom) < SIGNIFICANCE
        where = "unloaded frames" if unloaded > 1 else "readings at rest from frame to frame"
        if readout is None:
            message = f"noise {ratio:.2g} times the recording's sigma, measured in {where}"
        else:
            noise_lsb, factor = shown_noise(readout, ratio)
            # Only of a converter it is known how small the noise may be: its step.
            used = factor if smaller and recording.sigma is None else used
            assumed = float(np.mean(readout.assumed_noise))
            measured_text = f"{noise_lsb:.2g} LSB"
            specified_text = f"{assumed:.2g} LSB"
            if measured_text != specified_text:
                message = f"noise {measured_text}, measured in {where}; the scene specifies {specified_text}"
    elif readout is not None and not specified and unloaded >= (MIN_UNLOADED_FRAMES if not asked else 2):
        used = shown_noise(readout, ratio)[1]
    scaled = replace(cleaned, sigma=used * cleaned.sigma)
    noise = replace(unscaled, readings=scaled, factor=ratio, factor_error=error, sigma_factor=used)
    noise = noise.with_warnings(message if used != 1 else "")
    if readout is not None and asked:
        size = shown_noise(readout, ratio)[0]
        noise = noise.determined("readout.noise_lsb", (size, size / np.sqrt(2 * parts.own_freedom)))
    return _with_estimated_frame_noise(noise, recording, parts)


def _with_specified_frame_noise(noise: NoiseEstimate, scene: Scene, unloaded: int) -> NoiseEstimate:
    """Return the noise with the gain and the ripple that a scene specifies as numbers."""
    gain, ripple = (plain_size(size) or 0.0 for size in (scene.gain, scene.ripple))
    if scene.readout is None or not (gain or ripple):
        return noise
    # a ripple that all lines share, independent from channel to channel
    channels = scene.panel.shape[0 if scene.circuit.by_columns else 1]
    common = ripple * scene.circuit.lsb_volt * np.eye(channels) if ripple else np.zeros((channels, 0))
    return replace(noise, frame=FrameNoise(scene, unloaded, gain, common, np.zeros((channels, 0))))


def _with_estimated_frame_noise(noise: NoiseEstimate, recording: Recording, parts: "Scatter") -> NoiseEstimate:
    """Return the noise with the gain and the ripple that the scene calls `estimated`, from the unloaded frames."""
    scene = recording.scene
    unloaded = int((recording.role == UNLOADED).sum())
    asked = [key for key in ("gain", "ripple") if getattr(scene, key) == ESTIMATED]
    if not asked or scene.readout is None:
        return noise
    if unloaded < 2:
        for key in asked:
            noise = noise.undetermined(key, "record two or more unloaded frames")
        return noise
    volt = float(np.mean(scene.readout.sigma_volt()))
    known = noise.frame or FrameNoise(scene, unloaded, 0.0, parts.common_ripple[:, :0], parts.line_ripple[:, :0])
    relative = 1 / np.sqrt(2 * (unloaded - 1))  # of a standard deviation with as many degrees of freedom
    if "gain" in asked:
        known = replace(known, gain=float(np.hypot(parts.gain, parts.gain_sd)))  # √E[s²]
        noise = noise.determined("gain", (parts.gain, parts.gain_sd))
    if "ripple" in asked:
        known = replace(known, common_ripple=parts.common_ripple * volt, line_ripple=parts.line_ripple * volt)
        noise = replace(noise, frame=known)
        size = float(np.hypot(*noise.shared_sizes[1:]))
        deviation = float(np.hypot(parts.ripple_sd * volt / scene.circuit.lsb_volt, noise.shared_sizes[2] * relative))
        noise = noise.determined("ripple", (size, deviation))
    return replace(noise, frame=known)


def excludes_model_error(scene: Scene) -> bool:
    """Return whether a scene states that its noise is right and its model has no error."""
    return isinstance(scene.systematic, Systematic) and scene.systematic.model_error == 0


def _outlier_messages(outliers: NDArray[np.bool_], cleaned: Readings, resting: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return sentences on impossible readings and on outliers; `resting` are the unloaded frames, (frames,)."""
    messages = list[str]()
    impossible = outliers & (cleaned.seen == 0) & ~resting[:, None, None]
    if count := int(impossible.sum()):
        many = "reading is" if count == 1 else "readings are"
        messages.append(f"{count} {many} larger than any cells allow beside the others, and left out")
    if count := int((outliers & ~impossible).sum()):
        # Beyond MAX_SHARE neighbours in time are outliers, too, and replace them badly.
        counted = outliers[resting] if resting.sum() >= MIN_FRAMES and cleaned.sigma is not None else outliers
        rate = float(counted.mean())
        unseen = f"; at {100 * rate:.2g} % there are more that nobody sees, and error bars do not cover them"
        message = f"{count} of {outliers.size} readings are outliers of one frame, replaced by their neighbours in time"
        messages.append(message + unseen * (rate > MAX_SHARE))
    return tuple(messages)


def _scatter_of(recording: Recording, cleaned: Readings) -> "Scatter | None":
    """Return the scatter of the unloaded frames, or of readings at rest without these; None where neither shows it.

    A scatter at rest below MIN_MEDIAN_NOISE of a converter is not used.
    """
    resting = recording.role == UNLOADED
    readout = recording.scene.readout
    parts = unloaded_scatter(recording, cleaned[resting]) if resting.sum() > 1 else None
    if parts is None:
        parts = repeated_scatter(cleaned[~resting])
        coarse = parts and readout and shown_noise(readout, parts.own)[0] < MIN_MEDIAN_NOISE
        parts = None if coarse else parts
    return parts


def noise_of_modules(recording: Recording, layout: Modules, every: Sequence[NoiseEstimate | None]) -> NoiseEstimate:
    """Return the noise of a panel of modules from the noise of each module; None stands for a dead one."""
    given = recording.readings()
    readings = [given.of_module(layout, n) if noise is None else noise.readings for n, noise in enumerate(every)]
    no_outliers = np.zeros(recording.modules[0].recorded.shape, dtype=bool)
    outliers = np.stack([no_outliers if noise is None else noise.outliers for noise in every], axis=-3)
    messages = [
        f"module {list(layout.place(n))}: {noise.sentence}" for n, noise in enumerate(every) if noise and noise.warnings
    ]
    more = f"and {len(messages) - MAX_NAMED} modules more" if len(messages) > MAX_NAMED else ""
    joined = Readings.of_parts(layout, readings)
    estimated = {
        f"{key} of module {list(layout.place(n))}": size
        for n, noise in enumerate(every)
        if noise
        for key, size in noise.estimated.items()
    }
    image = NoiseEstimate(layout.joined(outliers), (), joined, of_modules=tuple(every), estimated=estimated)
    return image.with_warnings(*messages[:MAX_NAMED], more)


def named_modules(layout: Modules, texts: Mapping[int, str], most: int | None = None) -> tuple[str, ...]:
    """Return sentences on modules, one for each text: 'modules [0, 1], [0, 2] and 3 more: dead'.

    Parameters
    ----------
    layout : Modules
    texts : mapping
        Number of a module to its text.
    most : int, optional
        Largest number of named modules in a sentence.
    """
    sentences = []
    for text in dict.fromkeys(texts.values()):
        names = [str(list(layout.place(number))) for number in texts if texts[number] == text]
        more = f" and {len(names) - most} more" if most and len(names) > most else ""
        sentences.append(f"module{'s' if len(names) > 1 else ''} {', '.join(names[:most])}{more}: {text}")
    return tuple(sentences)


def shown_noise(readout: Readout, factor: float) -> tuple[float, float]:
    """Return the noise that a scatter of `factor` times the assumed σ shows.

    Without any scatter σ is that of the converter's step.

    Returns
    -------
    float
        Noise of one reading, LSB.
    float
        Factor on the assumed σ. It differs from `factor` because a part of σ, the quantisation that averaging does not
        reduce, is constant and does not scatter.
    """
    assumed = float(np.mean(readout.sigma_code()))
    # scatter² = factor² (σ² − σ_lasting²): σ_lasting remains in the mean of endlessly many samples
    lasting = float(np.mean(readout.sigma_code(readout.assumed_noise, ENDLESS)))
    noise = readout.noise_of_variance(factor**2 * (assumed**2 - lasting**2))
    return noise, float(np.mean(readout.sigma_code(noise))) / assumed


def steps_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return the steps of each reading from the previous and to the next measured frame, times τ, (2, frames, …).

    τ is the delay of a reading from the middle of its frame, in periods, if a scan takes the whole period. The first
    and the last frame have one neighbour; frames that are not measured have 0. The mean of both steps is the change
    between the middle of a frame and a reading's own time. It is zero for a load that is present in a single frame,
    and the larger step is not.
    """
    steps = np.zeros((2, *readings.value.shape))
    channels = readings.value[0].size
    if len(measured) > 1:
        step = np.diff(readings.value[measured], axis=0)
        steps[:, measured] = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    # τ of channel k of n: (k + ½)/n − ½
    late = (np.arange(channels) + 0.5) / channels - 0.5
    return steps * in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))


def share_of_motion(
    scene: Scene, resting: Readings, readings: Readings, measured: NDArray[np.intp]
) -> tuple[float, float] | None:
    """Return the share of the time between frames that a scan takes, and its standard deviation; None where unknown.

    No cells explain the readings of a frame that was scanned while a load moved. The frames with the largest motion
    are fitted with σ² + (share · step · τ)², and their likelihood is compared over SHARES, all equally probable before.
    Of d degrees of freedom, readings that no cells follow,

        −2 ln p(share) = χ² + d · mean ln(1 + (share · step · τ/σ)²).

    Loads that no frame shows to move, or whose frames cells explain whatever the share, tell nothing of it.
    """
    inner = measured[1:-1]
    if not len(inner) or readings.sigma is None or resting.sigma is None:
        return None
    steps = np.abs(steps_within_scan(scene, readings, measured)).max(axis=0)
    size = np.sqrt(np.mean((steps / readings.sigma) ** 2, axis=(1, 2)))
    moving = inner[np.argsort(-size[inner])][: 1 + MAX_NEIGHBOURS]
    base = fitted(scene, resting, patient=True)
    if base is None or base.tail < SIGNIFICANCE:
        return None
    costs = np.zeros(len(SHARES))
    broken = 0
    for frame in moving:
        near = None
        for number, share in enumerate(SHARES):
            widened = np.hypot(readings.known_sigma[frame], share * steps[frame])
            fit = fitted(scene, replace(readings[frame], sigma=widened), near, patient=True)
            if fit is None:
                return None
            near = fit.cells
            spread = float(np.mean(np.log(widened / readings.known_sigma[frame])))
            costs[number] += fit.chi_square + 2 * fit.degrees * spread
            broken += number == 0 and fit.tail < SIGNIFICANCE
    if not broken:
        return None
    odds = np.exp(-(costs - costs.min()) / 2)
    odds /= odds.sum()
    mean = float(odds @ SHARES)
    return mean, float(np.sqrt(max(float(odds @ SHARES**2) - mean**2, 0.0)))


def _sizes_in_words(possible: Possible) -> str:
    """Return the sizes of shared errors, in words."""
    sized = [(error, error.size(possible.sizes)) for error in SHARED_ERRORS]
    parts = [f"{error.name} {size:.2g} {error.unit}".rstrip() for error, size in sized if size]
    return f"frames share, as standard deviations: {', '.join(parts)}" if parts else ""


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
        Roots of the covariances of the ripple that all lines of a frame share, in step with the scan, and of the
        ripple that each line has independently.
    gain_sd, ripple_sd : float
        Standard deviations of the gain, and of the ripple that all lines share, in units of σ.
    gain_tail, ripple_tail : float
        Probabilities of gains, and of a common ripple, as large in noise alone.
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


def noted_excess(chi_square: float, degrees: float) -> float:
    """Return √(χ²/degrees), the factor of the noise over the specified one; 1 where it is insignificant or small."""
    factor = float(np.sqrt(chi_square / degrees)) if degrees else 1.0
    return factor if factor >= MIN_EXCESS and chi_square_tail(chi_square, degrees) < SIGNIFICANCE else 1.0


def unloaded_scatter(recording: Recording, resting: Readings) -> Scatter | None:
    """Return the variance components of the unloaded frames; None where no reading is a value in two of them.

    Without a readout in the scene the voltages are unknown, and the gain multiplies the readings themselves.
    """
    circuit = recording.scene.circuit
    scene = recording.scene
    value = resting.plain_values
    count = np.sum(~np.isnan(value), axis=0)
    if not (count > 1).any():
        return None
    value = np.where(count > 1, value, np.nan)
    middle = np.where(count > 1, np.nansum(value, axis=0) / np.maximum(count, 1), resting.value[0])
    deviation = (value - middle) / resting.known_sigma
    if scene.readout is None:
        loudness = middle / np.exp(np.log(resting.known_sigma).mean(axis=0))
    else:
        volt = circuit.volt_from_recorded(circuit.to_recorded(middle, scene))
        loudness = np.asarray(volt / np.broadcast_to(scene.readout.sigma_volt(), volt.shape))
    if circuit.by_columns:
        deviation = deviation.swapaxes(1, 2)
        loudness = loudness.T
    return scatter(deviation, loudness, len(value) - 1, gain=scene.gain is not None, ripple=scene.ripple is not None)


def repeated_scatter(measured: Readings) -> Scatter | None:
    """Return the noise from second differences of successive frames; None without three frames or without rest.

    Of three successive frames the second difference (y₀ − 2 y₁ + y₂)/(√6 σ) has unit variance, also during uniform
    motion. Its median over the readings is that of the readings at rest, and only the quietest quarter of the triples
    counts. Where first differences, divided by √2 σ, are larger by MIN_EXCESS, motion remains and the scatter is only
    an upper bound: it is then not taken for noise above the specified one.
    """
    value = measured.plain_values
    sigma = measured.known_sigma[1:-1]
    if len(value) < 3:
        return None
    second = np.abs(value[2:] - 2 * value[1:-1] + value[:-2]) / (np.sqrt(6) * sigma)
    first = np.sqrt(((value[2:] - value[1:-1]) ** 2 + (value[1:-1] - value[:-2]) ** 2) / 4) / sigma
    usable = np.isfinite(second).sum(axis=(1, 2)) > 1
    if not usable.any():
        return None
    of_second, of_first = (np.nanmedian(size[usable], axis=(1, 2)) for size in (second, first))
    calmest = np.argsort(of_second)[: max(1, round(QUIET_SHARE * len(of_second)))]
    quiet = float(of_second[calmest].mean()) * MAD_TO_SIGMA
    moving = float(of_first[calmest].mean()) / PAIR_MEDIAN
    if quiet > 1 and moving > MIN_EXCESS * quiet:
        return None
    count = int(np.isfinite(second[usable]).sum() / usable.sum() * MEDIAN_EFFICIENCY)
    return Scatter(quiet, max(count, 1), 0.0, NO_RIPPLE, NO_RIPPLE)


def scatter(deviation: Array, loudness: Array, repeats: int, *, gain: bool = True, ripple: bool = True) -> Scatter:
    """Return the variance components of deviations from the mean over frames; all is noise without `gain`, `ripple`.

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
    # Of a single line, gain and common ripple are not distinguished from its own ripple, and count as that.
    several = lines > 1
    free = max(lines - 1, 1)
    loud = np.maximum((known * loudness**2).sum(axis=(1, 2)), 1e-300)
    # Gain of each frame by least squares, Σ deviation · loudness / Σ loudness², (frames,); then the mean over lines,
    # (frames, channels).
    slope = gain * several * (np.nan_to_num(deviation) * loudness).sum(axis=(1, 2)) / loud
    remaining = np.where(known, deviation - slope[:, None, None] * loudness, 0.0)
    common = ripple * several * remaining.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    # Missing readings reduce the degrees of freedom in proportion to their share.
    share = float(known.mean())
    inner = np.where(known, remaining - common[:, None, :], 0.0).reshape(-1, channels)
    # Without gain and ripple the mean over frames alone is taken off.
    samples = repeats * (free if gain or ripple else lines) * share
    noise, line_ripple = _patterns(inner, max(samples, 1.0), separated=ripple)
    # Variance of one reading by own noise and line ripple, and of the mean over lines if no common ripple existed.
    line = noise + float((line_ripple**2).sum()) / channels
    shared = np.zeros((channels, 0))
    variance = line / (lines * share)
    ripple_sd = 0.0
    ripple_tail = 1.0
    if ripple and several:
        squares = float((common**2).sum())
        ripple_tail = float(chi_square_tail(squares / max(variance, 1e-300), repeats * channels))
        size, ripple_sd = posterior_size(squares, repeats * channels, variance)
        shared = np.hypot(size, ripple_sd) * np.eye(channels)  # E[s²] is the variance by an uncertain size
    if ripple_tail < SIGNIFICANCE:
        sizes, direction = np.linalg.eigh(common.T @ common / repeats)
        sizes, freedom = _shrunk(np.maximum(sizes, 0.0), repeats)
        strong = sizes > variance
        shared = np.asarray(direction[:, strong] * np.sqrt((sizes[strong] - variance) * freedom / (freedom - 2)))
    swing = gain_sd = 0.0
    gain_tail = 1.0
    if gain and several:
        # variance of the estimated gain without a true one: (noise + ripples)/Σ loudness²
        variances = (line + float((shared**2).sum()) / channels * lines) / loud
        gain_tail = float(chi_square_tail((slope**2 / np.maximum(variances, 1e-300)).sum(), repeats))
        swing, gain_sd = posterior_size(float((slope**2).sum()), repeats, float(variances.mean()))
    degrees = samples * (channels - line_ripple.shape[1])
    own = float(np.sqrt(max(noise, 0.0)))
    tails = gain_tail, ripple_tail
    return Scatter(own, max(int(degrees), 1), swing, shared, line_ripple, gain_sd, ripple_sd, *tails)


def posterior_size(squares: float, freedom: float, variance: float) -> tuple[float, float]:
    """Return the posterior mean and standard deviation of the size s of an effect beside noise.

    Σ x² of n samples x ~ N(0, s² + v) is `squares`; n is `freedom`, v `variance`. The prior is p(s) ~ 1/(s² + v), so
    that the mean is unbiased for every n where an effect exceeds the noise of its samples: for v → 0

        E[s | x] = √(Σ x²/2) Γ(n/2)/Γ((n + 1)/2),   E[√(Σ x²)] = √2 s Γ((n + 1)/2)/Γ(n/2).
    """
    rms = np.sqrt(max(squares / freedom, variance, 1e-300))
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
    """Return the eigenvalues (channels,) of a sample covariance shrunk to their mean, and its degrees of freedom.

    Oracle-approximating shrinkage, (1 − ρ) S + ρ (tr S/p) 1, so that directions without a sample have a variance, too.
    Source: Chen, Wiesel, Eldar and Hero, IEEE Trans. Signal Processing 58(10), 2010.
    """
    channels = len(sizes)
    total = float(sizes.sum())
    squares = float((sizes**2).sum())
    # ρ = ((1 − 2/p) tr S² + tr² S) / ((n + 1 − 2/p) (tr S² − tr² S/p)), at most 1
    within = (repeats + 1 - 2 / channels) * (squares - total**2 / channels)
    share = min(((1 - 2 / channels) * squares + total**2) / max(within, 1e-300), 1.0)
    return (1 - share) * sizes + share * total / channels, max(repeats * (1 - share + share * channels), 3.0)


def _patterns(rows: Array, freedom: float, *, separated: bool) -> tuple[float, Array]:
    """Return the noise variance of samples, and a root (channels, k) of the covariance that exceeds it.

    The root has no columns unless it is `separated` from the noise.

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
    first = np.sqrt(freedom)
    second = np.sqrt(channels)
    # largest eigenvalue of a white Wishart matrix: n · edge = (√n + √p)² with the width (√n + √p)(1/√n + 1/√p)^⅓;
    # `unsure` allows for the error of the mean of the others
    width = (first + second) * (1 / first + 1 / second) ** (1 / 3)
    unsure = 1 + TWO_SIDED * np.sqrt(2 / (freedom * max(channels - 1, 1)))
    edge = unsure * ((first + second) ** 2 + EDGE_WIDTHS * width) / freedom
    # Each eigenvalue against the mean of the smaller ones, from the largest down.
    above = size[1:] > edge * np.cumsum(size)[:-1] / np.arange(1, channels)
    enough = separated and freedom >= MIN_SAMPLES_PER_CHANNEL * channels
    strong = int(np.argmin([*above[::-1], False])) if enough else 0
    weak = channels - strong
    noise = float(size[:weak].mean())
    return noise, np.asarray(direction[:, weak:] * np.sqrt(np.maximum(size[weak:] - noise, 0.0)))
