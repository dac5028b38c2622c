"""Resolution of a scene: the numbers that it calls `estimated`, determined once from the recording.

Each effect is a file of `lampest.inference.effects`, loaded where a scene names it. The result of
an effect has the numbers with their standard deviations, and readings with the corresponding σ.
Where the recording cannot determine a number, a warning states the reason and the frames to record,
and the prior stays.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from lampest.files.applications import loaded
from lampest.files.errors import BROKEN
from lampest.files.typed import Extensible
from lampest.inference.model_error import scaled, with_model_error
from lampest.inference.noise import BROKE_DOWN, NoiseEstimate, without_effects
from lampest.panel.effects import SHARED, estimated_errors, systematic_of
from lampest.panel.panel import as_panels_have
from lampest.panel.readouts.converter import MAX_VOLT
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED, LIMITS, SIZED, Systematic, within_limits
from lampest.recording.recording import Recording

if TYPE_CHECKING:
    from lampest.inference.nuisances import Besides


@dataclass(frozen=True)
class Entry:
    """An effect of a scene, by name.

    Attributes
    ----------
    keys : tuple of str
        Keys of the scene.
    path : str
        Its class, as 'module:class'.
    numbers : tuple of str
        Those of the keys whose numbers change readings or σ; numbers of the others act elsewhere.
    section : str
        Section of the scene whose further keys are of the effect, too; '' for none.
    advised : int
        Place in advice.
    """

    keys: tuple[str, ...]
    path: str
    numbers: tuple[str, ...] = ()
    section: str = ""
    advised: int = 0

    def keys_of(self, scene: Scene) -> tuple[str, ...]:
        """Return the keys, with those of the section that are no fields and a scene names."""
        named = specified(scene, self.section) if self.section else None
        added = named.own if isinstance(named, Extensible) else ()
        return (*self.keys, *(f"{self.section}.{key}" for key, _ in added))

    def acts(self, scene: Scene) -> bool:
        """Return whether the scene names the effect so that readings or σ depend on it."""
        estimated = any(specified(scene, key) == ESTIMATED for key in self.keys_of(scene))
        return estimated or any(specified(scene, key) for key in self.numbers)

    def load(self) -> Any:
        """Return the effect, a `lampest.inference.effects.effect.SceneEffect`."""
        return loaded(self.path)()


# Effects in the order in which they are resolved: each sees the readings without those before it.
# In advice errors of each reading explain most, and come last.
ENTRIES = (
    Entry(
        ("readout.passes_volt", "readout.converter.zero_volt"),
        "lampest.inference.effects.converter_ends:ConverterEnds",
        advised=0,
    ),
    Entry(
        ("converter_memory",),
        "lampest.inference.effects.converter_memory:ConverterMemory",
        advised=4,
    ),
    Entry(
        ("gain", "ripple"),
        "lampest.inference.effects.gain_and_ripple:GainAndRipple",
        advised=1,
    ),
    Entry(
        ("leaks", "contacts"),
        "lampest.inference.effects.leaks_and_contacts:LeaksAndContacts",
        advised=2,
    ),
    Entry(
        ("motion",),
        "lampest.inference.effects.motion:ScanMotion",
        ("motion",),
        advised=5,
    ),
    Entry(
        tuple(f"systematic.{setting}" for setting in SHARED),
        "lampest.inference.effects.static_errors:StaticErrors",
        ("systematic.reading_error",),
        "systematic",
        advised=6,
    ),
    Entry(("creep",), "lampest.inference.effects.creep:CommonCreep", advised=3),
)
PASSES, ZERO = ENTRIES[0].keys
MODEL_ERROR = "systematic.model_error"
OF_NOISE = "readout.noise_lsb"


def resolved(
    noise: NoiseEstimate, recording: Recording, whole: NoiseEstimate | None, effects: "Besides"
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
        if entry.acts(recording.scene):
            resolve = partial(entry.load().resolve, besides=effects)
            noise = _unless_broken(resolve, noise, recording, entry.keys_of(recording.scene))
    # Without a key evidence decides whether the model has an error.
    return _unless_broken(with_model_error, noise, recording, (MODEL_ERROR,))


def _unless_broken(
    resolve: Callable[[NoiseEstimate, Recording], NoiseEstimate],
    noise: NoiseEstimate,
    recording: Recording,
    keys: tuple[str, ...],
) -> NoiseEstimate:
    """Return the noise with an effect; where arithmetic breaks down, its keys are undetermined."""
    try:
        with np.errstate(all="ignore"):
            return resolve(noise, recording)
    except BROKEN:
        for key in keys:
            if specified(recording.scene, key) == ESTIMATED:
                noise = noise.undetermined(key, BROKE_DOWN)
        return noise


def _as_the_whole(
    noise: NoiseEstimate, recording: Recording, whole: NoiseEstimate
) -> NoiseEstimate:
    """Return the noise of a part with the effects, motion and errors of the whole recording."""
    noise = without_effects(noise, recording, whole.corrected_effects)
    if whole.motion is not None and noise.readings.sigma is not None:
        from lampest.inference.effects.motion import interpolated  # for this key alone

        noise = interpolated(noise, recording, whole.motion)
    noise = replace(noise, possible_errors=whole.possible_errors, estimated=whole.estimated)
    noise = noise.with_reading_error(recording)
    return scaled(noise, recording, whole.model_factor)


def resolved_scene(scene: Scene, noise: NoiseEstimate) -> Scene:
    """Return the scene with numbers in place of `estimated`, as far as the recording has them.

    An error that the recording cannot determine has its prior, any other effect is absent. A number
    that the scene's key does not allow is the nearest allowed one.
    """
    keys = [*chain.from_iterable(entry.keys_of(scene) for entry in ENTRIES), OF_NOISE, MODEL_ERROR]
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
        changes: dict[str, Any] = {
            name: sizes and sizes.entry(name) for name in estimated_errors(scene)
        }
        changes["model_error"] = numbers.get("systematic.model_error", changes.get("model_error"))
        within: dict[str, Any] = {
            name: None
            if changes[name] is None
            else _allowed(scene, f"systematic.{name}", changes[name])
            for name in estimated_errors(scene)
        }
        systematic = systematic.with_entries(within)
    readout: Any = scene.readout
    if specified(scene, OF_NOISE) == ESTIMATED:
        readout = replace(readout, noise_lsb=numbers.get(OF_NOISE))
    if specified(scene, PASSES) == ESTIMATED:
        passes = None
        if PASSES in estimated:
            from lampest.inference.effects.converter_ends import passed_range  # for this key alone

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
    is_size = name in LIMITS or name in SIZED or key.startswith("systematic.")
    return within_limits(name, number) if is_size else _limited(number)


def _limited(number: float) -> float:
    """Return a number within the range of physical quantities: zero or infinity beyond it."""
    return float(as_panels_have(np.asarray(number)))
