"""Warnings about a recording, one plain line each: frames and units, noise, the circuit."""

import numpy as np

from lampest.files.applications import applications
from lampest.files.errors import first_and_more
from lampest.inference.circuits.alternatives import changes_beyond_noise
from lampest.inference.circuits.kinds import choices
from lampest.inference.circuits.model_check import ModelCheck, module_factors
from lampest.inference.noise import NoiseEstimate, named_modules
from lampest.panel.readouts.converter import states_noise
from lampest.recording.readings import Readings
from lampest.recording.recording import TOUCHED, UNEVENLY, UNLOADED, UNREFERENCED, Recording

MIN_CHANNELS = 5  # channels with less load than unloaded; fewer may be single outliers
# Steps of the converter: a reading closer to a rail is known to 6 % at best.
MIN_STEPS_FROM_RAIL = 16
MODULE_HINT = (
    "is its reference, series resistance or film another one? "
    "The scene's `modules` says what a module has of its own"
)
# Above or below the specified noise: more is a wrong unit, not a badly specified converter.
MAX_NOISE_FACTOR = 10.0


@np.errstate(all="ignore")
def warnings_of(
    recording: Recording, noise: NoiseEstimate, check: ModelCheck | None
) -> tuple[str, ...]:
    """Return the warnings of a recording, the simplest first.

    Raises InputError as `Readings.of`.

    Parameters
    ----------
    recording : Recording
    noise : NoiseEstimate
    check : ModelCheck or None
        Check of the circuit; None: it is left out, and there are no warnings about the circuit.
    """
    check = check or ModelCheck(explains=True, sentence="")
    readings = recording.readings()
    unloaded = int((recording.role == UNLOADED).sum())
    roles = UNREFERENCED if unloaded == 0 else ""
    if unloaded == 1:
        roles = "only one frame is unloaded, so that nothing shows the noise: record five or more"
    lesser_load = "" if check.better else _less_load(recording, readings)
    frames = (
        roles,
        _times(recording),
        _unit(recording, readings),
        _scatter(recording, noise),
    )
    of_readings = (*frames, *_modules(recording, readings), lesser_load)
    # An effect beside the circuit is advice, or is taken off the readings.
    circuit = "" if check.explains or check.by_effect else check.sentence
    effects = noise.corrected_effects
    corrections = "" if effects is None else effects.corrections
    # The noise's warnings have the corrections, too.
    of_noise = tuple(line for line in noise.warnings if line != corrections)
    loaded = UNEVENLY if check.loaded_at_rest and not lesser_load else ""
    touched = applications().provided("recognition", "a load while unloaded frames were taken")
    if touched is not None and touched(recording):
        loaded = f"{TOUCHED}, and changes are against their mean: name others with `lampest tare`"
    return tuple(filter(None, (*of_readings, loaded, circuit, corrections, *of_noise)))


def _times(recording: Recording) -> str:
    """Return a warning of equal times of two frames, or of times that are probably in ms; ''."""
    steps = np.diff(recording.time)
    if np.any(steps == 0):
        equal = (np.flatnonzero(steps == 0) + 1).tolist()
        named = f"{'frame' if len(equal) == 1 else 'frames'} {first_and_more(equal, 4)}"
        return (
            f"{len(equal)} of {len(recording.time)} frames have the time "
            f"of the frame before: {named}"
        )
    foreign = recording.acquisition is None and recording.simulation is None
    if not (foreign and steps.size and np.median(steps) >= 10 and np.all(recording.time % 1 == 0)):
        return ""
    return f"frames are {np.median(steps):g} s apart: are times in s?"


def _unit(recording: Recording, readings: Readings) -> str:
    """Return a warning of readings that are all near a rail, as in a wrong unit; ''."""
    circuit = recording.scene.circuit
    readout = recording.scene.readout
    recorded = recording.recorded
    if readout is None or recording.sigma is not None:
        return ""
    if readout.floor_code is not None:  # codes that were not recorded say nothing of the unit
        recorded = np.where(readings.plain, recorded, np.nan)
    # In a wrong unit all readings are near a rail; of an open film all but the loaded ones are.
    volt = circuit.volt_from_recorded(recorded)
    least, most = readout.range_volt
    steps = float(np.nanmax(np.minimum(volt - least, most - volt))) / readout.lsb_volt
    if steps >= MIN_STEPS_FROM_RAIL:
        return ""
    return (
        f"no reading, in the median {np.nanmedian(recorded):.3g} {circuit.unit}, "
        f"is more than {max(steps, 0.0):.2g} steps of the converter from a rail: "
        f"are readings in {circuit.unit}, and is the scene's readout right?"
    )


def _modules(recording: Recording, readings: Readings) -> tuple[str, ...]:
    """Return warnings of modules that are dead, without a value, or differ from the others."""
    scene = recording.scene
    layout = recording.scene.panel.modules
    if layout is None:
        return ()
    factors = module_factors(recording, layout)
    dead = scene.dead_modules
    sides = layout.split(readings.side)
    texts = dict[int, str]()
    for number, factor in factors.items():
        if number in dead:
            text = "dead, as the scene says"
        elif np.isfinite(factor):
            text = (
                f"readings at rest are {factor:.3g} times those of the other modules: {MODULE_HINT}"
            )
        elif sides[:, number].any():
            text = "every reading is at a rail of the converter, or beyond: is it connected?"
        else:
            text = "no reading is a value: is it connected?"
        texts[number] = text
    return named_modules(layout, texts)


def _scatter(recording: Recording, noise: NoiseEstimate) -> str:
    """Return a warning of noise that no converter of the scene's kind has; ''."""
    readout = recording.scene.readout
    unlikely = noise.factor > MAX_NOISE_FACTOR or noise.factor * MAX_NOISE_FACTOR < 1
    if readout is None or not (states_noise(readout) and unlikely):
        return ""
    return (
        f"readings at rest scatter {noise.factor:.2g} times as much as the scene's converter does: "
        "are units, readout.noise_lsb and readout.readings right, and is no frame a copy?"
    )


def _less_load(recording: Recording, readings: Readings) -> str:
    """Return a warning if all changes are reductions of load, otherwise ''.

    The cause is a load at rest, or a reversed circuit.
    """
    circuit = recording.scene.circuit
    change = changes_beyond_noise(recording.scene, readings, recording.role)
    if (change > 0).any(axis=0).sum() < MIN_CHANNELS or (change < 0).any():
        return ""
    message = (
        "readings only ever show less load than the unloaded frames: "
        "did something lie on the panel then"
    )
    for name, words in choices(type(circuit)).items():
        if name in ("polarity", "measured_across"):
            for word in words:
                if word != getattr(circuit, name):
                    message += f", or is it readout.{name}: {word}"
    return f"{message}?"
