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
from lampest.inference.effects.effect import Gathered, SceneEffect, Unnamed
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
    """Return the effects of a single network that show beside each other.

    Each of several effects may be the only one, and explain what the others seem to. The first is
    the one that leaves the fewest others when the scene names it; then follow those it leaves.
    Where the scene cannot name one of them, all are returned.
    """
    if prepared.cleaned.readings.sigma is None:
        return ()
    findings = searched(Gathered(prepared.cleaned.recording, prepared))
    if len(findings) < 2 or not all(finding.addition for finding in findings):
        return findings
    together = list[tuple[Finding, ...]]()
    for finding in findings:
        with suppress(InputError):
            together.append((finding, *_of_network(named(prepared, finding))))
    return min(together, key=len, default=findings)


def named(prepared: Prepared, finding: Finding) -> Prepared:
    """Return the recording, prepared anew with a scene that has a finding's entries.

    Raises InputError where the scene cannot have them.
    """
    recording = prepared.recording
    return Prepared(replace(recording, scene=with_addition(recording.scene, finding.addition)))


@ONE_BLAS_THREAD
def searched(evidence: Gathered) -> tuple[Finding, ...]:
    """Return the findings of all searches in a single network's recording."""
    findings = list[Finding]()
    for effect in searched_effects():
        try:
            with np.errstate(all="ignore"):
                findings += [_finding(shown) for shown in effect.unnamed(evidence)]
        except BROKEN:  # nothing is advised where arithmetic breaks down
            continue
    return tuple(findings)


def effects_to_try(scene: Scene) -> tuple[Finding, ...]:
    """Return findings of errors that widen σ, which the scene does not name.

    The advice applies where readings have a misfit that nothing else explains.
    """
    return tuple(
        _finding(
            Unnamed.of(
                f"{effect.if_unexplained}: with that the circuit explains its readings",
                effect.if_unexplained_key,
            )
        )
        for effect in searched_effects()
        if effect.if_unexplained and specified(scene, effect.if_unexplained_key) is None
    )


def _finding(shown: Unnamed) -> Finding:
    """Return the finding of an effect."""
    return Finding("effects", shown.sentence, "", shown.addition)
