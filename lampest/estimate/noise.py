"""Noise of a recording as its own frames show it, and readings that allow for it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import SIGNIFICANCE, fitted
from lampest.estimate.nuisances import CircuitEffects, remaining_errors, without_effects_of
from lampest.estimate.outliers import MAX_SHARE, MIN_FRAMES
from lampest.estimate.scatter import MIN_EXCESS, repeated_scatter, unloaded_scatter
from lampest.estimate.still_cells import possible_errors
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import ENDLESS, noise_of_variance, sigma_code
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import Scene, Systematic
from lampest.panel.systematic import SINES, Possible
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

MIN_UNLOADED_FRAMES = 5  # unloaded frames from which on noise that a scene leaves open is taken from them
MAX_NAMED = 3  # modules in one sentence

SCAN_SHARES = (0.25, 0.5, 0.75, 1.0)  # of the period that a scan may take
MAX_MOVING_FRAMES = 3  # frames, those that move most, in which it is sought
MIN_REDUCTION = 3.0  # by which χ² must fall, and the rms of Δ·τ in σ below which nobody would notice it
MIN_REMAINING = 0.1  # of a reading, however fast it changes


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of a recording, estimated from its unloaded frames and from neighbours in time.

    Attributes
    ----------
    outliers : boolean array, shape (frames, rows, columns)
    outlier_rate : float
        Share of the unloaded readings that are, or, without enough of them, of all.
    warnings : tuple of str
        Contradictions of the scene and pitfalls, a line each.
    readings : Readings
        Of all frames, which allow for all this.
    factor, factor_error : float
        Of each reading's own noise against the specified one, and its standard deviation; NaN where fewer than two
        unloaded frames show nothing.
    sigma_factor : float
        Factor of σ, 1 where nothing contradicts the scene.
    frame : FrameNoise or None
        Errors that the readings of a frame share, or None.
    gain : float
        As a fraction.
    common_ripple_lsb, line_ripple_lsb : float
        rms in LSB, of the part that all scanned lines of a frame share and of that of each line; 0 where not seen.
    possible_errors : Possible or None
        What still cells leave possible of errors that all frames share, or None.
    scan_share : float
        Of its period that a scan seems to take, where loads move within it; else 0.
    of_modules : tuple of NoiseEstimate or None
        The same of each module, None of a dead one; () of a single network.
    corrected_effects : CircuitEffects or None
        The effects that are taken off the readings, or None.
    """

    outliers: NDArray[np.bool_]
    outlier_rate: float
    warnings: tuple[str, ...]
    readings: Readings
    factor: float = np.nan
    factor_error: float = np.nan
    sigma_factor: float = 1.0
    frame: FrameNoise | None = None
    gain: float = 0.0
    common_ripple_lsb: float = 0.0
    line_ripple_lsb: float = 0.0
    possible_errors: Possible | None = None
    scan_share: float = 0.0
    of_modules: tuple["NoiseEstimate | None", ...] = ()
    corrected_effects: CircuitEffects | None = None
    model_factor: float = 1.0

    @property
    def sentence(self) -> str:
        """The warnings as one."""
        return "; ".join(self.warnings)

    @property
    def corrections(self) -> str:
        """The effects that are taken off the readings, in words; ''."""
        return "" if self.corrected_effects is None else self.corrected_effects.corrections

    @property
    def reading_error(self) -> float:
        """Standard deviation of the logarithm of a factor on each reading, the same in all frames; 0 where not seen."""
        return 0.0 if self.possible_errors is None else self.possible_errors.sizes.reading_error or 0.0

    @property
    def summary(self) -> str:
        """Noise of the frames in one line, contradiction or not; '' where it is unknown."""
        if np.isnan(self.factor):
            return ""
        taken = "not rescaled" if self.sigma_factor == 1 else f"rescaled by {self.sigma_factor:.3g}"
        shared = (
            (100 * self.gain, "% gain"),
            (self.common_ripple_lsb, "LSB along a scan"),
            (self.line_ripple_lsb, "LSB of a line"),
        )
        frames = ", ".join(f"{size:.2g} {name}" for size, name in shared if size)
        messages = (
            f"scatter {self.factor:.3g} +- {self.factor_error:.1g} times as specified, {taken}",
            f"frames share {frames or 'nothing'}",
            f"{int(self.outliers.sum())} of {self.outliers.size} readings are outliers",
            "" if self.possible_errors is None else _sizes_in_words(self.possible_errors),
        )
        return "; ".join(filter(None, messages))

    def with_warnings(self, *said: str) -> "NoiseEstimate":
        """With more warnings, of which some may be ''."""
        return replace(self, warnings=(*self.warnings, *filter(None, said)))

    def with_motion(self, scene: Scene, share: float, measured: NDArray[np.intp]) -> "NoiseEstimate":
        """With wider σ where readings were taken while loads moved."""
        sigma = self.readings.sigma
        if not share or sigma is None:
            return self
        moved = share * largest_change_within_scan(scene, self.readings, measured)
        count = int(np.sum(np.sqrt(np.mean((moved / sigma) ** 2, axis=(1, 2))) > 1))
        message = (
            f"motion within a scan: as if a scan took {share:.2g} of the time between frames, in {count} frames; "
            "error bars allow for it as far as their neighbours show"
        )
        return replace(
            self, readings=replace(self.readings, sigma=np.hypot(sigma, moved)), scan_share=share
        ).with_warnings(message)


def with_still_cells(seen: NoiseEstimate, recording: Recording, sizes: Systematic) -> NoiseEstimate:
    """Return the noise with the errors that the still cells of a single network show.

    Parameters
    ----------
    seen : NoiseEstimate
    recording : Recording
        With unloaded and with measured frames.
    sizes : Systematic
        Errors that the scene names, or leaves possible.
    """
    unloaded, measured = (np.flatnonzero(recording.role == role) for role in (UNLOADED, MEASURED))
    scene, resting = recording.scene, seen.readings[unloaded].mean()
    still = seen.with_motion(scene, scan_share(scene, resting, seen.readings, measured), measured)
    strongest = strongest_frame(still.readings.plain_values, resting.value, measured)
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
    readings, frame = (
        without_effects_of(besides.pair, seen.readings, unloaded),
        replace(frame, effect_errors=remaining_errors(besides.pair)),
    )
    return replace(seen, readings=readings, frame=frame, corrected_effects=besides)


def estimate_noise(recording: Recording, outliers: NDArray[np.bool_], cleaned: Readings) -> NoiseEstimate:
    """Return the noise that the unloaded frames of a single network show."""
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
    used, specified = 1.0, readout is None or recording.sigma is not None or readout.noise_told
    squares, few = parts.own**2 * parts.own_freedom, MIN_UNLOADED_FRAMES if readout and readout.noise_lsb is None else 2
    if readout is not None and not specified:
        used = shown_factor(readout, parts.own) if unloaded >= few else 1.0
    # Noise that differs from the specified one beyond chance, and by more than changes any verdict.
    elif parts.own >= MIN_EXCESS and chi_square_tail(squares, parts.own_freedom) < SIGNIFICANCE:
        used = parts.own
    # Only of a converter it is known how small the noise may be: its step.
    elif readout is not None and recording.sigma is None and parts.own <= 1 / MIN_EXCESS:
        significant = 1 - chi_square_tail(squares, parts.own_freedom) < SIGNIFICANCE
        used = shown_factor(readout, parts.own) if significant else 1.0
    error = parts.own / np.sqrt(2 * parts.own_freedom)
    message = _noise_in_words(readout, parts.own, unloaded=unloaded > 1) if specified and used != 1 else ""
    frame, sizes = None, (0.0, 0.0)
    if readout is not None:
        volt = float(np.mean(readout.sigma_volt()))
        roots = parts.common_ripple * volt, parts.line_ripple * volt
        together, apart = (float(np.sqrt((root**2).sum() / len(root))) / readout.lsb_volt for root in roots)
        sizes = together, apart
        if parts.gain or parts.common_ripple.size or parts.line_ripple.size:
            frame = FrameNoise(recording.scene, unloaded, parts.gain, *roots)
    scaled = cleaned if used == 1 else replace(cleaned, sigma=used * cleaned.sigma)
    shared = (plain.outliers, plain.outlier_rate, plain.warnings, scaled)
    seen = NoiseEstimate(*shared, parts.own, error, used, frame, parts.gain, *sizes)
    return seen.with_warnings(message, _shared_in_words(parts.gain, *sizes))


def noise_of_modules(recording: Recording, layout: Modules, every: Sequence[NoiseEstimate | None]) -> NoiseEstimate:
    """Return the noise that the frames of all modules show; a dead module shows none."""
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
    """Return σ of the noise that a scatter of `factor` times the assumed σ shows, over the assumed σ.

    The part of σ that all codes have in common does not scatter; without any scatter σ is the converter's step.
    """
    assumed = np.mean(readout.sigma_code())
    return float(np.mean(sigma_code(readout, _shown_noise(readout, factor))) / assumed)


def _shown_noise(readout: Readout, factor: float) -> float:
    """Return the noise of one reading in LSB that a scatter of `factor` times the assumed σ shows."""
    assumed = np.mean(readout.sigma_code())
    lasting = np.mean(sigma_code(readout, readout.assumed_noise, ENDLESS))
    return noise_of_variance(readout, factor**2 * float(assumed**2 - lasting**2))


def _noise_in_words(readout: Readout | None, factor: float, *, unloaded: bool) -> str:
    """Measured noise that is used in place of the specified one."""
    where = "unloaded frames" if unloaded else "readings at rest from frame to frame"
    if readout is None:
        return f"noise {factor:.2g} times the recording's sigma, measured in {where}"
    specified = float(np.mean(readout.assumed_noise))
    return (
        f"noise {_shown_noise(readout, factor):.2g} LSB, measured in {where}; the scene specifies {specified:.3g} LSB"
    )


def change_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Δ·τ (frames, rows, columns) of the measured frames in the unit of readings; 0 for frames before them.

    Δ is half the difference of the frames before and after; the first and the last one have one neighbour.
    """
    moved = np.zeros(readings.value.shape)
    if len(measured) > 1:
        moved[measured] = np.gradient(readings.value[measured], axis=0)
    return moved * _late(scene, readings)


def largest_change_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """|τ| times the larger of a reading's steps from the frame before and to the one after, as `change_within_scan`.

    A load that has come and gone from one frame to the next but one leaves no difference between these.
    """
    step = np.zeros(readings.value.shape)
    if len(measured) > 1:
        steps = np.abs(np.diff(readings.value[measured], axis=0))
        step[measured[1:]] = steps
        step[measured[:-1]] = np.maximum(step[measured[:-1]], steps)
    return step * np.abs(_late(scene, readings))


def _late(scene: Scene, readings: Readings) -> Array:
    """τ (1, rows, columns) of each reading: how late it is taken, from the middle of its frame, in periods."""
    channels = readings.value[0].size
    late = (np.arange(channels) + 0.5) / channels - 0.5
    return in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))


def scan_share(scene: Scene, resting: Readings, readings: Readings, measured: NDArray[np.intp]) -> float:
    """Return the share s of its period that a frame's scan seems to take; 0 where nothing shows it.

    Frames with most motion that have two neighbours are tried: no cells explain their readings, but some do once s·Δ·τ
    is taken off. Where no share helps, loads move too far from frame to frame for Δ, and s is 1.
    """
    inner = measured[1:-1]
    if not len(inner) or readings.sigma is None or resting.sigma is None:
        return 0.0
    moved = change_within_scan(scene, readings, measured)
    size = np.sqrt(np.mean((moved / readings.sigma) ** 2, axis=(1, 2)))
    moving = inner[np.argsort(-size[inner])][:MAX_MOVING_FRAMES]
    if size[moving[0]] < MIN_REDUCTION:
        return 0.0
    base = fitted(scene, resting, patient=True)
    if base is None or base.tail < SIGNIFICANCE:
        return 0.0

    def left(share: float) -> tuple[list[float], float]:
        """(χ²'s tails, Σ log(1 + χ²)) of the frames' residuals once share·Δ·τ is taken off."""
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


def _shared_in_words(gain: float, together: float, apart: float) -> str:
    messages = [
        f"the gain of a frame varies by {100 * gain:.2g} %" if gain else "",
        f"the lines of a scan vary together by {together:.2g} LSB" if together else "",
        f"the readings of a scanned line vary together by {apart:.2g} LSB" if apart else "",
    ]
    return f"{', '.join(filter(None, messages))}, which error bars allow for" if any(messages) else ""


def _impossible_in_words(count: int) -> str:
    many = "reading is" if count == 1 else "readings are"
    return f"{count} {many} larger than any cells allow beside the others, and left out" if count else ""


def _outliers_in_words(seen: NoiseEstimate, outliers: NDArray[np.bool_]) -> str:
    """Return the number of outliers and their treatment in words; ''."""
    count = int(outliers.sum())
    if count == 0:
        return ""
    text = f"{count} of {outliers.size} readings are outliers of one frame, replaced by their neighbours in time"
    if seen.outlier_rate <= MAX_SHARE:  # else neighbours in time are outliers, too, and replace them badly
        return text
    rate = f"{100 * seen.outlier_rate:.2g} %"
    return f"{text}; at {rate} there are more that nobody sees, and error bars do not cover them"


def _sizes_in_words(hidden: Possible) -> str:
    """How large hidden errors are taken to be."""
    sizes, parts, row = hidden.sizes, [], 0
    bias = sizes.reading_error
    own = f"each reading off by {100 * bias:.2g} %" if bias else "no per-reading bias found"
    for name, unit, size, count in (
        ("series", "ohm", sizes.series_ohm, 1),
        ("curve", "LSB", sizes.inl_lsb, SINES),
        ("wire", "ohm a cell", sizes.wire_ohm_per_cell, 2),
    ):
        if size:
            left = 1.0 if hidden.root is None else np.sqrt((hidden.root[row : row + count] ** 2).sum() / count)
            parts.append(f"{name} {size * left:.2g} {unit}")
            row += count
    return f"{own}; left possible, as standard deviations: {', '.join(parts) or 'nothing else'}"
