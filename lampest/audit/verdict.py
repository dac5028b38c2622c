"""The verdict on a scene: whether its circuit explains a recording, with all that speaks against it."""

from collections.abc import Iterator

from lampest.audit.effects import unnamed_effects
from lampest.audit.health import Health
from lampest.estimate.model_check import ModelCheck
from lampest.estimate.prepared import Prepared
from lampest.files.errors import InputError

OF_CIRCUIT = ("lines", "order")  # rooms of health whose findings contradict the scene


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
    return check.with_doubts(*_doubts(prepared, health)) if check.explains else check


def _doubts(prepared: Prepared, health: Health | None) -> Iterator[str]:
    yield from (finding.what for finding in unnamed_effects(prepared))
    if prepared.noise.model_factor > 1:
        yield f"readings are missed by {prepared.noise.model_factor:.2g} times their noise"
    try:
        shown = health or Health.of(prepared.recording)
    except InputError:
        return
    yield from (finding.what for finding in shown.findings if finding.room in OF_CIRCUIT)
