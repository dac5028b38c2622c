"""Resolution of a scene: the numbers that it calls `estimated`, determined once from the recording.

Each effect is a file of `lampest.inference.effects`, loaded where a scene names it. The result of
an effect has the numbers with their standard deviations, and readings with the corresponding σ.
Where the recording cannot determine a number, a warning states the reason and the frames to record,
and the prior stays.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lampest.files.applications import loaded
from lampest.files.errors import BROKEN
from lampest.files.typed import Extensible
from lampest.inference.model_error import scaled, with_model_error
from lampest.inference.noise import BROKE_DOWN, NoiseEstimate
from lampest.panel.effects import SHARED
from lampest.panel.panel import as_panels_have
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED, LINE_EFFECTS, SIZED, nearest_allowed
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
    before_readings : bool
        Whether the effect acts on recorded values, so that it is determined before any reading is
        taken from them.
    of_frames : bool
        Whether the readings of a frame share the effect, so that it is determined with their noise.
    """

    keys: tuple[str, ...]
    path: str
    numbers: tuple[str, ...] = ()
    section: str = ""
    advised: int = 0
    before_readings: bool = False
    of_frames: bool = False

    def keys_of(self, scene: Scene) -> tuple[str, ...]:
        """Return the keys, with those of the section that are no fields and a scene names."""
        named = specified(scene, self.section) if self.section else None
        added = named.own if isinstance(named, Extensible) else ()
        return tuple(dict.fromkeys((*self.keys, *(f"{self.section}.{key}" for key, _ in added))))

    def acts(self, scene: Scene) -> bool:
        """Return whether the scene names the effect so that readings or σ depend on it."""
        return bool(self.requested(scene)) or any(specified(scene, key) for key in self.numbers)

    def requested(self, scene: Scene) -> tuple[str, ...]:
        """Return the keys under which a scene says `estimated`."""
        return tuple(key for key in self.keys_of(scene) if specified(scene, key) == ESTIMATED)

    def load(self) -> Any:
        """Return the effect, a `SceneEffect`."""
        return loaded(self.path)()


def _with_files(*keys: str) -> tuple[str, ...]:
    """Return the keys of effects whose files are there."""
    return tuple(key for key in keys if key in SIZED)


# Effects in the order in which they are resolved: each sees the readings without those before it.
# In advice errors of each reading explain most, and come last. An effect without a file has no key.
_LISTED = (
    Entry(
        ("readout.passes_volt", "readout.converter.zero_volt"),
        "lampest.inference.effects.converter_ends:ConverterEnds",
        advised=0,
        before_readings=True,
    ),
    Entry(
        _with_files("converter_memory"),
        "lampest.inference.effects.converter_memory:ConverterMemory",
        advised=4,
        before_readings=True,
    ),
    Entry(
        _with_files("gain", "ripple"),
        "lampest.inference.effects.gain_and_ripple:GainAndRipple",
        advised=1,
        of_frames=True,
    ),
    Entry(
        tuple(effect.key for effect in LINE_EFFECTS if effect.key),
        "lampest.inference.effects.leaks_and_contacts:LeaksAndContacts",
        tuple(effect.key for effect in LINE_EFFECTS if effect.at_converter),
        advised=2,
    ),
    Entry(
        _with_files("motion"),
        "lampest.inference.effects.motion:ScanMotion",
        _with_files("motion"),
        advised=5,
    ),
    Entry(
        tuple(f"systematic.{setting}" for setting in SHARED),
        "lampest.inference.effects.static_errors:StaticErrors",
        ("systematic.reading_error",),
        "systematic",
        advised=6,
    ),
    Entry(_with_files("creep"), "lampest.inference.effects.creep:CommonCreep", advised=3),
)
ENTRIES = tuple(entry for entry in _LISTED if entry.keys)
# Why a recording determines nothing whose readings never change.
UNCHANGED = (
    "every reading has one value in all frames: record unloaded frames, and press a few cells"
)
MODEL_ERROR = "systematic.model_error"
OF_NOISE = "readout.noise_lsb"


class Freed(NamedTuple):
    """A recording without the effects that act before readings are taken.

    Attributes
    ----------
    recording : Recording
        Its scene has numbers in place of `estimated`.
    estimates : tuple of (SceneEffect, mapping)
        What each of the effects determined, as `SceneEffect.freed` returns it.
    """

    recording: Recording
    estimates: tuple[tuple[Any, Mapping[str, Any]], ...] = ()

    def noted(self, noise: NoiseEstimate, recording: Recording) -> NoiseEstimate:
        """Return the noise of the cleaned recording with the numbers of these effects."""
        for effect, estimates in self.estimates:
            noise = effect.noted(noise, recording, estimates)
        return noise


def freed(recording: Recording) -> Freed:
    """Return a single network's recording without effects that act before readings are taken."""
    result = Freed(recording)
    for entry in ENTRIES:
        if entry.before_readings and entry.requested(recording.scene):
            effect = entry.load()
            without, estimates = effect.freed(result.recording)
            result = Freed(without, (*result.estimates, (effect, estimates)))
    return result


def effects_of_frames(scene: Scene) -> tuple[Any, ...]:
    """Return the effects that a scene names and the readings of a frame share."""
    return tuple(
        entry.load()
        for entry in ENTRIES
        if entry.of_frames and any(specified(scene, key) is not None for key in entry.keys)
    )


def keys_in_sigma(scene: Scene) -> set[str]:
    """Return the keys of errors that may widen σ of the readings."""
    entries = (entry for entry in ENTRIES if entry.numbers)
    return {MODEL_ERROR, *chain.from_iterable(entry.keys_of(scene) for entry in entries)}


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
    if never_changes(recording):
        after = (entry for entry in ENTRIES if not (entry.before_readings or entry.of_frames))
        for key in chain.from_iterable(entry.requested(recording.scene) for entry in after):
            noise = noise.undetermined(key, UNCHANGED)
        if specified(recording.scene, MODEL_ERROR) == ESTIMATED:
            noise = noise.undetermined(MODEL_ERROR, UNCHANGED)
        return noise
    for entry in ENTRIES:
        if entry.acts(recording.scene):
            resolve = partial(entry.load().resolve, besides=effects)
            noise = _unless_broken(resolve, noise, recording, entry.keys_of(recording.scene))
    # Without a key evidence decides whether the model has an error.
    return _unless_broken(with_model_error, noise, recording, (MODEL_ERROR,))


def never_changes(recording: Recording) -> bool:
    """Return whether every reading has the same value in two or more frames."""
    values = recording.recorded
    return len(values) > 1 and bool(np.all((values == values[0]) | np.isnan(values)))


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
    for entry in ENTRIES:
        if entry.acts(recording.scene):
            noise = entry.load().as_the_whole(noise, recording, whole)
    noise = replace(noise, estimated=whole.estimated)
    if whole.possible_errors is not None:
        noise = noise.with_errors(whole.possible_errors, recording.scene)
    return scaled(noise, recording, whole.model_factor)


def resolved_scene(scene: Scene, noise: NoiseEstimate) -> Scene:
    """Return the scene with numbers in place of `estimated`, as far as the recording has them.

    An error that the recording cannot determine has its prior, any other effect is absent. A number
    that the scene's key does not allow is the nearest allowed one.
    """
    requested = [(entry, entry.requested(scene)) for entry in ENTRIES]
    of_effects = {key: entry.load() for entry, keys in requested for key in keys}
    others = [key for key in (OF_NOISE, MODEL_ERROR) if specified(scene, key) == ESTIMATED]
    if not of_effects and not others:
        return scene
    estimated = dict[str, tuple[float, float]]()
    for key, (number, deviation) in noise.estimated.items():
        if key in of_effects:
            number = of_effects[key].allowed(scene, key, number)
        elif key == OF_NOISE and scene.readout is not None:
            number = min(max(nearest_allowed(key, number), 0.0), 2.0**scene.readout.adc_bits)
        else:
            number = nearest_allowed(key, number)
        estimated[key] = number, float(as_panels_have(np.asarray(deviation)))
    noise = replace(noise, estimated=estimated)
    for entry, keys in requested:
        if keys:
            scene = entry.load().stated(scene, keys, noise)
    for key in others:
        part, _, name = key.partition(".")
        stated = {part: replace(getattr(scene, part), **{name: noise.number(key)})}
        scene = replace(scene, **stated)
    return replace(scene, estimated=estimated)
