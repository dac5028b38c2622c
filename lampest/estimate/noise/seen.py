"""What a recording's own frames say of its noise, beside what the scene says, and readings that allow for it."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.noise.motion import said_of_motion, scan_share, swept
from lampest.estimate.noise.outliers import LEAST_FRAMES, SHARE, leaps, pair_scale
from lampest.estimate.noise.scatter import Scatter, scatter
from lampest.estimate.noise.unseen import said_of_readings, unseen
from lampest.estimate.noise.words import joined, said_of_factor, said_of_frames, said_of_outliers, said_of_sizes
from lampest.panel.hidden import Possible, usual
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.interval import chi_square_tail
from lampest.recording.calibration.repeats import ENDLESS, noise_of_variance, sigma_code
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.solvers.starts import BROKEN

FEWEST_OPEN = 5  # unloaded frames from which on noise that a scene does not tell is taken from them
LEVEL = 1e-4  # of the test of the told noise, as in the check of the circuit
LEAST_FACTOR = 1.25  # of the noise: a smaller excess changes no verdict, as in the check of the circuit


@dataclass(frozen=True, eq=False)
class NoiseSeen:
    """What unloaded frames and neighbours in time show.

    factor, factor_error : of each reading's own noise against the told one, and its standard deviation; NaN where
    fewer than two unloaded frames tell nothing. used : by what σ is multiplied, 1 where
    nothing contradicts the told one.
    frame : what the readings of a frame share, or None. gain : as a fraction; together, apart : rms in LSB, of what all
    scanned lines of a frame share and of what each has anew; 0 where not seen.
    share : of its period that a scan seems to take, where frames are torn; else 0.
    outliers : (frames, rows, columns) that leap; outlier_rate : share of the unloaded readings that do, or, without
    enough of these, of all. hidden : what still cells leave possible of errors that all frames share, or None.
    sentence : what speaks against the told noise; ''. readings : as they are to be taken, of all frames.
    """

    factor: float
    factor_error: float
    used: float
    frame: FrameNoise | None
    gain: float
    together: float
    apart: float
    outliers: NDArray[np.bool_]
    outlier_rate: float
    sentence: str
    readings: Readings
    hidden: Possible | None = None
    share: float = 0.0

    @property
    def reading_error(self) -> float:
        """Standard deviation of the logarithm of a factor on each reading, the same in all frames; 0 where not seen."""
        return 0.0 if self.hidden is None else self.hidden.sizes.reading_error or 0.0

    @property
    def learned(self) -> str:
        """What the frames told, contradiction or not, in one line; '' where the noise is unknown."""
        if np.isnan(self.factor):
            return ""
        taken = "taken as assumed" if self.used == 1 else f"taken {self.used:.3g} times"
        shown = [f"sigma {self.factor:.3g} +- {self.factor_error:.1g} times as assumed and {taken}"]
        shared = ((100 * self.gain, "% gain"), (self.together, "LSB along a scan"), (self.apart, "LSB of a line"))
        frames = ", ".join(f"{size:.2g} {name}" for size, name in shared if size)
        shown.append(f"frames share {frames or 'nothing'}")
        shown.append(f"{int(self.outliers.sum())} of {self.outliers.size} readings leap")
        return joined(shown + said_of_sizes(self.hidden))


@lru_cache(maxsize=1)  # several estimators of one recording come one after the other
def noise_seen(recording: Recording) -> NoiseSeen:
    """Of a recording: its frames' noise, and what its still cells tell. Raises InputError as `Readings.of`."""
    seen = frame_noise_seen(recording)
    unloaded, measured = (np.flatnonzero(recording.role == role) for role in (UNLOADED, MEASURED))
    if not len(unloaded) or not len(measured):
        return seen
    if usual(recording.scene) is None:
        return seen
    with suppress(*BROKEN), np.errstate(all="ignore"):
        return with_still_cells(recording, seen, unloaded, measured)
    return seen


def with_still_cells(
    recording: Recording, seen: NoiseSeen, unloaded: NDArray[np.intp], measured: NDArray[np.intp]
) -> NoiseSeen:
    """With what still cells tell of torn frames, and of errors that all frames share. Raises what arithmetic does."""
    scene, sizes = recording.scene, usual(recording.scene)
    assert sizes is not None
    resting = seen.readings[unloaded].mean()
    share = scan_share(scene, sizes, resting, seen.readings, measured, seen.frame)
    seen = with_torn_frames(scene, seen, share, measured)
    strongest = strongest_frame(seen.readings.plain_values, resting.value, measured)
    asked = np.unique([strongest, measured[0] if strongest != measured[0] else measured[-1]])
    hidden = unseen(scene, sizes, resting, seen.readings[asked], seen.frame)
    own = hidden.sizes.reading_error or 0.0 if hidden is not None and hidden.sure else 0.0
    said = said_of_readings(own, sizes.reading_error or 0.0)
    return replace(seen, hidden=hidden, sentence=joined([seen.sentence, said]))


def with_torn_frames(scene: Scene, seen: NoiseSeen, share: float, measured: NDArray[np.intp]) -> NoiseSeen:
    """With wider σ where readings were taken while loads moved."""
    if not share or seen.readings.sigma is None:
        return seen
    torn = share * swept(scene, seen.readings, measured)
    wider = replace(seen.readings, sigma=np.hypot(seen.readings.sigma, torn))
    said = said_of_motion(share, torn, seen.readings.sigma)
    return replace(seen, readings=wider, share=share, sentence=joined([seen.sentence, said]))


def noise_seen_in_part(recording: Recording, known: NoiseSeen | None) -> Readings:
    """The readings of a part of a long recording, with its unloaded frames, as they are to be taken.

    known : what was asked of the recording before; None: before that. Raises InputError as `Readings.of`.
    """
    seen = frame_noise_seen(recording)
    if known is None or not known.share:
        return seen.readings
    with suppress(*BROKEN), np.errstate(all="ignore"):
        return with_torn_frames(recording.scene, seen, known.share, np.flatnonzero(recording.role == MEASURED)).readings
    return seen.readings


def frame_noise_seen(recording: Recording) -> NoiseSeen:
    """What unloaded frames and neighbours in time tell, and readings that allow for it."""
    readings = recording.readings()
    unloaded = recording.role == UNLOADED
    outliers, cleaned = without_leaps(readings, unloaded)
    if readings.sigma is None:
        rate = float(outliers.mean())
        return NoiseSeen(
            np.nan, np.nan, 1.0, None, 0.0, 0.0, 0.0, outliers, rate, said_of_outliers(outliers, rate), cleaned
        )
    parts = unloaded_scatter(recording, cleaned[unloaded]) if unloaded.sum() > 1 else None
    rate = float(outliers[unloaded].mean() if unloaded.sum() >= LEAST_FRAMES else outliers.mean())
    return _summed_up(recording, cleaned, outliers, rate, parts, int(unloaded.sum()))


def _summed_up(
    recording: Recording,
    cleaned: Readings,
    outliers: NDArray[np.bool_],
    rate: float,
    parts: Scatter | None,
    unloaded: int,
) -> NoiseSeen:
    said = [said_of_outliers(outliers, rate)]
    if parts is None:
        return NoiseSeen(np.nan, np.nan, 1.0, None, 0.0, 0.0, 0.0, outliers, rate, joined(said), cleaned)
    error = parts.own / np.sqrt(2 * parts.own_freedom)
    readout, frame, sizes = recording.scene.readout, None, (0.0, 0.0)
    told = readout is None or recording.sigma is not None or readout.noise_told
    open_to = FEWEST_OPEN if readout is not None and readout.noise_lsb is None else 2
    used = used_factor(parts)
    if readout is not None and not told and unloaded >= open_to:
        used = shown_factor(readout, parts.own)
    if readout is not None:
        volt = float(np.mean(readout.sigma_volt()))
        roots = parts.together * volt, parts.apart * volt
        sizes = _rms(roots[0], readout), _rms(roots[1], readout)
        if parts.gain or parts.together.size or parts.apart.size:
            frame = FrameNoise(recording.scene, unloaded, parts.gain, *roots)
    said += [
        said_of_factor(parts.own, error, used) if told or unloaded < open_to else "",
        *said_of_frames(parts.gain, *sizes),
    ]
    if used != 1 and cleaned.sigma is not None:
        cleaned = replace(cleaned, sigma=used * cleaned.sigma)
    return NoiseSeen(parts.own, error, used, frame, parts.gain, *sizes, outliers, rate, joined(said), cleaned)


def _rms(root: Array, readout: Readout) -> float:
    """Standard deviation of a channel, LSB."""
    return float(np.sqrt((root**2).sum() / len(root))) / readout.lsb_volt


def without_leaps(readings: Readings, unloaded: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Readings]:
    """(readings that leap, the readings without them): unloaded ones say nothing, others stand at their neighbours'.

    Both kinds of frames are looked at apart, because between them a load comes. Of bounds nothing is said.
    """
    value = readings.plain_values
    told = np.ones(value.shape) if readings.sigma is None else readings.sigma
    wild, instead, spread = np.zeros(value.shape, dtype=bool), value.copy(), np.zeros(value.shape)
    # What is told may be wrong, and frames may differ together: what most readings do from frame to frame is noise.
    seen = [pair_scale(value[chosen] / told[chosen]) for chosen in (unloaded, ~unloaded)]
    scale = told * np.fmax(seen[0] if unloaded.sum() >= LEAST_FRAMES else seen[1], float(readings.sigma is not None))
    most = 1.0
    for chosen in (unloaded, ~unloaded):
        if chosen.sum() >= LEAST_FRAMES:
            found = leaps(value[chosen], scale[chosen], most)
            wild[chosen], instead[chosen], spread[chosen] = found.leaping, found.instead, found.spread
            most = 2 * float(found.leaping.mean())
        most = max(SHARE, most if chosen.sum() >= LEAST_FRAMES else 0.0)
    if not wild.any():
        return wild, readings
    resting, moving = wild & unloaded[:, None, None], wild & ~unloaded[:, None, None]
    sigma = None if readings.sigma is None else np.where(moving, np.hypot(readings.sigma, spread), readings.sigma)
    seen_now = np.where(resting, 0.0, readings.seen)
    return wild, replace(readings, value=np.where(moving, instead, readings.value), sigma=sigma, seen=seen_now)


def unloaded_scatter(recording: Recording, resting: Readings) -> Scatter | None:
    """The parts of the unloaded frames' scatter; None where no reading is a value in two of them.

    Without a converter there is nothing that a frame's readings could share but what they are themselves.
    """
    assert resting.sigma is not None
    circuit, scene = recording.scene.circuit, recording.scene
    value = resting.plain_values
    count = np.sum(~np.isnan(value), axis=0)
    value = np.where(count > 1, value, np.nan)
    if np.isnan(value).all():
        return None
    total = np.nan_to_num(value).sum(axis=0)
    middle = np.where(count > 1, total / np.maximum(count, 1), resting.value[0])
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


def shown_factor(readout: Readout, factor: float) -> float:
    """σ of the noise that so large a scatter tells, over the assumed one: what all codes have in common is in it.

    Where noise is smaller than a step of the converter, repeats agree, and the mean is off all the same.
    """
    assumed = np.mean(readout.sigma_code())
    lasting = np.mean(sigma_code(readout, readout.assumed_noise, ENDLESS))
    shown = noise_of_variance(readout, factor**2 * float(assumed**2 - lasting**2))
    return float(sigma_code(readout, shown) / assumed)


def used_factor(parts: Scatter) -> float:
    """The factor, where noise is larger than told beyond chance and by more than changes any verdict; else 1."""
    tail = chi_square_tail(parts.own**2 * parts.own_freedom, parts.own_freedom)
    return parts.own if parts.own >= LEAST_FACTOR and tail < LEVEL else 1.0
