"""Noise of a recording, estimated from its own frames, and readings with the corresponding σ.

The scatter of unloaded frames (`lampest.inference.variance_components`) is compared with the
specified noise. Specified noise is replaced only where the frames contradict it; noise, gain and
ripple that a scene leaves open are taken from them. `NoiseEstimate` holds the result, with a
sentence for each number and contradiction. That of a panel of modules is from that of each module.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from lampest.files.levels import SIGNIFICANCE
from lampest.files.typed import ReadOnlyArrays
from lampest.inference.variance_components import (
    MIN_EXCESS,
    NO_RIPPLE,
    Scatter,
    noted_excess,
    repeated_scatter,
    unloaded_scatter,
)
from lampest.panel.effects import READINGS, Possible, recorded_times, sized_effects
from lampest.panel.panel import Array, Mask, Modules
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import (
    averaged_variance,
    constant_share,
    noise_of_variance,
    sigma_code,
    states_noise,
)
from lampest.panel.scene import Scene
from lampest.panel.sizes import ESTIMATED, Systematic
from lampest.posterior.interval import chi_square_tail, normal_quantile
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording

if TYPE_CHECKING:
    from lampest.inference.circuits.alike import PanelChoice
    from lampest.inference.nuisances import CircuitEffects
    from lampest.posterior.frame_noise import FrameNoise

# Unloaded frames from which noise is estimated if the scene does not specify it.
MIN_UNLOADED_FRAMES = 5
MIN_REQUESTED_FRAMES = 2  # where the scene calls it `estimated`: two frames show a scatter
# LSB: with less, most codes repeat, and the median of their differences shows no noise
MIN_MEDIAN_NOISE = 0.5

# Errors that the readings of a frame share, in the summary.
SHARED = ("{:.2g} % gain", "{:.2g} LSB along a scan", "{:.2g} LSB of a line")
MOVED = "readings at rest move together by {:.2g} %, as moving water or the supply moves them"
MAX_NAMED = 3  # modules in one sentence
BROKE_DOWN = "arithmetic broke down over its readings"  # why a number is undetermined


class Share(NamedTuple):
    """Share of the time between frames that a scan takes.

    Attributes
    ----------
    mean, deviation : float
        Share at which still cells are stillest, and its standard deviation as that of the scan.
    reach : float
        Mean of the share without attenuation: the interpolation is wrong over that time.
    gain : float
        Decrease of −2 ln evidence from no motion to the most probable share without jitter.
    jitter : float
        Relative standard deviation of the load within a scan.
    steady : float
        Probability of no jitter.
    """

    mean: float
    deviation: float
    reach: float
    gain: float = 0.0
    jitter: float = 0.0
    steady: float = 1.0


@dataclass(frozen=True, eq=False)
class NoiseEstimate(ReadOnlyArrays):
    """Noise of a recording, estimated from its unloaded frames and from neighbours in time.

    Attributes
    ----------
    outliers : boolean array, shape (frames, rows, columns)
    warnings : tuple of str
        Contradictions of the scene and pitfalls, a line each.
    readings : Readings
        Readings of all frames, with corrections and the estimated σ.
    factor, factor_error : float
        Measured over specified standard deviation of each reading's own noise, and the error of
        this ratio; NaN where the frames do not determine it.
    sigma_factor : float
        Applied factor on σ; 1 where nothing contradicts the scene.
    frame : FrameNoise or None
        Errors that the readings of a frame share; None where none is significant.
    possible_errors : Possible or None
        Errors that all frames share, as far as the still cells leave them possible; None where that
        is unknown.
    motion : Share or None
        Share of the time between frames that a scan takes while loads move; None: readings are not
        interpolated.
    of_modules : tuple of NoiseEstimate or None
        Noise of each module, None for a dead one; () for a single network.
    corrected_effects : CircuitEffects or None
        Effects that are taken off the readings; None where there are none.
    model_factor : float
        Part of `sigma_factor` that is the model's error.
    estimated : dict
        Key of the scene → (number, standard deviation) of each effect that the recording
        determined.
    panels : PanelChoice or None
        Cells of the unloaded and of a loaded frame, where several panels give their readings.
    """

    outliers: Mask
    warnings: tuple[str, ...]
    readings: Readings
    factor: float = np.nan
    factor_error: float = np.nan
    sigma_factor: float = 1.0
    frame: "FrameNoise | None" = None
    possible_errors: Possible | None = None
    motion: Share | None = None
    of_modules: tuple["NoiseEstimate | None", ...] = ()
    corrected_effects: "CircuitEffects | None" = None
    model_factor: float = 1.0
    estimated: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    panels: "PanelChoice | None" = None

    @property
    def sentence(self) -> str:
        """All warnings in one sentence."""
        return "; ".join(self.warnings)

    @property
    def resting_cells(self) -> Array | None:
        """Cells of the unloaded panel, where several panels give its readings; else None."""
        return None if self.panels is None else self.panels.resting

    @property
    def reading_error(self) -> float:
        """Standard deviation of ln of a factor on each reading that is constant in time.

        The value is 0 where none is observed.
        """
        if self.possible_errors is None:
            return 0.0
        return self.possible_errors.sizes.size(READINGS)

    def of_frames(self, recording: Recording) -> "FrameNoise":
        """Return the errors that the readings of a frame share, without a size where none has."""
        from lampest.posterior.frame_noise import FrameNoise  # for scenes that name any

        unloaded = int((recording.role == UNLOADED).sum())
        return self.frame or FrameNoise(recording.scene, unloaded, 0.0, NO_RIPPLE, NO_RIPPLE)

    @property
    def shared_sizes(self) -> tuple[float, float, float]:
        """Standard deviations of the errors that the readings of a frame share.

        Returns
        -------
        gain : float
            In percent.
        common_ripple, line_ripple : float
            Ripple common to all lines, and each line's own, in LSB.
        """
        if self.frame is None:
            return 0.0, 0.0, 0.0
        roots = (self.frame.common_ripple, self.frame.line_ripple)
        lsb_volt = self.frame.scene.circuit.lsb_volt
        common_lsb, line_lsb = (
            float(np.sqrt((root**2).sum() / len(root))) / lsb_volt for root in roots
        )
        return 100 * self.frame.gain, common_lsb, line_lsb

    @property
    def summary(self) -> str:
        """Noise of the frames in one line; '' where it is unknown."""
        if np.isnan(self.factor):
            return ""
        rescaling = "not rescaled"
        if self.sigma_factor != 1:
            rescaling = f"rescaled by {self.sigma_factor:.3g}"
        shared = ", ".join(
            text.format(size) for text, size in zip(SHARED, self.shared_sizes, strict=True) if size
        )
        motion = 0.0 if self.frame is None else np.hypot.reduce(self.frame.motion, initial=0.0)
        shared += f"{shared and ', '}{100 * motion:.2g} % motion" if motion else ""
        messages = (
            f"scatter {self.factor:.3g} +- {self.factor_error:.1g} times as specified, {rescaling}",
            f"frames share {shared or 'nothing'}",
            f"{int(self.outliers.sum())} of {self.outliers.size} readings are outliers",
            "" if self.possible_errors is None else _sizes_in_words(self.possible_errors),
        )
        return "; ".join(filter(None, messages))

    def number(self, key: str) -> float | None:
        """Return the number that the recording determined under a key; None without one."""
        return self.estimated[key][0] if key in self.estimated else None

    def determined(self, key: str, size: tuple[float, float]) -> "NoiseEstimate":
        """Return the noise with a number of the scene that the recording determined.

        Parameters
        ----------
        key : str
            Key of the scene.
        size : (float, float)
            Number and standard deviation. Where either is NaN, the number is undetermined.
        """
        if np.isnan(size).any():
            return self.undetermined(key, BROKE_DOWN)
        return replace(self, estimated={**self.estimated, key: size})

    def undetermined(self, key: str, reason: str) -> "NoiseEstimate":
        """Return the noise with a sentence on a number that the recording cannot determine.

        The sentence states the reason, and the frames to record.
        """
        return self.with_warnings(
            f"{key}: estimated, but this recording cannot determine it: {reason}"
        )

    def with_warnings(self, *sentences: str) -> "NoiseEstimate":
        """Return the noise with further warnings; empty ones are ignored."""
        return replace(self, warnings=(*self.warnings, *filter(None, sentences)))

    def with_sigma(self, sigma: Array) -> "NoiseEstimate":
        """Return the noise with other σ of the readings."""
        return replace(self, readings=replace(self.readings, sigma=sigma))

    def with_errors(self, possible: Possible, scene: Scene) -> "NoiseEstimate":
        """Return the noise with errors that all frames share, and readings without the known part.

        σ stays that of the noise: errors that frames share widen error bars, and weights do not see
        them.
        """
        readings = without_factors(self.readings, scene, possible.log_factor)
        recorded = scene.circuit.to_recorded(readings.value, scene)
        corrected = possible.corrected(scene)
        value = corrected.circuit.from_recorded(recorded, corrected)
        return replace(self, possible_errors=possible, readings=replace(readings, value=value))

    @property
    def log_factor(self) -> Array | None:
        """Logarithm of the factor on each recorded value that `readings` are corrected for.

        The value is None where they are not corrected.
        """
        return None if self.possible_errors is None else self.possible_errors.log_factor


def without_factors(readings: Readings, scene: Scene, log_factor: Array | None) -> Readings:
    """Return readings without factors on the recorded values, whose logarithms are given."""
    if log_factor is None:
        return readings
    return replace(readings, value=recorded_times(readings.value, scene, np.exp(-log_factor)))


class FrameEffect(Protocol):
    """An effect that the readings of a frame share, as the noise of the frames has it."""

    def in_frames(
        self, noise: NoiseEstimate, recording: Recording, scatter: Scatter | None
    ) -> NoiseEstimate:
        """Return the noise of the frames with the effect, given their scatter if it is known."""


def estimate_noise(
    recording: Recording,
    outliers: Mask,
    cleaned: Readings,
    effects: Sequence[FrameEffect] = (),
) -> NoiseEstimate:
    """Return the noise of a single network from its unloaded frames, or measured ones at rest.

    Specified noise is replaced only if the measured one is significantly larger, or smaller for a
    converter, whose least noise is known: its step. That is the residual scale, which `systematic:
    {model_error: 0}` excludes. Unspecified noise of a converter is taken from MIN_UNLOADED_FRAMES
    or more.

    Parameters
    ----------
    recording : Recording
    outliers : boolean array, shape (frames, rows, columns)
    cleaned : Readings
        Readings of all frames without impossible ones.
    effects : sequence of FrameEffect
        Those that the scene names.
    """
    scene = recording.scene
    readout = scene.readout
    unloaded = int((recording.role == UNLOADED).sum())
    unscaled = NoiseEstimate(outliers, (), cleaned)
    requested = readout is not None and readout.noise_lsb == ESTIMATED
    parts = None if cleaned.sigma is None else _scatter_of(recording, cleaned)
    if cleaned.sigma is None or parts is None:
        for effect in effects:
            unscaled = effect.in_frames(unscaled, recording, None)
        reason = "record five or more unloaded frames"
        return unscaled.undetermined("readout.noise_lsb", reason) if requested else unscaled
    precision = np.sqrt(2 * parts.own_freedom)  # of a standard deviation, over its error
    factor = 1.0
    size, shown = (0.0, 1.0) if readout is None else shown_noise(readout, parts.own)
    specified = readout is None or states_noise(readout) or recording.sigma is not None
    enough_frames = MIN_REQUESTED_FRAMES if requested else MIN_UNLOADED_FRAMES
    if specified and not excludes_model_error(scene):
        factor = _contradicting_factor(recording, parts)
        if factor != 1:
            words = _contradiction_in_words(readout, parts.own, unloaded)
            unscaled = unscaled.with_warnings(words)
    elif not specified and unloaded >= enough_frames:
        factor = shown
    scaled = replace(cleaned, sigma=factor * cleaned.sigma)
    if readout is not None and scaled.constant is not None and factor != 1:
        # noise as large as the shown one dithers the rounding
        scaled = replace(scaled, constant=constant_share(readout, size) * scaled.known_sigma)
    error = parts.own / precision
    noise = replace(
        unscaled, readings=scaled, factor=parts.own, factor_error=error, sigma_factor=factor
    )
    if requested:
        hidden = unseen_noise(parts.own_freedom)
        deviation = size / precision if size > hidden else hidden
        noise = noise.determined("readout.noise_lsb", (size, deviation))
    for effect in effects:
        noise = effect.in_frames(noise, recording, parts)
    return _with_motion(noise, scene, unloaded, parts) if parts.motion.size else noise


def _with_motion(
    noise: NoiseEstimate, scene: Scene, unloaded: int, parts: Scatter
) -> NoiseEstimate:
    """Return the noise with the motion of readings at rest."""
    from lampest.posterior.frame_noise import FrameNoise  # for frames that move

    none = np.zeros((len(parts.common_ripple), 0))
    frame = noise.frame or FrameNoise(scene, unloaded, 0.0, none, none)
    moved = MOVED.format(100 * float(np.hypot.reduce(parts.motion)))
    return replace(noise, frame=replace(frame, motion=parts.motion)).with_warnings(moved)


def _contradicting_factor(recording: Recording, parts: Scatter) -> float:
    """Return the factor on specified noise by which the frames contradict it; 1 where they do not.

    Smaller noise than specified is a contradiction of a converter alone, whose least noise is
    known: its step.
    """
    readout = recording.scene.readout
    squares = parts.own**2 * parts.own_freedom
    expected = 0.0 if readout is None or recording.sigma is not None else scattering_share(readout)
    if readout is not None and parts.own * MIN_EXCESS < expected:
        below = 1 - chi_square_tail(squares / expected**2, parts.own_freedom)
        noise, factor = shown_noise(readout, parts.own)
        constant = factor * constant_share(readout, noise) - constant_share(readout)
        change = max(abs(factor - 1), float(np.abs(constant).mean()))
        # with less noise than rounding σ is that of the step, whatever the noise is
        if below < SIGNIFICANCE and change > MIN_EXCESS - 1:
            return factor
    return noted_excess(squares, parts.own_freedom)


def scattering_share(readout: Readout) -> float:
    """Return the share of the assumed σ by which readings at rest scatter from frame to frame.

    The quantisation that averaging does not remove is the same in all frames.
    """
    scattering = np.mean(averaged_variance(readout, readout.assumed_noise))
    return float(np.sqrt(scattering / np.mean(sigma_code(readout) ** 2)))


def _contradiction_in_words(readout: Readout | None, ratio: float, unloaded: int) -> str:
    """Return the sentence on noise of `ratio` times the specified one.

    The result is '' where both are equal in two digits. `unloaded` is the number of unloaded
    frames.
    """
    where = "unloaded frames" if unloaded > 1 else "readings at rest from frame to frame"
    if readout is None:
        return f"noise {ratio:.2g} times the recording's sigma, measured in {where}"
    measured = f"{shown_noise(readout, ratio)[0]:.2g} LSB"
    specified = f"{float(np.mean(readout.assumed_noise)):.2g} LSB"
    if measured == specified:
        return ""
    return f"noise {measured}, measured in {where}; the scene specifies {specified}"


def excludes_model_error(scene: Scene) -> bool:
    """Return whether a scene states that its noise is right and its model has no error."""
    return isinstance(scene.systematic, Systematic) and scene.systematic.model_error == 0


def _scatter_of(recording: Recording, cleaned: Readings) -> Scatter | None:
    """Return the scatter of the unloaded frames, or of readings at rest without these.

    The result is None where neither shows it. A scatter at rest below MIN_MEDIAN_NOISE of a
    converter is not used.
    """
    resting = recording.role == UNLOADED
    readout = recording.scene.readout
    parts = unloaded_scatter(recording, cleaned[resting]) if resting.sum() > 1 else None
    if parts is None:
        parts = repeated_scatter(cleaned[~resting])
        if parts is not None and readout is not None:
            coarse = shown_noise(readout, parts.own)[0] < MIN_MEDIAN_NOISE
            parts = None if coarse else parts
    return parts


def shown_noise(readout: Readout, factor: float) -> tuple[float, float]:
    """Return the noise that a scatter of `factor` times the assumed σ shows.

    Without any scatter σ is that of the converter's step.

    Returns
    -------
    float
        Noise of one reading, LSB.
    float
        Factor on the assumed σ. It differs from `factor` because a part of σ, the quantisation that
        averaging does not reduce, is constant and does not scatter.
    """
    assumed = float(np.mean(sigma_code(readout)))
    noise = noise_of_variance(readout, (factor * assumed) ** 2)
    return noise, float(np.mean(sigma_code(readout, noise))) / assumed


def unseen_noise(count: float) -> float:
    """Return the noise in LSB that `count` readings in the middle of a step do not show.

    Half a reading of them lies beyond half a step then.
    """
    return float(0.5 / normal_quantile(1 - 1 / (4 * max(count, 1.0))))


def _sizes_in_words(possible: Possible) -> str:
    """Return the sizes of shared errors, in words."""
    sized = [(error, possible.sizes.size(error.setting)) for error in sized_effects(possible.sizes)]
    parts = [f"{error.name} {size:.2g} {error.unit}".rstrip() for error, size in sized if size]
    return f"frames share, as standard deviations: {', '.join(parts)}" if parts else ""


def noise_of_modules(
    recording: Recording, layout: Modules, every: Sequence[NoiseEstimate | None]
) -> NoiseEstimate:
    """Return the noise of a panel of modules from the noise of each module.

    None stands for a dead one.
    """
    recorded = recording.readings()
    readings = [
        recorded.of_module(layout, n) if noise is None else noise.readings
        for n, noise in enumerate(every)
    ]
    no_outliers = np.zeros(recording.modules[0].recorded.shape, dtype=bool)
    outliers = np.stack(
        [no_outliers if noise is None else noise.outliers for noise in every], axis=-3
    )
    messages = [
        f"module {list(layout.place(n))}: {noise.sentence}"
        for n, noise in enumerate(every)
        if noise is not None and noise.warnings
    ]
    more = f"and {len(messages) - MAX_NAMED} modules more" if len(messages) > MAX_NAMED else ""
    joined = Readings.of_parts(layout, readings)
    estimated = dict[str, tuple[float, float]]()
    for n, noise in enumerate(every):
        if noise is not None:
            place = list(layout.place(n))
            estimated |= {f"{key} of module {place}": size for key, size in noise.estimated.items()}
    image = NoiseEstimate(
        layout.joined(outliers), (), joined, of_modules=tuple(every), estimated=estimated
    )
    return image.with_warnings(*messages[:MAX_NAMED], more)


def named_modules(
    layout: Modules, texts: Mapping[int, str], most: int | None = None
) -> tuple[str, ...]:
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
        sentences.append(
            f"module{'s' if len(names) > 1 else ''} {', '.join(names[:most])}{more}: {text}"
        )
    return tuple(sentences)
