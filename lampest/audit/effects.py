"""Effects that a recording shows and its scene does not name.

Each effect comes with its evidence and the entries to add. The search is made on request, in
finished readings; no estimate depends on it.
"""

from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from operator import attrgetter

import numpy as np

from lampest.audit.finding import Finding, with_addition
from lampest.files.errors import BROKEN, InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.effects.effect import SceneEffect, Unnamed, estimated_entry
from lampest.inference.prepared import Prepared
from lampest.inference.resolve import ENTRIES
from lampest.panel.scene import Scene, specified


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
