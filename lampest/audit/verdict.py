"""Verdict on a scene: whether its circuit explains a recording, with all that speaks against it."""

import math
from collections.abc import Iterator

import numpy as np

from lampest.audit.effects import unnamed_effects
from lampest.audit.health import Health
from lampest.files.errors import InputError
from lampest.inference.circuits.alternatives import changes_beyond_noise
from lampest.inference.circuits.better_alternative import MIN_RISEN, rises_only
from lampest.inference.circuits.model_check import ModelCheck
from lampest.inference.prepared import Prepared
from lampest.panel.readouts import Readout
from lampest.panel.readouts.starts import uniform_branches
from lampest.panel.readouts.unseen import unseen_scales, unseen_sentence
from lampest.panel.scene import specified
from lampest.panel.sizes import ESTIMATED
from lampest.recording.recording import UNLOADED, Recording

ZERO = "readout.converter.zero_volt"
OF_CIRCUIT = ("lines", "order")  # rooms of health whose findings contradict the scene

MAX_ZEROS = 0.1  # of the readings
WHOLE = 1e-3  # distance of a code from a whole number
# By the readings alone, of the panel that is taken, against one that reads alike.
CLEAR_LOG_ODDS = math.log(1000)


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
