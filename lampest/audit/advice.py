"""Verdict on a scene, and advice, from its recording.

The verdict is whether the circuit explains the recording, with all that speaks against it.

Each suggestion comes with its evidence and the entries of the scene that say so. Advice is based on
the estimates of a recording, on the health of the panel, and on a search for effects that the
scene does not name. The search is made on request, in finished readings. No estimate uses it.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from operator import attrgetter

import numpy as np

from lampest.audit.finding import Finding, advised_entries, with_addition
from lampest.audit.health import Health
from lampest.files.errors import BROKEN, InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.circuits.alternatives import changes_beyond_noise
from lampest.inference.circuits.better_alternative import MIN_RISEN, rises_only
from lampest.inference.circuits.model_check import ModelCheck
from lampest.inference.effects.effect import SceneEffect, Unnamed, estimated_entry
from lampest.inference.prepared import Prepared
from lampest.inference.resolve import ENTRIES
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import states_noise
from lampest.panel.readouts.starts import uniform_branches, unseen_scales, unseen_sentence
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED
from lampest.recording.recording import UNLOADED, Recording

# Where neither another circuit nor an effect explains the readings.
UNKNOWN = Finding(
    "circuit",
    "no known circuit or effect gives these readings",
    "",
    remedy="check the kind and the resistors of the readout, and the lines that the verdict names",
)
ZERO = "readout.converter.zero_volt"
OF_CIRCUIT = ("lines", "order")  # rooms of health whose findings contradict the scene

MAX_ZEROS = 0.1  # of the readings
WHOLE = 1e-3  # distance of a code from a whole number
# By the readings alone, of the panel that is taken, against one that reads alike.
CLEAR_LOG_ODDS = math.log(1000)


@dataclass(frozen=True, eq=False)
class Audit:
    """Audit of a recording: its verdict, health and advice.

    Attributes
    ----------
    prepared : Prepared
        Preparation of the recording, which its estimates have used.
    """

    prepared: Prepared

    @cached_property
    def health(self) -> Health:
        """Health of the panel and of the recording."""
        return Health.of(self.prepared.recording)

    @cached_property
    def verdict(self) -> ModelCheck:
        """The check of the circuit with all doubts."""
        return verdict(self.prepared.check, self.prepared, self.health)

    @cached_property
    def advice(self) -> tuple[Finding, ...]:
        """The findings that a user can act on: health, circuit, effects."""
        acted = (finding for finding in self.health.findings if finding.addition or finding.remedy)
        effects = self._effects()
        check = self.prepared.check
        circuit = list[Finding]()
        if check.better and not check.by_effect:
            circuit.append(Finding("circuit", "another circuit", check.sentence, check.addition))
        findings = (*acted, *circuit, *self._noise(effects), *effects)
        if findings or check.explains is not False:
            return findings
        return (UNKNOWN,)

    @property
    def lines(self) -> tuple[str, ...]:
        """Advice in words, ASCII, and the entries of the scene that follow from it."""
        sentences = (finding.text for finding in self.advice)
        return (*sentences, *advised_entries(self.prepared.recording.scene, self.advice))

    def _effects(self) -> tuple[Finding, ...]:
        """Return the unnamed effects.

        Under a wrong circuit effects mean nothing. If no circuit explains the readings, the first
        effect counts with which the scene's circuit does, and those that show beside it; without
        one, all that show.
        """
        check = self.prepared.check
        if check.better and not check.by_effect:
            return ()
        found = unnamed_effects(self.prepared) if check.explains is not None else ()
        if check.explains or check.by_effect:
            return found
        for finding in (*found, *effects_to_try(self.prepared.recording.scene)):
            with suppress(InputError):
                restored = named(self.prepared, finding)
                if restored.check.explains:
                    return (finding, *unnamed_effects(restored))
        return found

    def _noise(self, effects: tuple[Finding, ...]) -> Iterator[Finding]:
        """Yield the finding that noise is another one than the scene specifies beside effects."""
        scene = self.prepared.recording.scene
        if scene.readout is None or self.prepared.frame_noise.sigma_factor == 1:
            return
        prepared = self.prepared
        for finding in effects:
            with suppress(InputError):
                prepared = named(prepared, finding)
        noise = prepared.frame_noise
        if states_noise(scene.readout) and noise.sigma_factor != 1:
            evidence = (
                "readings at rest scatter "
                f"{noise.factor:.3g} +- {noise.factor_error:.1g} times as specified"
            )
            estimated = {"readout": {"noise_lsb": ESTIMATED}}
            yield Finding("noise", "the noise is another one", evidence, estimated)


def searched_effects() -> tuple[SceneEffect, ...]:
    """Return all effects in the order in which they are advised."""
    return tuple(entry.load() for entry in sorted(ENTRIES, key=attrgetter("advised")))


@lru_cache(maxsize=1)
def unnamed_effects(prepared: Prepared) -> tuple[Finding, ...]:
    """Return the effects that a recording shows and its scene does not name.

    Of several effects those are returned that show beside each other. Of modules each line is
    returned once.
    """
    if prepared.layout is None:
        return _of_network(prepared)
    findings = dict[str, Finding]()
    for number, part in enumerate(prepared.modules):
        for finding in () if part is None else _of_network(part):
            named = f"module {list(prepared.layout.place(number))}: {finding.what}"
            # a line of the scene holds for all modules
            findings.setdefault(finding.line, replace(finding, what=named))
    return tuple(findings.values())


def _of_network(prepared: Prepared) -> tuple[Finding, ...]:
    """Return the effects of a single network that show beside each other, as estimates have them.

    Each has the number that the recording determines where its scene names all of them. Effects
    that are not determined there are left out.
    """
    shown = _beside_each_other(prepared)
    while shown:
        try:
            noise = named(prepared, *shown).noise
        except InputError:
            noise = prepared.noise
        words = [effect.words(noise) for effect in shown]
        if all(words):
            both = zip(words, shown, strict=True)
            return tuple(Finding("effects", text, "", effect.addition) for text, effect in both)
        shown = tuple(effect for text, effect in zip(words, shown, strict=True) if text)
    return ()


def _beside_each_other(prepared: Prepared) -> tuple[Unnamed, ...]:
    """Return the effects of a single network that show beside each other.

    Each of several effects may be the only one, and explain what the others seem to. The first is
    the one that leaves the fewest others when the scene names it; then follow those it leaves.
    Where the scene cannot name one of them, all are returned.
    """
    if prepared.cleaned.readings.sigma is None:
        return ()
    shown = searched(prepared)
    if len(shown) < 2 or not all(effect.addition for effect in shown):
        return shown
    together = list[tuple[Unnamed, ...]]()
    for effect in shown:
        with suppress(InputError):
            together.append((effect, *_beside_each_other(named(prepared, effect))))
    return min(together, key=len, default=shown)


def named(prepared: Prepared, *effects: Finding | Unnamed) -> Prepared:
    """Return the recording, prepared anew with a scene that has the entries of effects.

    Raises InputError where the scene cannot have them.
    """
    scene = prepared.recording.scene
    for effect in effects:
        scene = with_addition(scene, effect.addition)
    return Prepared(replace(prepared.recording, scene=scene))


@ONE_BLAS_THREAD
def searched(prepared: Prepared) -> tuple[Unnamed, ...]:
    """Return the effects that the searches find in a single network's recording."""
    found = list[Unnamed]()
    for effect in searched_effects():
        try:
            with np.errstate(all="ignore"):
                found += effect.unnamed(prepared)
        except BROKEN:  # nothing is advised where arithmetic breaks down
            continue
    return tuple(found)


def effects_to_try(scene: Scene) -> tuple[Finding, ...]:
    """Return findings of errors that widen σ, which the scene does not name.

    The advice applies where readings have a misfit that nothing else explains.
    """
    keys = {key for entry in ENTRIES for key in entry.keys}
    return tuple(
        Finding(
            "effects",
            f"{effect.if_unexplained}: with that the circuit explains its readings",
            "",
            estimated_entry(effect.if_unexplained_key),
        )
        for effect in searched_effects()
        if effect.if_unexplained_key in keys and specified(scene, effect.if_unexplained_key) is None
    )


def verdict(check: ModelCheck, prepared: Prepared, health: Health | None = None) -> ModelCheck:
    """Return the check of a circuit with the doubts that errors and the panel's health give.

    Parameters
    ----------
    check : ModelCheck
    prepared : Prepared
        Preparation of the recording.
    health : Health or None
        Health of the panel, where it is known already.
    """
    scene = prepared.recording.scene
    if scene.panel.modules is None:
        scales = unseen_scales(scene.circuit, *scene.panel.shape)
        check = check.with_doubts(unseen_sentence(scales))
    return check.with_doubts(*_doubts(prepared, health)) if check.explains else check


def _doubts(prepared: Prepared, health: Health | None) -> Iterator[str]:
    """Yield the doubts: unnamed effects, errors of the model, another panel, health."""
    scene = prepared.recording.scene
    yield from (finding.what for finding in unnamed_effects(prepared))
    if prepared.noise.model_factor > 1:
        yield f"readings are missed by {prepared.noise.model_factor:.2g} times their noise"
    if specified(scene, ZERO) == ESTIMATED and ZERO not in prepared.noise.estimated:
        yield f"{ZERO} is estimated, and these frames do not determine it"
    readout = scene.readout
    if readout is not None and readout.converter is None and scene.panel.modules is None:
        yield from _fewer_bits(prepared.recording, readout)
        yield from _many_zeros(prepared, readout)
        yield from _falling_codes(prepared, readout)
    yield from _another_panel(prepared)
    try:
        shown = health or Health.of(prepared.recording)
    except InputError:
        return
    yield from (finding.what for finding in shown.findings if finding.room in OF_CIRCUIT)


def _fewer_bits(recording: Recording, readout: Readout) -> Iterator[str]:
    """Yield the doubt that codes are those of a converter with fewer bits than the scene's.

    Readings pile up at its last code then, and none is above.
    """
    volt = readout.volt_from_recorded(recording.recorded)
    codes = readout.steps_from_volt(volt[np.isfinite(volt)])
    if not codes.size or np.abs(codes - np.rint(codes)).max() > WHOLE:
        return
    largest = float(codes.max())
    for bits in (8, 10, 12):
        end = 2**bits - 1
        if bits < readout.adc_bits and largest == end and np.sum(codes == end) > 1:
            yield (
                f"readings pile up at {end:,} of {2**readout.adc_bits - 1:,}, and none is above: "
                f"does the converter have {bits} bits (adc_bits)?"
            )


def _many_zeros(prepared: Prepared, readout: Readout) -> Iterator[str]:
    """Yield the doubt that readings of 0 are those of a dead zone, not of open cells.

    The doubt arises where so many readings are 0 that no cells are fitted.
    """
    if prepared.question.explanation is not None:
        return
    codes = readout.steps_from_volt(readout.volt_from_recorded(prepared.recording.recorded))
    share = float(np.mean(codes[np.isfinite(codes)] < 0.5)) if np.isfinite(codes).any() else 0.0
    if share > MAX_ZEROS:
        yield (
            f"{100 * share:.0f} % of the readings are 0: are these cells open, or does "
            "the converter read nothing below some voltage (converter: esp32, or its zero_volt)?"
        )


def _falling_codes(prepared: Prepared, readout: Readout) -> Iterator[str]:
    """Yield the doubt that codes fall where a load presses, as behind inverting amplifiers.

    Each reading of an amplifier is that of one cell: any codes have cells that explain them.
    """
    if not hasattr(readout, "feedback_ohm"):
        return
    recording = prepared.recording
    change = changes_beyond_noise(recording.scene, prepared.cleaned.readings, recording.role)
    if (change > 0).any(axis=0).sum() >= MIN_RISEN and rises_only(change):
        yield (
            "loads raise resistances only: "
            "do codes fall behind an inverting amplifier (converter: inverting amplifier)?"
        )


def _another_panel(prepared: Prepared) -> Iterator[str]:
    """Yield the doubt that cells of quite another size give the unloaded readings, too."""
    recording = prepared.recording
    if prepared.panels is not None:
        yield prepared.panels.sentence
        return
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    chosen = unloaded if unloaded.size else np.array([0])
    resting = prepared.noise.readings[chosen].mean().value
    if not np.isfinite(resting).all():
        return
    panels = uniform_branches(recording.scene.circuit, resting)
    if len(panels) > 1 and panels[0][0] - panels[1][0] < CLEAR_LOG_ODDS:
        likely, second = (float(np.median(cells)) for _, cells in panels[:2])
        yield (
            f"cells of about {likely:.2g} ohm and of about {second:.2g} ohm give "
            "these readings alike, and the former are taken: with a smaller drive_ohm they differ"
        )
