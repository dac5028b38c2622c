"""Estimation of a recording's noise from its own frames, and of readings with the corresponding σ."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import fitted
from lampest.estimate.deciding import MAX_NEIGHBOURS
from lampest.estimate.nuisances import MIN_REMAINING, CircuitEffects, remaining_errors, without_effects_of
from lampest.estimate.outliers import MAX_SHARE, MIN_FRAMES
from lampest.estimate.scatter import MIN_EXCESS, noted_excess, repeated_scatter, unloaded_scatter
from lampest.estimate.still_cells import possible_errors
from lampest.files.levels import SIGNIFICANCE
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import ENDLESS
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import Scene, Systematic
from lampest.panel.systematic import HIDDEN_ERRORS, Possible
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

MIN_UNLOADED_FRAMES = 5  # unloaded frames from which noise is estimated if the scene does not specify it
MAX_NAMED = 3  # modules in one sentence

SCAN_SHARES = (0.25, 0.5, 0.75, 1.0)  # shares of the period that a scan may take
MIN_REDUCTION = 3.0  # factor by which χ² must fall; also the rms of Δ·τ in σ below which motion is imperceptible

# Errors that the readings of a frame share: the texts of the summary and of warnings.
SHARED = (
    ("{:.2g} % gain", "the gain of a frame varies by {:.2g} %"),
    ("{:.2g} LSB along a scan", "the lines of a scan vary together by {:.2g} LSB"),
    ("{:.2g} LSB of a line", "the readings of a scanned line vary together by {:.2g} LSB"),
)


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of a recording, estimated from its unloaded frames and from neighbours in time.

    Attributes
    ----------
    outliers : boolean array, shape (frames, rows, columns)
    outlier_rate : float
        Share of outliers among the unloaded readings, or among all where there are too few unloaded frames.
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
    scan_share : float
        Share of its period that a scan seems to take, where loads move within it; else 0.
    of_modules : tuple of NoiseEstimate or None
        Noise of each module, None for a dead one; () for a single network.
    corrected_effects : CircuitEffects or None
        Effects that are taken off the readings; None where there are none.
    model_factor : float
        Part of `sigma_factor` that is the model's error.
    """

    outliers: NDArray[np.bool_]
    outlier_rate: float
    warnings: tuple[str, ...]
    readings: Readings
    factor: float = np.nan
    factor_error: float = np.nan
    sigma_factor: float = 1.0
    frame: FrameNoise | None = None
    possible_errors: Possible | None = None
    scan_share: float = 0.0
    of_modules: tuple["NoiseEstimate | None", ...] = ()
    corrected_effects: CircuitEffects | None = None
    model_factor: float = 1.0

    @property
    def sentence(self) -> str:
        """All warnings in one sentence."""
        return "; ".join(self.warnings)

    @property
    def corrections(self) -> str:
        """The effects that are taken off the readings, in words; '' where there are none."""
        return "" if self.corrected_effects is None else self.corrected_effects.corrections

    @property
    def reading_error(self) -> float:
        """Standard deviation of ln of a factor on each reading that is constant in time; 0 where none is observed."""
        return 0.0 if self.possible_errors is None else self.possible_errors.sizes.reading_error or 0.0

    @property
    def shared_sizes(self) -> tuple[float, float, float]:
        """Standard deviations of a frame's gain, %, of the ripple common to all lines and of each line's own, LSB."""
        if self.frame is None:
            return 0.0, 0.0, 0.0
        roots, lsb_volt = (self.frame.common_ripple, self.frame.line_ripple), self.frame.scene.circuit.lsb_volt
        together, apart = (float(np.sqrt((root**2).sum() / len(root))) / lsb_volt for root in roots)
        return 100 * self.frame.gain, together, apart

    @property
    def summary(self) -> str:
        """Noise of the frames in one line; '' where it is unknown."""
        if np.isnan(self.factor):
            return ""
        taken = "not rescaled" if self.sigma_factor == 1 else f"rescaled by {self.sigma_factor:.3g}"
        shared = ", ".join(text.format(size) for (text, _), size in zip(SHARED, self.shared_sizes, strict=True) if size)
        messages = (
            f"scatter {self.factor:.3g} +- {self.factor_error:.1g} times as specified, {taken}",
            f"frames share {shared or 'nothing'}",
            f"{int(self.outliers.sum())} of {self.outliers.size} readings are outliers",
            "" if self.possible_errors is None else _sizes_in_words(self.possible_errors),
        )
        return "; ".join(filter(None, messages))

    def with_warnings(self, *said: str) -> "NoiseEstimate":
        """Return the noise with further warnings; empty ones are ignored."""
        return replace(self, warnings=(*self.warnings, *filter(None, said)))

    def with_sigma(self, sigma: Array) -> "NoiseEstimate":
        """Return the noise with other σ of the readings."""
        return replace(self, readings=replace(self.readings, sigma=sigma))

    def with_motion(self, scene: Scene, share: float, measured: NDArray[np.intp]) -> "NoiseEstimate":
        """Return the noise with wider σ where readings were taken while loads moved.

        Parameters
        ----------
        scene : Scene
        share : float
            Share of its period that a scan takes; 0 changes nothing.
        measured : integer array
            Numbers of the measured frames.
        """
        sigma = self.readings.sigma
        if not share or sigma is None:
            return self
        moved = share * largest_change_within_scan(scene, self.readings, measured)
        count = int(np.sum(np.sqrt(np.mean((moved / sigma) ** 2, axis=(1, 2))) > 1))
        message = (
            f"motion within a scan: as if a scan took {share:.2g} of the time between frames, in {count} frames; "
            "error bars allow for it as far as their neighbours show"
        )
        return replace(self.with_sigma(np.hypot(sigma, moved)), scan_share=share).with_warnings(message)


def with_still_cells(seen: NoiseEstimate, recording: Recording, sizes: Systematic) -> NoiseEstimate:
    """Return the noise with the motion within scans and the shared errors that still cells of one network show.

    Parameters
    ----------
    seen : NoiseEstimate
    recording : Recording
        It has unloaded and measured frames.
    sizes : Systematic
        Sizes of shared errors that the scene specifies or leaves possible.
    """
    unloaded, measured = (np.flatnonzero(recording.role == role) for role in (UNLOADED, MEASURED))
    scene, resting = recording.scene, seen.readings[unloaded].mean()
    still = seen.with_motion(scene, scan_share(scene, resting, seen.readings, measured), measured)
    strongest = strongest_frame(still.readings.plain_values, resting.value, measured)
    # two frames: the strongest, and the first or the last
    chosen = np.unique([strongest, measured[0] if strongest != measured[0] else measured[-1]])
    hidden = possible_errors(scene, sizes, resting, still.readings[chosen], seen.frame)
    own = hidden.sizes.reading_error or 0.0 if hidden is not None and hidden.certain else 0.0
    message = (
        f"cells that nobody touched seem to move as if each reading were off by {100 * own:.2g} %, the same in all "
        "frames, which error bars allow for"
    )
    return replace(still, possible_errors=hidden).with_warnings(message if own > (sizes.reading_error or 0.0) else "")


def without_effects(seen: NoiseEstimate, recording: Recording, besides: CircuitEffects | None) -> NoiseEstimate:
    """Return the noise with the effects of leaks and contacts taken off the readings."""
    if besides is None or besides.pair is None:
        return seen
    unloaded = recording.role == UNLOADED
    frame, nothing = seen.frame, np.zeros((recording.scene.panel.shape[1 - recording.scene.circuit.by_columns], 0))
    if frame is None:
        frame = FrameNoise(recording.scene, int(unloaded.sum()), 0.0, nothing, nothing)
    readings = without_effects_of(besides.pair, seen.readings, unloaded)
    frame = replace(frame, effect_errors=remaining_errors(besides.pair))
    return replace(seen, readings=readings, frame=frame, corrected_effects=besides)


def estimate_noise(recording: Recording, outliers: NDArray[np.bool_], cleaned: Readings) -> NoiseEstimate:
    """Return the noise of a single network from its unloaded frames, or from measured frames at rest.

    Specified noise is replaced only if the measured one is significantly larger, or smaller for a converter, whose
    least noise is known: its step. Unspecified noise of a converter is taken from MIN_UNLOADED_FRAMES or more.

    Parameters
    ----------
    recording : Recording
    outliers : boolean array, shape (frames, rows, columns)
    cleaned : Readings
        Readings of all frames without outliers.
    """
    readout, resting = recording.scene.readout, recording.role == UNLOADED
    unloaded = int(resting.sum())
    counted = outliers[resting] if unloaded >= MIN_FRAMES and cleaned.sigma is not None else outliers
    impossible = outliers & (cleaned.seen == 0) & ~resting[:, None, None]
    plain = NoiseEstimate(outliers, float(counted.mean()), (), cleaned)
    plain = plain.with_warnings(
        _impossible_in_words(int(impossible.sum())), _outliers_in_words(plain, outliers & ~impossible)
    )
    if cleaned.sigma is None:
        return plain
    parts = unloaded_scatter(recording, cleaned[resting]) if unloaded > 1 else None
    if parts is None:
        parts = repeated_scatter(cleaned[~resting])
    if parts is None:
        return plain
    specified = readout is None or recording.sigma is not None or readout.noise_specified
    squares, few = parts.own**2 * parts.own_freedom, MIN_UNLOADED_FRAMES if readout and readout.noise_lsb is None else 2
    used = noted_excess(squares, parts.own_freedom) if specified else 1.0
    # Only of a converter it is known how small the noise may be: its step.
    if readout is not None and recording.sigma is None and used == 1:
        less = parts.own <= 1 / MIN_EXCESS and 1 - chi_square_tail(squares, parts.own_freedom) < SIGNIFICANCE
        used = shown_factor(readout, parts.own) if (less if specified else unloaded >= few) else 1.0
    error = parts.own / np.sqrt(2 * parts.own_freedom)
    message = _noise_in_words(readout, parts.own, unloaded=unloaded > 1) if specified and used != 1 else ""
    frame = None
    if readout is not None and (parts.gain or parts.common_ripple.size or parts.line_ripple.size):
        volt = float(np.mean(readout.sigma_volt()))
        frame = FrameNoise(recording.scene, unloaded, parts.gain, parts.common_ripple * volt, parts.line_ripple * volt)
    scaled = cleaned if used == 1 else replace(cleaned, sigma=used * cleaned.sigma)
    seen = replace(plain, readings=scaled, factor=parts.own, factor_error=error, sigma_factor=used, frame=frame)
    shared = [text.format(size) for (_, text), size in zip(SHARED, seen.shared_sizes, strict=True) if size]
    return seen.with_warnings(message, f"{', '.join(shared)}, which error bars allow for" if shared else "")


def noise_of_modules(recording: Recording, layout: Modules, every: Sequence[NoiseEstimate | None]) -> NoiseEstimate:
    """Return the noise of a panel of modules from the noise of each module; None stands for a dead one."""
    given = recording.readings()
    readings = [given.of_module(layout, n) if seen is None else seen.readings for n, seen in enumerate(every)]
    nothing = np.zeros(recording.modules[0].recorded.shape, dtype=bool)
    outliers = np.stack([nothing if seen is None else seen.outliers for seen in every], axis=-3)
    messages = [
        f"module {list(layout.place(n))}: {seen.sentence}" for n, seen in enumerate(every) if seen and seen.warnings
    ]
    more = f"and {len(messages) - MAX_NAMED} modules more" if len(messages) > MAX_NAMED else ""
    rate = float(np.mean([seen.outlier_rate for seen in every if seen is not None]))
    whole = NoiseEstimate(
        layout.joined(outliers), rate, (), Readings.of_parts(layout, readings), of_modules=tuple(every)
    )
    return whole.with_warnings(*messages[:MAX_NAMED], more)


def shown_factor(readout: Readout, factor: float) -> float:
    """Return the factor on the assumed σ that corresponds to a scatter of `factor` times the assumed σ.

    The two factors differ because a part of σ, the quantisation that averaging does not reduce, is constant and does
    not scatter. Without any scatter σ is that of the converter's step.
    """
    assumed = np.mean(readout.sigma_code())
    return float(np.mean(readout.sigma_code(_shown_noise(readout, factor))) / assumed)


def _shown_noise(readout: Readout, factor: float) -> float:
    """Return the noise of one reading in LSB that a scatter of `factor` times the assumed σ shows."""
    assumed = np.mean(readout.sigma_code())
    # scatter² = factor² (σ² − σ_lasting²): σ_lasting remains in the mean of endlessly many samples
    lasting = np.mean(readout.sigma_code(readout.assumed_noise, ENDLESS))
    return readout.noise_of_variance(factor**2 * float(assumed**2 - lasting**2))


def _noise_in_words(readout: Readout | None, factor: float, *, unloaded: bool) -> str:
    """Return the measured noise that replaces the specified one, in words."""
    where = "unloaded frames" if unloaded else "readings at rest from frame to frame"
    if readout is None:
        return f"noise {factor:.2g} times the recording's sigma, measured in {where}"
    specified = float(np.mean(readout.assumed_noise))
    return (
        f"noise {_shown_noise(readout, factor):.2g} LSB, measured in {where}; the scene specifies {specified:.3g} LSB"
    )


def change_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return Δ·τ, the change of each reading between the middle of its frame and its own time, (frames, rows, columns).

    Δ is half the difference between the next and the previous measured frame; the first and the last have one
    neighbour. τ is the reading's delay in periods. The unit is that of the readings; frames that are not measured
    have 0.
    """
    return np.asarray(_steps_within_scan(scene, readings, measured).mean(axis=0))


def largest_change_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return |τ| times the larger of a reading's two steps, from the previous and to the next frame.

    The central difference of `change_within_scan` would be zero for a load that is present in a single frame.
    """
    return np.asarray(np.abs(_steps_within_scan(scene, readings, measured)).max(axis=0))


def _steps_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return the steps from the previous and to the next frame, times τ, (2, frames, rows, columns).

    τ is the delay of a reading from the middle of its frame, in periods, if a scan takes the whole period.
    """
    steps, channels = np.zeros((2, *readings.value.shape)), readings.value[0].size
    if len(measured) > 1:
        step = np.diff(readings.value[measured], axis=0)
        steps[:, measured] = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    # τ of channel k of n: (k + ½)/n − ½
    late = (np.arange(channels) + 0.5) / channels - 0.5
    return steps * in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))


def scan_share(scene: Scene, resting: Readings, readings: Readings, measured: NDArray[np.intp]) -> float:
    """Return the share s of its period that the scan of a frame seems to take; 0 where the frames show no motion.

    The frames with the largest motion that have two neighbours are tested. If no cells explain their readings, s·Δ·τ
    is subtracted for each s of SCAN_SHARES, and the s with the least misfit is returned. Where no share reduces the
    misfit enough, loads move too far from frame to frame for the central difference Δ, and s is 1.
    """
    inner = measured[1:-1]
    if not len(inner) or readings.sigma is None or resting.sigma is None:
        return 0.0
    moved = change_within_scan(scene, readings, measured)
    size = np.sqrt(np.mean((moved / readings.sigma) ** 2, axis=(1, 2)))
    moving = inner[np.argsort(-size[inner])][: 1 + MAX_NEIGHBOURS]
    if size[moving[0]] < MIN_REDUCTION:
        return 0.0
    base = fitted(scene, resting, patient=True)
    if base is None or base.tail < SIGNIFICANCE:
        return 0.0

    def left(share: float) -> tuple[list[float], float]:
        """Return the tails of χ² and Σ ln(1 + χ²) of the frames after share·Δ·τ is subtracted."""
        # y − s Δτ, the readings as if taken in the middle of their frame
        freed = replace(readings, value=np.maximum(readings.value - share * moved, MIN_REMAINING * readings.value))
        fits = [fit for frame in moving if (fit := fitted(scene, freed[frame], patient=True)) is not None]
        tails = [fit.tail for fit in fits] + [1.0] * (len(moving) - len(fits))
        return tails, float(sum(np.log1p(fit.chi_square) for fit in fits))

    tails, cost = left(0.0)
    if min(tails) >= SIGNIFICANCE:
        return 0.0
    least, best = min((left(share)[1], share) for share in SCAN_SHARES)
    if least < cost - len(moving) * np.log(MIN_REDUCTION):
        return best
    return float(np.median(tails) < SIGNIFICANCE)  # the whole period, or nothing


def _impossible_in_words(count: int) -> str:
    many = "reading is" if count == 1 else "readings are"
    return f"{count} {many} larger than any cells allow beside the others, and left out" if count else ""


def _outliers_in_words(seen: NoiseEstimate, outliers: NDArray[np.bool_]) -> str:
    """Return the number of outliers and their treatment, in words; '' where there are none."""
    count = int(outliers.sum())
    if count == 0:
        return ""
    text = f"{count} of {outliers.size} readings are outliers of one frame, replaced by their neighbours in time"
    if seen.outlier_rate <= MAX_SHARE:  # else neighbours in time are outliers, too, and replace them badly
        return text
    rate = f"{100 * seen.outlier_rate:.2g} %"
    return f"{text}; at {rate} there are more that nobody sees, and error bars do not cover them"


def _sizes_in_words(hidden: Possible) -> str:
    """Return the assumed sizes of hidden errors, in words."""
    sizes, parts, row = hidden.sizes, [], 0
    bias = sizes.reading_error
    own = f"each reading off by {100 * bias:.2g} %" if bias else "no per-reading bias found"
    for error in HIDDEN_ERRORS:
        if size := error.size(sizes):
            rows = slice(row, row + error.count)
            left = 1.0 if hidden.root is None else np.sqrt((hidden.root[rows] ** 2).sum() / error.count)
            parts.append(f"{error.name} {size * left:.2g} {error.unit}")
            row += error.count
    return f"{own}; left possible, as standard deviations: {', '.join(parts) or 'nothing else'}"
