"""Resolution of a scene: the numbers that it calls `estimated`, determined once from the recording.

Each effect is an entry of one table: its keys, and how the recording determines them. The result of
an entry has the numbers with their standard deviations, and readings with the corresponding σ.
Where the recording cannot determine a number, a warning states the reason and the frames to record,
and the prior stays.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from lampest.files.errors import BROKEN
from lampest.inference.assumptions import ASSUMED
from lampest.inference.model_error import scaled, with_model_error
from lampest.inference.noise import BROKE_DOWN, NoiseEstimate, without_effects
from lampest.panel.panel import as_panels_have
from lampest.panel.readouts.characteristic import MAX_VOLT
from lampest.panel.scene import Scene
from lampest.panel.sizes import ESTIMATED, LIMITS, Systematic, within_limits
from lampest.panel.systematic import (
    READING_ERROR,
    SHARED_ERRORS,
    Possible,
    estimated_errors,
    own_errors,
    systematic_of,
)
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

if TYPE_CHECKING:
    from lampest.inference.nuisances import CircuitEffects
    from lampest.panel.effects import Effect

# Effects beside the circuit, found when first called, of some kinds.
Effects = Callable[[tuple[type["Effect"], ...]], "CircuitEffects"]
BESIDES = ("leaks", "contacts")
PASSES = "readout.passes_volt"
ZERO = "readout.converter.zero_volt"


@dataclass(frozen=True)
class Entry:
    """An effect of a scene.

    Attributes
    ----------
    keys : tuple of str
        Keys of the scene.
    resolve : callable
        Function (noise so far, recording, effects beside the circuit) → noise with the effect.
    always : bool
        Whether an absent key is no statement, and the evidence decides.
    """

    keys: tuple[str, ...]
    resolve: Callable[[NoiseEstimate, Recording, Effects], NoiseEstimate]
    always: bool = False

    def named(self, scene: Scene) -> bool:
        """Return whether the scene names the effect."""
        return any(specified(scene, key) is not None for key in self.keys)


def specified(scene: Scene, key: str) -> Any:
    """Return the entry of a scene at a dotted key; None where it is absent."""
    entry: Any = scene
    for part in key.split("."):
        entry = None if isinstance(entry, str) else getattr(entry, part, None)
    return entry


def _besides(noise: NoiseEstimate, recording: Recording, effects: Effects) -> NoiseEstimate:
    """Take leaks and bad contacts off the readings."""
    requested = [key for key in BESIDES if specified(recording.scene, key) == ESTIMATED]
    if not requested:
        return noise
    from lampest.panel.effects import LineLeak, LooseContact

    kinds: dict[str, type[Effect]] = {"leaks": LineLeak, "contacts": LooseContact}
    besides = effects(tuple(kinds[key] for key in requested))
    pair = besides.pair
    if pair is None:
        reason = "untouched cells show none"
        if besides.name:
            reason = f"{besides.name}, but others explain the readings as well"
        return noise.with_warnings(
            f"{' and '.join(requested)}: estimated, and not taken off the readings: {reason}"
        )
    noise = without_effects(noise, recording, besides).with_warnings(besides.corrections)
    deviations = pair.explained(pair.columns(pair.effects)).sd[1:]
    for key, kind in kinds.items():
        for effect, deviation in zip(pair.effects, deviations, strict=True):
            if isinstance(effect, kind):
                name = f"{key} of {effect.where(recording.scene.panel.rows)}"
                noise = noise.determined(name, (effect.size, float(deviation) * effect.prior))
    return noise


def _motion(noise: NoiseEstimate, recording: Recording, effects: Effects) -> NoiseEstimate:
    """Interpolate the readings to the middle of their scan."""
    scene = recording.scene
    readings = noise.readings
    measured = np.flatnonzero(recording.role == MEASURED)
    share = scene.motion
    if readings.sigma is None or share is None or len(measured) < 2:
        return noise
    from lampest.inference.scan_motion import (
        READING_ERRORS,
        UNKNOWN_SHARE,
        Share,
        share_of_motion,
    )

    if share != ESTIMATED:
        number = Share(mean=float(share), deviation=0.0, reach=float(share))
        return noise.with_motion(scene, measured, number) if share else noise
    unloaded = recording.role == UNLOADED
    errors_tried = READING_ERRORS if READING_ERROR.setting in estimated_errors(scene) else (0.0,)
    size = (
        share_of_motion(scene, readings[unloaded].mean(), readings, measured, errors_tried)
        if unloaded.any()
        else None
    )
    if size is None:
        return noise.with_motion(scene, measured, UNKNOWN_SHARE).undetermined(
            "motion",
            "no frame has still cells beside a load that moves. "
            "Error bars allow for any share of the time between frames; "
            "give the share, or record five unloaded frames and a load that leaves most cells free",
        )
    noise = noise.with_motion(scene, measured, size)
    return noise.determined("motion", (size.mean, size.deviation))


def _shared(noise: NoiseEstimate, recording: Recording, effects: Effects) -> NoiseEstimate:
    """Determine the errors that all frames share."""
    scene = recording.scene
    readings = noise.readings
    requested = tuple(name for name in estimated_errors(scene) if name != "model_error")
    if not requested:
        sizes = systematic_of(scene)
        size = 0.0 if sizes is None else READING_ERROR.size(sizes)
        if sizes is None or not size:
            return noise
        possible = Possible(sizes, in_sigma=size)
        return _with_reading_error(replace(noise, possible_errors=possible), recording)
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    measured = np.flatnonzero(recording.role == MEASURED)
    if not len(unloaded):
        for name in requested:
            noise = noise.undetermined(f"systematic.{name}", "record five or more unloaded frames")
        return noise
    from lampest.inference.still_cells import shared_errors

    resting = readings[unloaded].mean()
    loaded = None
    if len(measured):
        loaded = readings[strongest_frame(readings.plain_values, resting.value, measured)]
    errors = shared_errors(scene, resting, loaded, noise.frame)
    noise = _with_reading_error(replace(noise, possible_errors=errors.possible), recording)
    for name in requested:
        if name in errors.sizes:
            noise = noise.determined(f"systematic.{name}", errors.sizes[name])
        else:
            reason = errors.undetermined or "no frame shows it; `lampest calibrate` measures it"
            noise = noise.undetermined(f"systematic.{name}", reason)
    return noise


def _with_reading_error(noise: NoiseEstimate, recording: Recording) -> NoiseEstimate:
    """Return the noise with each reading's own error in σ.

    Error bars treat the error as one that all frames share. Averaging does not reduce it, so σ of
    each of n unloaded frames includes √n times the error.
    """
    sigma = noise.readings.sigma
    size = noise.error_in_sigma
    if sigma is None or not size:
        return noise
    unloaded = recording.role == UNLOADED
    repeats = np.where(unloaded, np.sqrt(unloaded.sum()), 1.0)[:, None, None]
    # σ² ← σ² + (√n e)²: the mean of the n unloaded frames then has the whole error e
    return noise.with_sigma(
        np.hypot(sigma, repeats * own_errors(noise.readings.value, recording.scene, size))
    )


def _creep(noise: NoiseEstimate, recording: Recording, effects: Effects) -> NoiseEstimate:
    """Determine the change of all cells alike since the unloaded frames.

    The cells that no load touches determine it.
    """
    scene = recording.scene
    readings = noise.readings
    if scene.creep != ESTIMATED:
        return noise
    unloaded = recording.role == UNLOADED
    measured = np.flatnonzero(recording.role == MEASURED)
    if readings.sigma is None or not unloaded.any() or not len(measured):
        return noise.undetermined(
            "creep", "record unloaded frames, and frames whose load leaves cells free"
        )
    if scene.panel.crossings > MAX_CELLS:
        return noise.undetermined("creep", f"the panel has more than {MAX_CELLS} cells")
    from lampest.inference.cells_fit import fitted
    from lampest.inference.changed_cells import mostly_still
    from lampest.inference.fitted_pair import FittedPair

    resting = readings[unloaded].mean()
    base = fitted(scene, resting, patient=True)
    last = fitted(scene, readings[int(measured[-1])], patient=True)
    if base is None or last is None:
        return noise.undetermined("creep", "no cells explain the unloaded panel and the last frame")
    evidence = FittedPair((base, last)).evidence
    if not mostly_still(evidence.moved) or not np.isfinite(evidence.size[0]):
        return noise.undetermined(
            "creep", "the load touches most cells: record a frame with less load at the end"
        )
    return noise.determined(
        "creep",
        (
            ASSUMED.common_change * float(evidence.size[0]),
            ASSUMED.common_change * float(evidence.sd[0]),
        ),
    )


def _model(noise: NoiseEstimate, recording: Recording, effects: Effects) -> NoiseEstimate:
    """Widen σ by the model's error."""
    return with_model_error(noise, recording)


# In the order in which they are resolved: each sees the readings without the effects before it.
ENTRIES = (
    Entry(BESIDES, _besides),
    Entry(("motion",), _motion),
    Entry(tuple(f"systematic.{error.setting}" for error in SHARED_ERRORS), _shared),
    Entry(("creep",), _creep),
    Entry(("systematic.model_error",), _model, always=True),
)
# Resolved with the frames' noise.
FRAME_KEYS = ("readout.noise_lsb", PASSES, ZERO, "converter_memory", "gain", "ripple")


def with_resolved_electronics(
    noise: NoiseEstimate,
    recording: Recording,
    cleaned: Recording,
    memory: tuple[float, float] | str | None,
) -> NoiseEstimate:
    """Return the noise with the electronics that were determined before the readings were.

    The electronics are a saturated stage, and converter memory.

    Parameters
    ----------
    noise : NoiseEstimate
    recording, cleaned : Recording
        With the scene as specified, and with numbers.
    memory : (float, float), str or None
        Estimate of `converter_memory`, or why there is none; None where the scene calls for none.
    """
    if specified(recording.scene, ZERO) == ESTIMATED:
        from lampest.inference.saturation import with_converter_ends

        _, zero = with_converter_ends(recording)
        if zero is None:
            noise = noise.undetermined(
                ZERO, "no cells of the unloaded panel are open above the converter's end"
            )
        else:
            noise = noise.determined(ZERO, zero)
    if specified(recording.scene, PASSES) == ESTIMATED:
        passes = specified(cleaned.scene, PASSES)
        if passes is None:
            noise = noise.undetermined(
                PASSES, "channels of its frames end at no common voltage: load more cells"
            )
        else:
            noise = noise.determined(PASSES, passes)
    if isinstance(memory, str):
        return noise.undetermined("converter_memory", memory)
    return noise if memory is None else noise.determined("converter_memory", memory)


def resolved(
    noise: NoiseEstimate, recording: Recording, whole: NoiseEstimate | None, effects: Effects
) -> NoiseEstimate:
    """Return the noise of a single network with all effects that its scene names.

    The model's error is included.

    Parameters
    ----------
    noise : NoiseEstimate
        Noise of the frames.
    recording : Recording
        Without outliers.
    whole : NoiseEstimate or None
        For a part of a longer recording: that of the whole, whose numbers hold here, too.
    effects : callable
        Returns the effects beside the circuit, when first called.
    """
    if whole is not None:
        return _as_the_whole(noise, recording, whole)
    for entry in ENTRIES:
        if not entry.named(recording.scene) and not entry.always:
            continue
        try:
            with np.errstate(all="ignore"):
                noise = entry.resolve(noise, recording, effects)
        except BROKEN:
            for key in entry.keys:
                if specified(recording.scene, key) == ESTIMATED:
                    noise = noise.undetermined(key, BROKE_DOWN)
    return noise


def _as_the_whole(
    noise: NoiseEstimate, recording: Recording, whole: NoiseEstimate
) -> NoiseEstimate:
    """Return the noise of a part with the effects, motion and errors of the whole recording."""
    noise = without_effects(noise, recording, whole.corrected_effects)
    measured = np.flatnonzero(recording.role == MEASURED)
    if whole.motion is not None and noise.readings.sigma is not None:
        noise = noise.with_motion(recording.scene, measured, whole.motion)
    noise = replace(noise, possible_errors=whole.possible_errors, estimated=whole.estimated)
    noise = _with_reading_error(noise, recording)
    return scaled(noise, recording, whole.model_factor)


def resolved_scene(scene: Scene, noise: NoiseEstimate) -> Scene:
    """Return the scene with numbers in place of `estimated`, as far as the recording has them.

    An error that the recording cannot determine has its prior, any other effect is absent. A number
    that the scene's key does not allow is the nearest allowed one.
    """
    keys = [*chain.from_iterable(entry.keys for entry in ENTRIES), *FRAME_KEYS]
    requested = [key for key in keys if specified(scene, key) == ESTIMATED]
    if not requested:
        return scene
    estimated = {
        key: (_allowed(scene, key, number), _limited(deviation))
        for key, (number, deviation) in noise.estimated.items()
    }
    numbers = {key: size[0] for key, size in estimated.items()}
    systematic: Any = scene.systematic
    if isinstance(systematic, Systematic):
        sizes = noise.possible_errors.sizes if noise.possible_errors else systematic_of(scene)
        changes = {name: getattr(sizes, name) for name in estimated_errors(scene)}
        changes["model_error"] = numbers.get("systematic.model_error", changes.get("model_error"))
        within: dict[str, Any] = {
            name: None if changes[name] is None else _allowed(scene, name, changes[name])
            for name in estimated_errors(scene)
        }
        systematic = replace(systematic, **within)
    readout: Any = scene.readout
    if specified(scene, "readout.noise_lsb") == ESTIMATED:
        readout = replace(readout, noise_lsb=numbers.get("readout.noise_lsb"))
    if specified(scene, PASSES) == ESTIMATED:
        passes = None
        if PASSES in estimated:
            from lampest.inference.saturation import passed_range

            passes = passed_range(estimated[PASSES], readout.range_volt)
        readout = replace(readout, passes_volt=passes)
    if specified(scene, ZERO) == ESTIMATED:
        ends = readout.converter
        zero = numbers.get(ZERO, 0.0)
        full = readout.full_scale_volt + zero if ends.full_volt is None else ends.full_volt
        readout = replace(readout, converter=replace(ends, zero_volt=zero, full_volt=full))
    own: dict[str, Any] = {key: numbers.get(key) for key in requested if "." not in key}
    return replace(scene, readout=readout, systematic=systematic, estimated=estimated, **own)


def _allowed(scene: Scene, key: str, number: float) -> float:
    """Return the number nearest to a determined one that a scene may state under its key."""
    name = key.rpartition(".")[2]
    if name == "noise_lsb" and scene.readout is not None:
        return min(max(_limited(number), 0.0), 2.0**scene.readout.adc_bits)
    if key == ZERO and scene.readout is not None:
        # A zero farther off would leave less than half of the range, or a range beyond MAX_VOLT.
        full_scale = scene.readout.full_scale_volt
        most = min(full_scale / 2, MAX_VOLT - full_scale)
        return min(max(_limited(number), -most), most)
    return within_limits(name, number) if name in LIMITS else _limited(number)


def _limited(number: float) -> float:
    """Return a number within the range of physical quantities: zero or infinity beyond it."""
    return float(as_panels_have(np.asarray(number)))
