"""What a recording's own frames say of its noise, beside what the scene says, and readings that allow for it."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import LEVEL
from lampest.estimate.motion import scan_share, swept
from lampest.estimate.outliers import LEAST_FRAMES, without_outliers
from lampest.estimate.plain_warnings import plain_warnings
from lampest.estimate.scatter import LEAST_FACTOR, Scatter, unloaded_scatter
from lampest.estimate.still_cells import errors_left_possible
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.panel.systematic import SINES, Possible, usual
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.interval import chi_square_tail
from lampest.recording.calibration.repeats import ENDLESS, noise_of_variance, sigma_code
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.solvers.multistart import BROKEN

FEWEST_OPEN = 5  # unloaded frames from which on noise that a scene leaves open is taken from them
MOST_NAMED = 3  # modules of which a sentence says what their frames show
CROWDED = 0.05  # of the unloaded readings: where more are outliers, neighbours in time are, too, and replace them badly


@dataclass(frozen=True, eq=False)
class NoiseSeen:
    """What unloaded frames and neighbours in time show.

    factor, factor_error : of each reading's own noise against the specified one, and its standard deviation; NaN where
    fewer than two unloaded frames show nothing. used : by what σ is multiplied, 1 where nothing contradicts the scene.
    frame : what the readings of a frame share, or None. gain : as a fraction; together, apart : rms in LSB, of what all
    scanned lines of a frame share and of what each has anew; 0 where not seen.
    share : of its period that a scan seems to take, where loads move within it; else 0.
    outliers : (frames, rows, columns). outlier_rate : share of the unloaded readings that are, or, without enough of
    these, of all. hidden : what still cells leave possible of errors that all frames share, or None.
    sentence : what speaks against the specified noise; ''. readings : as they are to be taken, of all frames.
    of_modules : of a panel of modules, what each one's own frames show; None of a dead one.
    """

    outliers: NDArray[np.bool_]
    outlier_rate: float
    sentence: str
    readings: Readings
    factor: float = np.nan
    factor_error: float = np.nan
    used: float = 1.0
    frame: FrameNoise | None = None
    gain: float = 0.0
    together: float = 0.0
    apart: float = 0.0
    hidden: Possible | None = None
    share: float = 0.0
    of_modules: tuple["NoiseSeen | None", ...] = ()

    @property
    def reading_error(self) -> float:
        """Standard deviation of the logarithm of a factor on each reading, the same in all frames; 0 where not seen."""
        return 0.0 if self.hidden is None else self.hidden.sizes.reading_error or 0.0

    @property
    def learned(self) -> str:
        """What the frames showed, contradiction or not, in one line; '' where the noise is unknown."""
        if np.isnan(self.factor):
            return ""
        taken = "taken as assumed" if self.used == 1 else f"taken {self.used:.3g} times"
        shared = ((100 * self.gain, "% gain"), (self.together, "LSB along a scan"), (self.apart, "LSB of a line"))
        frames = ", ".join(f"{size:.2g} {name}" for size, name in shared if size)
        return _joined(
            f"sigma {self.factor:.3g} +- {self.factor_error:.1g} times as assumed and {taken}",
            f"frames share {frames or 'nothing'}",
            f"{int(self.outliers.sum())} of {self.outliers.size} readings are outliers",
            "" if self.hidden is None else _sizes_in_words(self.hidden),
        )


@lru_cache(maxsize=1)  # several estimators of one recording come one after the other
def noise_seen(recording: Recording) -> NoiseSeen:
    """Of a recording: its frames' noise, and what its still cells show. Raises InputError as `Readings.of`."""
    if recording.scene.panel.modules is not None:
        return _of_modules(recording, recording.scene.panel.modules, noise_seen.__wrapped__)
    seen, sizes, scene = frame_noise_seen(recording), usual(recording.scene), recording.scene
    with np.errstate(all="ignore"):
        seen = replace(seen, sentence=_joined(*plain_warnings(recording, seen.readings), seen.sentence))
    unloaded, measured = (np.flatnonzero(recording.role == role) for role in (UNLOADED, MEASURED))
    if not len(unloaded) or not len(measured) or sizes is None:
        return seen
    with suppress(*BROKEN), np.errstate(all="ignore"):
        resting = seen.readings[unloaded].mean()
        share = scan_share(scene, resting, seen.readings, measured)
        still = _with_motion(scene, seen, share, measured)
        strongest = strongest_frame(still.readings.plain_values, resting.value, measured)
        chosen = np.unique([strongest, measured[0] if strongest != measured[0] else measured[-1]])
        hidden = errors_left_possible(scene, sizes, resting, still.readings[chosen], seen.frame)
        own = hidden.sizes.reading_error or 0.0 if hidden is not None and hidden.sure else 0.0
        said = _reading_error_in_words(own) if own > (sizes.reading_error or 0.0) else ""
        return replace(still, hidden=hidden, sentence=_joined(still.sentence, said))
    return seen


def noise_seen_in_part(recording: Recording, known: NoiseSeen | None) -> Readings:
    """The readings of a part of a long recording, with its unloaded frames, as they are to be taken.

    known : what was found of the recording before; None: before that. Raises InputError as `Readings.of`.
    """
    layout = recording.scene.panel.modules
    if layout is not None:
        told = (None,) * layout.count if known is None else known.of_modules
        parts = [noise_seen_in_part(*pair) for pair in zip(recording.modules, told, strict=True)]
        return Readings.of_parts(layout, parts)
    seen = frame_noise_seen(recording)
    if known is not None and known.share:
        with suppress(*BROKEN), np.errstate(all="ignore"):
            seen = _with_motion(recording.scene, seen, known.share, np.flatnonzero(recording.role == MEASURED))
    return seen.readings


def frame_noise_seen(recording: Recording) -> NoiseSeen:
    """What unloaded frames and neighbours in time show, and readings that allow for it."""
    if recording.scene.panel.modules is not None:
        return _of_modules(recording, recording.scene.panel.modules, frame_noise_seen)
    readings, resting = recording.readings(), recording.role == UNLOADED
    outliers, cleaned = without_outliers(readings, resting)
    unloaded = int(resting.sum())
    counted = outliers[resting] if unloaded >= LEAST_FRAMES and readings.sigma is not None else outliers
    rate = float(counted.mean())
    plain = NoiseSeen(outliers, rate, _outliers_in_words(outliers, rate), cleaned)
    parts = unloaded_scatter(recording, cleaned[resting]) if unloaded > 1 and readings.sigma is not None else None
    if parts is None:
        return plain
    error = parts.own / np.sqrt(2 * parts.own_freedom)
    readout, frame, sizes = recording.scene.readout, None, (0.0, 0.0)
    specified = readout is None or recording.sigma is not None or readout.noise_told
    open_from = FEWEST_OPEN if readout is not None and readout.noise_lsb is None else 2
    used = _used_factor(parts)
    if readout is not None and not specified and unloaded >= open_from:
        used = _shown_factor(readout, parts.own)
    if readout is not None:
        volt = float(np.mean(readout.sigma_volt()))
        roots = parts.together * volt, parts.apart * volt
        sizes = _rms(roots[0], readout), _rms(roots[1], readout)
        if parts.gain or parts.together.size or parts.apart.size:
            frame = FrameNoise(recording.scene, unloaded, parts.gain, *roots)
    factor = (
        ""
        if used == 1 or not (specified or unloaded < open_from)
        else (
            f"unloaded frames scatter {parts.own:.2g} +- {error:.1g} times as much as the scene says, "
            "and error bars are wider by that"
        )
    )
    if used != 1 and cleaned.sigma is not None:
        cleaned = replace(cleaned, sigma=used * cleaned.sigma)
    said = _joined(plain.sentence, factor, _shared_in_words(parts.gain, *sizes))
    return NoiseSeen(outliers, rate, said, cleaned, parts.own, error, used, frame, parts.gain, *sizes)


def _of_modules(recording: Recording, layout: Modules, seen: Callable[[Recording], NoiseSeen]) -> NoiseSeen:
    """What the frames of every module show, each by itself; a dead one shows nothing."""
    dead, number_of = recording.scene.dead_modules, range(layout.count)
    every = [None if number in dead else seen(recording.modules[number]) for number in number_of]
    given = recording.readings()
    readings = [given.of_module(layout, n) if one is None else one.readings for n, one in enumerate(every)]
    nothing = np.zeros(recording.modules[0].recorded.shape, dtype=bool)
    outliers = np.stack([nothing if one is None else one.outliers for one in every], axis=-3)
    said = [f"module {list(layout.place(n))}: {one.sentence}" for n, one in enumerate(every) if one and one.sentence]
    more = f"and {len(said) - MOST_NAMED} modules more" if len(said) > MOST_NAMED else ""
    there = [one for one in every if one is not None]
    return NoiseSeen(
        layout.joined(outliers),
        float(np.mean([one.outlier_rate for one in there])),
        _joined(*said[:MOST_NAMED], more),
        Readings.of_parts(layout, readings),
        of_modules=tuple(every),
    )


def _with_motion(scene: Scene, seen: NoiseSeen, share: float, measured: NDArray[np.intp]) -> NoiseSeen:
    """With wider σ where readings were taken while loads moved."""
    sigma = seen.readings.sigma
    if not share or sigma is None:
        return seen
    moved = share * swept(scene, seen.readings, measured)
    count = int(np.sum(np.sqrt(np.mean((moved / sigma) ** 2, axis=(1, 2))) > 1))
    said = (
        f"motion within a scan: as if a scan took {share:.2g} of the time between frames, in {count} frames; "
        "error bars allow for it as far as their neighbours show"
    )
    wider = replace(seen.readings, sigma=np.hypot(sigma, moved))
    return replace(seen, readings=wider, share=share, sentence=_joined(seen.sentence, said))


def _rms(root: Array, readout: Readout) -> float:
    """Standard deviation of a channel, LSB."""
    return float(np.sqrt((root**2).sum() / len(root))) / readout.lsb_volt


def _shown_factor(readout: Readout, factor: float) -> float:
    """σ of the noise that so large a scatter shows, over the assumed one: what all codes have in common is in it.

    Where noise is smaller than a step of the converter, repeats agree, and the mean is off all the same.
    """
    assumed = np.mean(readout.sigma_code())
    lasting = np.mean(sigma_code(readout, readout.assumed_noise, ENDLESS))
    shown = noise_of_variance(readout, factor**2 * float(assumed**2 - lasting**2))
    return float(sigma_code(readout, shown) / assumed)


def _used_factor(parts: Scatter) -> float:
    """The factor, where noise is larger than specified beyond chance and by more than changes any verdict; else 1."""
    tail = chi_square_tail(parts.own**2 * parts.own_freedom, parts.own_freedom)
    return parts.own if parts.own >= LEAST_FACTOR and tail < LEVEL else 1.0


def _reading_error_in_words(size: float) -> str:
    return (
        f"cells that nobody touched seem to move as if each reading were off by {100 * size:.2g} %, the same in all "
        "frames, which error bars allow for"
    )


def _shared_in_words(gain: float, together: float, apart: float) -> str:
    """What the readings of a frame share; error bars hold it."""
    said = [
        f"the gain of a frame varies by {100 * gain:.2g} %" if gain else "",
        f"the lines of a scan vary together by {together:.2g} LSB" if together else "",
        f"the readings of a scanned line vary together by {apart:.2g} LSB" if apart else "",
    ]
    return f"{', '.join(filter(None, said))}, which error bars allow for" if any(said) else ""


def _outliers_in_words(outliers: NDArray[np.bool_], rate: float) -> str:
    """How many readings are outliers, and what became of them; ''."""
    count = int(outliers.sum())
    if count == 0:
        return ""
    text = f"{count} of {outliers.size} readings are outliers of one frame, replaced by their neighbours in time"
    if rate <= CROWDED:
        return text
    return f"{text}; at {100 * rate:.2g} % there are more that nobody sees, and error bars do not cover them"


def _sizes_in_words(hidden: Possible) -> str:
    """How large hidden errors are taken to be."""
    sizes = hidden.sizes
    own = f"each reading off by {100 * sizes.reading_error:.2g} %" if sizes.reading_error else "no reading's own error"
    parts, row = [], 0
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


def _joined(*said: str) -> str:
    """One after the other, what is empty left out."""
    return "; ".join(part for part in said if part)
