"""Leaks between lines and bad contacts: taken off the readings where still cells show them."""

from collections.abc import Iterator
from dataclasses import replace

from lampest.files.applications import loaded
from lampest.inference.effects.effect import SceneEffect, Unnamed, names_none
from lampest.inference.noise import NoiseEstimate
from lampest.inference.nuisances import (
    Besides,
    CircuitEffects,
    remaining_errors,
    without_effects_of,
)
from lampest.inference.prepared import Prepared
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.scene import specified
from lampest.panel.sizes import ESTIMATED, LINE_EFFECTS
from lampest.recording.recording import MEASURED, UNLOADED, Recording

BESIDES: dict[str, type[LineEffect]] = {
    effect.key: loaded(effect.path) for effect in LINE_EFFECTS if effect.key
}


def without_effects(
    noise: NoiseEstimate, recording: Recording, besides: CircuitEffects | None
) -> NoiseEstimate:
    """Return the noise with the effects of leaks and contacts taken off the readings."""
    if besides is None or besides.pair is None:
        return noise
    readings = without_effects_of(besides.pair, noise.readings, recording.role == UNLOADED)
    frame = replace(noise.of_frames(recording), effect_errors=remaining_errors(besides.pair))
    return replace(noise, readings=readings, frame=frame, corrected_effects=besides)


class LeaksAndContacts(SceneEffect):
    """Leaks between lines, and resistances of contacts: `leaks`, `contacts`."""

    def resolve(
        self, noise: NoiseEstimate, recording: Recording, besides: Besides
    ) -> NoiseEstimate:
        """Take leaks and bad contacts off the readings."""
        requested = [key for key in BESIDES if specified(recording.scene, key) == ESTIMATED]
        effects = besides(tuple(BESIDES[key] for key in requested))
        noise = without_effects(noise, recording, effects)
        shown = () if effects.pair is None else effects.pair.effects
        if requested and all(effect.known for effect in shown):
            reason = "untouched cells show none"
            if not {UNLOADED, MEASURED} <= set(recording.role.tolist()):
                reason = "record unloaded frames, and a load on a few cells"
            if effects.name:
                reason = f"{effects.name}, but others explain the readings as well"
            return noise.with_warnings(
                f"{' and '.join(requested)}: estimated, and not taken off the readings: {reason}"
            )
        if not requested or effects.pair is None:
            return noise
        noise = noise.with_warnings(effects.corrections)
        pair = effects.pair
        for effect, deviation in zip(pair.effects, pair.deviations, strict=True):
            if effect.key and not effect.known:
                name = effect.named(recording.scene.panel.rows)
                noise = noise.determined(name, (effect.size, float(deviation) * effect.prior))
        return noise

    def as_the_whole(
        self, noise: NoiseEstimate, recording: Recording, whole: NoiseEstimate
    ) -> NoiseEstimate:
        """Take the leaks and contacts of the whole recording off the readings."""
        return without_effects(noise, recording, whole.corrected_effects)

    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Yield the leaks and contacts with which the circuit explains the readings better."""
        effects = prepared.effects
        if effects.name and prepared.check.by_effect and names_none(prepared, *BESIDES):

            def words(noise: NoiseEstimate) -> str:
                shown = noise.corrected_effects or effects
                return f"{shown.name} explains the readings better: {shown.reason}"

            yield Unnamed(words, effects.addition)
