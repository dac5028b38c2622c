"""Estimation of a converter's memory, its share of the previous channel's voltage.

The estimate follows from the unloaded panel and a loaded frame. With a wrong share every cell
appears in the next channel, too, so that unloaded cells are less alike, and loads less smooth. The
evidence of both frames (`Explanation.linear_evidence`) is compared over MEMORIES, all equally
probable before, relative to the misfit of still cells.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from lampest.files.levels import DOUBTFUL_GAIN, MIN_EVIDENCE_GAIN
from lampest.inference.circuits.explanation import ComparedFrames, Explanation
from lampest.inference.circuits.parameters import MEMORIES as TRIED
from lampest.inference.circuits.parameters import may_gain_by_memory
from lampest.inference.effects.effect import Determined, SceneEffect, Unnamed, names_none
from lampest.inference.evidence import PARAMETER_COST, mostly_still
from lampest.inference.noise import NoiseEstimate
from lampest.inference.number import MIN_ODDS, parabola
from lampest.inference.prepared import Prepared
from lampest.panel.effects.converter_memory import KeptShare
from lampest.panel.panel import Array
from lampest.panel.scene import specified
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.recording import MEASURED, UNLOADED, Recording

KEY = "converter_memory"
MEMORIES = np.linspace(0.0, 0.3, 16)
FINER = 9  # points between the neighbours of the most probable one
# Of the share, where edges of loads look like a memory (docs/studies/effects.md).
EDGE_ERROR = 0.012
# With less evidence a memory that the scene calls `estimated` corrects no reading.
MIN_GAIN = PARAMETER_COST + 2 * float(np.log(MIN_ODDS))
MAX_DEVIATION = 0.05  # of the share: with more, the recording does not determine it


def estimated_memory(recording: Recording) -> tuple[float, float] | str:
    """Estimate the converter's memory of a recording.

    Returns
    -------
    (share, sd) : tuple of float, or str
        The share and its standard deviation, or a sentence that says why the recording cannot
        determine it.
    """
    unloaded = recording.role == UNLOADED
    if recording.scene.readout is None:
        return "the scene has no readout"
    if not unloaded.any() or not np.any(recording.role == MEASURED):
        return "record unloaded frames, and a load on a few cells"
    if specified(recording.scene, "motion"):
        return "a load that moves within a scan looks like a memory: record one that stands"
    if recording.scene.panel.crossings > MAX_CELLS:
        return f"the panel has more than {MAX_CELLS} cells: estimate it on a part of it"
    plain = replace(recording, scene=replace(recording.scene, converter_memory=None))
    frames = ComparedFrames.of(plain, np.zeros(recording.recorded.shape, dtype=bool))
    tried = _explanations(frames, MEMORIES)
    if tried[0] is not None and tried[0].pair is not None and not tried[0].pair.has_load:
        return "no frame is loaded: press a few cells"
    best = float(MEMORIES[np.argmin([_cost(explanation) for explanation in tried])])
    step = float(MEMORIES[1])
    shares = np.linspace(max(best - step, 0.0), max(best, step) + step, FINER)
    explanations = _explanations(frames, shares)
    costs = np.array([_cost(explanation) for explanation in explanations])
    nearest = explanations[int(np.argmin(costs))]
    if not np.isfinite(costs).all() or nearest is None or nearest.pair is None:
        return "no cells explain the unloaded panel and a loaded frame"
    excess = nearest.pair.excess
    least, deviation = parabola(shares, costs / excess)
    known = float(np.hypot(deviation, EDGE_ERROR))
    shown = _cost(tried[0]) - costs.min() > MIN_GAIN * excess
    error = known if shown else float(np.hypot(least, known))
    if error > MAX_DEVIATION or least > MEMORIES[-1]:
        return "the load changes all channels alike: press a few cells"
    return max(least, 0.0) if shown else 0.0, error


def memory_gain(frames: ComparedFrames, without: Explanation | None) -> float:
    """Return the decrease of −2 ln evidence by the best of the memories TRIED against none.

    The decrease is relative to the misfit of still cells, which errors that the scene does not name
    increase. Larger memories are tried while one is no worse than the best by DOUBTFUL_GAIN.

    Parameters
    ----------
    frames : ComparedFrames
        Of a recording whose scene names no memory.
    without : Explanation or None
        Explanation of these frames without a memory.
    """
    if frames.specified.scene.readout is None or without is None or without.pair is None:
        return 0.0
    # Cells without a load creep less than is assumed, and cells that answer more gain by that.
    if not without.pair.has_load:
        return 0.0
    # Only where noise does not give the misfit without a memory, it counts with one. Under a wrong
    # circuit that takes long. Linear theory promises nothing there, and nothing from still cells.
    patient = not all(fit.within_noise for fit in without.fits)
    linear = patient or mostly_still(without.pair.moved)
    if linear and not may_gain_by_memory(without, frames):
        return 0.0
    best = without
    for share in TRIED:
        (further,) = _explanations(frames, np.array([share]), best, patient=patient)
        if further is None or _cost(further) > _cost(best) + DOUBTFUL_GAIN:
            break
        best = min(best, further, key=_cost)
    assert best.pair is not None
    return (_cost(without) - _cost(best)) / best.pair.excess


def _explanations(
    frames: ComparedFrames,
    shares: Array,
    near: Explanation | None = None,
    *,
    patient: bool = True,
) -> list[Explanation | None]:
    """Return the explanations of frames with each share; None without a fit.

    Each fit begins at the cells of the share before, the first at those of `near`; `patient` as in
    `fits_of`.
    """
    explanations = list[Explanation | None]()
    with np.errstate(all="ignore"):
        for share in shares.tolist():
            alternative = frames.specified.with_memory(share)
            explanation = Explanation.of(alternative, frames, near, patient=patient)
            near = explanation or near
            # Channels and moved cells are of this share, not of the one before.
            explanations.append(explanation and explanation.final)
    return explanations


def _cost(explanation: Explanation | None) -> float:
    """Return −2 ln density of the frames; infinite without an explanation."""
    if explanation is None or explanation.pair is None:
        return np.inf
    # p(recorded) = p(freed) |∂freed/∂recorded|. The evidence has the readings relative to their σ,
    # which is √(1 + m²) |∂freed/∂recorded| times that of the recorded ones.
    count = sum(int(np.sum(fit.readings.seen > 0)) for fit in explanation.fits)
    memory = explanation.alternative.scene.known_memory or 0.0
    return explanation.linear_evidence + count * float(np.log1p(memory**2))


class ConverterMemory(SceneEffect):
    """A converter that keeps a share of the channel before: `converter_memory`.

    The share is determined before any reading is taken, because readings are freed of it.
    """

    def freed(self, recording: Recording) -> tuple[Recording, Mapping[str, Determined]]:
        """Return the recording with the share in its scene, or with none."""
        estimate = estimated_memory(recording)
        share = None if isinstance(estimate, str) else estimate[0]
        scene = replace(recording.scene, converter_memory=share)
        return replace(recording, scene=scene), {KEY: estimate}

    def noted(
        self, noise: NoiseEstimate, recording: Recording, estimates: Mapping[str, Determined]
    ) -> NoiseEstimate:
        """Return the noise with the share, whose standard deviation error bars carry.

        Where nothing determines the share, the deviation is its prior.
        """
        noise = super().noted(noise, recording, estimates)
        memory = estimates[KEY]
        deviation = KeptShare.prior if isinstance(memory, str) else memory[1]
        if recording.scene.readout is None or not deviation:
            return noise
        return replace(noise, frame=replace(noise.of_frames(recording), memory=deviation))

    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Yield advice on a converter that remembers the channel before."""
        if not names_none(prepared, "converter_memory"):
            return
        question = prepared.question
        if memory_gain(question, question.explanation) > MIN_EVIDENCE_GAIN:
            yield Unnamed.of(KeptShare().sentence, KEY)
