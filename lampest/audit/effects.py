"""Effects that a recording shows and its scene does not name.

Each effect comes with its evidence and the line to add. The search is made on request, in finished
readings; no estimate depends on it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.audit.finding import Finding
from lampest.files.errors import BROKEN
from lampest.files.levels import MIN_EVIDENCE_GAIN, SIGNIFICANCE
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.memory import estimated_memory, memory_gain
from lampest.inference.noise import NoiseEstimate
from lampest.inference.prepared import Prepared
from lampest.inference.resolve import specified
from lampest.inference.saturation import saturated
from lampest.inference.scan_motion import READING_ERRORS, share_of_motion
from lampest.inference.still_cells import significant_reading_error
from lampest.inference.variance_components import unloaded_scatter
from lampest.panel.scene import Scene
from lampest.panel.sizes import ESTIMATED, Systematic
from lampest.recording.readings import strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

# Of the unloaded readings that are values: with fewer, films look uneven (tests/golden/checks.py).
MIN_SHARE_READ = 0.9


@dataclass(frozen=True, eq=False)
class Gathered:
    """Finished estimates of a single network's recording, of which advice is made.

    Attributes
    ----------
    prepared : Prepared
    """

    prepared: Prepared

    @property
    def recording(self) -> Recording:
        """The recording without outliers."""
        return self.prepared.cleaned.recording

    @property
    def noise(self) -> NoiseEstimate:
        """The noise, with readings of all frames."""
        return self.prepared.noise

    @property
    def scene(self) -> Scene:
        """The scene of the recording."""
        return self.recording.scene

    @property
    def unloaded(self) -> NDArray[np.bool_]:
        """Whether a frame is unloaded, boolean (frames,)."""
        return np.asarray(self.recording.role == UNLOADED)

    @property
    def measured(self) -> NDArray[np.intp]:
        """Numbers of the measured frames."""
        return np.flatnonzero(self.recording.role == MEASURED)

    def names_none(self, *keys: str) -> bool:
        """Return whether the scene names none of these keys."""
        return all(specified(self.scene, key) is None for key in keys)


@lru_cache(maxsize=1)
def unnamed_effects(prepared: Prepared) -> tuple[Finding, ...]:
    """Return the effects that a recording shows and its scene does not name.

    Of modules each line is returned once.
    """
    if prepared.layout is None:
        if prepared.cleaned.readings.sigma is None:
            return ()
        return searched(Gathered(prepared))
    findings = dict[str, Finding]()
    for number, part in enumerate(prepared.modules):
        for finding in () if part is None else unnamed_effects(part):
            named = f"module {list(prepared.layout.place(number))}: {finding.what}"
            # a line of the scene holds for all modules
            findings.setdefault(finding.line, replace(finding, what=named))
    return tuple(findings.values())


@ONE_BLAS_THREAD
def searched(evidence: Gathered) -> tuple[Finding, ...]:
    """Return the findings of all searches in a single network's recording."""
    findings = list[Finding]()
    for search in (_saturation, _frame_errors, _besides, _memory, _reading_error, _motion):
        try:
            with np.errstate(all="ignore"):
                findings += search(evidence)
        except BROKEN:  # nothing is advised where arithmetic breaks down
            continue
    return tuple(findings)


def effects_to_try(scene: Scene) -> tuple[Finding, ...]:
    """Return findings of errors that widen σ, which the scene does not name.

    The advice applies where readings have a misfit that nothing else explains.
    """
    sentences = {
        "systematic.reading_error": "each reading may be off, the same in all frames",
        "motion": "loads may move while a frame is scanned",
    }
    return tuple(
        _finding(f"{sentence}: with that the circuit explains its readings", key, ESTIMATED)
        for key, sentence in sentences.items()
        if specified(scene, key) is None
    )


def _finding(sentence: str, key: str, value: str) -> Finding:
    """Return the finding of an effect with the entry of its dotted key."""
    addition: Any = value
    for part in reversed(key.split(".")):
        addition = {part: addition}
    return Finding("effects", sentence, "", addition)


def _saturation(evidence: Gathered) -> Iterator[Finding]:
    """Yield advice on a stage before the converter that saturates."""
    stage = saturated(evidence.recording) if evidence.names_none("readout.passes_volt") else None
    if stage is not None:
        yield _finding(stage.sentence, "readout.passes_volt", ESTIMATED)


def _frame_errors(evidence: Gathered) -> Iterator[Finding]:
    """Yield advice on gain and ripple, from the scatter of the unloaded frames."""
    scene = evidence.scene
    readings = evidence.noise.readings
    unloaded = evidence.unloaded
    unknown = scene.readout is None or readings.sigma is None or unloaded.sum() < 2
    if unknown or scene.readout is None or not evidence.names_none("gain", "ripple"):
        return
    estimating = replace(evidence.recording, scene=replace(scene, gain=ESTIMATED, ripple=ESTIMATED))
    unscaled = replace(readings, sigma=readings.known_sigma / evidence.noise.sigma_factor)
    parts = unloaded_scatter(estimating, unscaled[unloaded])
    if parts is None:
        return
    if parts.gain_tail < SIGNIFICANCE:
        yield _finding(f"the gain of a frame varies by {100 * parts.gain:.2g} %", "gain", ESTIMATED)
    roots = np.hstack([parts.common_ripple, parts.line_ripple])
    if parts.ripple_tail < SIGNIFICANCE or parts.line_ripple.size:
        size = float(np.sqrt((roots**2).sum() / len(roots)) * np.mean(scene.readout.sigma_code()))
        yield _finding(f"the lines of a scan vary together by {size:.2g} LSB", "ripple", ESTIMATED)


def _besides(evidence: Gathered) -> Iterator[Finding]:
    """Yield advice on leaks, contacts and a common change of all cells."""
    besides = evidence.prepared.effects
    if (
        besides.name
        and evidence.prepared.check.by_effect
        and evidence.names_none("leaks", "contacts")
    ):
        sentence = f"{besides.name} explains the readings better: {besides.reason}"
        yield Finding("effects", sentence, "", besides.addition)
    if besides.common_change and evidence.names_none("creep", "temperature", "film"):
        yield _finding(besides.common_change, "creep", ESTIMATED)


def _memory(evidence: Gathered) -> Iterator[Finding]:
    """Yield advice on a converter that remembers the channel before."""
    if not evidence.names_none("converter_memory"):
        return
    question = evidence.prepared.question
    if not memory_gain(question, question.explanation) > MIN_EVIDENCE_GAIN:
        return
    estimate = estimated_memory(evidence.recording)
    if not isinstance(estimate, str):
        share, deviation = estimate
        yield _finding(
            f"the converter keeps {100 * share:.2g} +- {100 * deviation:.1g} % "
            "of the channel before: so fewer cells have moved under the load",
            "converter_memory",
            ESTIMATED,
        )


def _reading_error(evidence: Gathered) -> Iterator[Finding]:
    """Yield advice on errors of each reading that stay the same in all frames."""
    scene = evidence.scene
    noise = evidence.noise
    unloaded = evidence.unloaded
    if (
        noise.readings.sigma is None
        or not unloaded.any()
        or not evidence.names_none("systematic.reading_error")
    ):
        return
    sizes = scene.systematic if isinstance(scene.systematic, Systematic) else Systematic()
    estimating = replace(scene, systematic=replace(sizes, reading_error=ESTIMATED))
    # without the error of the model: the same misses would count for it and for errors of the
    # readings
    readings = replace(noise.readings, sigma=noise.readings.sigma / noise.model_factor)
    resting = readings[unloaded].mean()
    loaded = None
    if resting.plain[scene.requested].mean() < MIN_SHARE_READ:
        return
    if len(evidence.measured):
        strongest = strongest_frame(readings.plain_values, resting.value, evidence.measured)
        loaded = readings[strongest]
    error = significant_reading_error(estimating, resting, loaded, noise.frame)
    if error is not None:
        mean, deviation = error
        yield _finding(
            f"each reading seems off by {100 * mean:.2g} +- {100 * deviation:.1g} %, "
            "the same in all frames: cells are rougher than those of films",
            "systematic.reading_error",
            ESTIMATED,
        )


def _motion(evidence: Gathered) -> Iterator[Finding]:
    """Yield advice on loads that move while a frame is scanned."""
    readings = evidence.noise.readings
    unloaded = evidence.unloaded
    if readings.sigma is None or not unloaded.any() or not evidence.names_none("motion"):
        return
    named = isinstance(specified(evidence.scene, "systematic.reading_error"), float)
    compared = (evidence.scene, readings[unloaded].mean(), readings, evidence.measured)
    share = share_of_motion(*compared, (0.0,))
    # Errors of readings explain some of what seems to be motion: they are tried where some is.
    if share is not None and share.gain > MIN_EVIDENCE_GAIN and not named:
        share = share_of_motion(*compared, READING_ERRORS)
    if share is not None and share.gain > MIN_EVIDENCE_GAIN:
        yield _finding(
            "still cells seem to move with the load; "
            f"a scan takes {share.mean:.2g} +- {share.deviation:.1g} of the time between frames",
            "motion",
            ESTIMATED,
        )
