"""Error of the model: residuals beyond the noise that no cells explain, as a factor on σ.

By default the evidence is of kinds that no penalty can imitate: laws of the circuit that readings
break, in the mean of the unloaded frames and under load. Where nothing is unloaded, and where a
scene says `model_error: estimated`, it is also the heavy tail of the residuals of the reference
estimate (`lampest.posterior.reference`).
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import LogGradient, Misfit, RelativeChange, Term
from lampest.files.levels import MIN_EVIDENCE_GAIN, TWO_SIDED
from lampest.inference.cells_fit import CellsFit, fitted
from lampest.inference.noise import NoiseEstimate
from lampest.inference.variance_components import MIN_EXCESS
from lampest.panel.readouts.converter import sigma_code
from lampest.panel.sizes import ESTIMATED, Systematic
from lampest.posterior.interval import LEVEL, student_two_sided
from lampest.posterior.reference import DEGREES_OF_FREEDOM, MAX_CELLS, references
from lampest.recording.readings import Readings
from lampest.recording.recording import (
    MEASURED,
    UNLOADED,
    Recording,
    baseline_readings,
    deciding_frames,
)
from lampest.solvers.posed import Bounds, cost_of_solve, data_of_solve

KEY = "systematic.model_error"
# Their largest twentieth measures the tail; with fewer, a single outlier would decide it.
MIN_READINGS = 100


def with_model_error(noise: NoiseEstimate, recording: Recording) -> NoiseEstimate:
    """Return the noise of a single network with the model's error in σ.

    The error is specified, or as the evidence shows it.
    """
    scene = recording.scene
    specified = scene.systematic.model_error if isinstance(scene.systematic, Systematic) else None
    if noise.readings.sigma is None or specified == 0:
        return noise
    if specified not in (None, ESTIMATED):
        return scaled(noise, recording, float(np.hypot(1.0, float(specified))))
    reason = "" if np.any(recording.role == MEASURED) else "record a loaded frame"
    if scene.panel.crossings > MAX_CELLS:
        reason = f"the panel has more than {MAX_CELLS} cells"
    if reason:
        return noise.undetermined(KEY, reason) if specified == ESTIMATED else noise
    factor = broken_laws(noise.readings, recording)
    if specified == ESTIMATED or not np.any(recording.role == UNLOADED):
        factor = max(factor, heavy_tails(noise.readings, recording))
    size = float(np.sqrt(max(factor**2 - 1, 0.0)))
    steps = ""
    if scene.readout is not None:
        lsb = factor * noise.sigma_factor * float(np.mean(sigma_code(scene.readout)))
        steps = f"by {lsb:.2g} LSB, "
    message = f"readings are missed {steps}{factor:.2g} times their noise: an error of the model"
    noise = scaled(noise, recording, factor).with_warnings(message if factor > 1 else "")
    if specified != ESTIMATED:
        return noise
    # by one standard deviation of the factor, so that an error of 0 has one, too
    larger = factor * (1 + 1 / np.sqrt(2 * scene.requested.sum()))
    return noise.determined(KEY, (size, float(np.sqrt(larger**2 - 1)) - size))


def broken_laws(readings: Readings, recording: Recording) -> float:
    """Return the factor on σ with which any cells explain 95 % of the readings within 1.96 σ.

    As many cells as readings follow nearly all of them, so a reading that they miss breaks a law of
    the circuit. An error of the mean of n unloaded frames counts as that of a frame, with its σ. Of
    loaded frames the median counts: a single garbled one is no error of the model; neither is one
    that a brief fit does not come near, of which the check of the circuit speaks. 1 without
    unloaded frames.
    """
    scene = recording.scene
    unloaded = recording.role == UNLOADED
    if not unloaded.any():
        return 1.0
    resting = readings[unloaded].mean()
    loaded = [readings[number] for number in deciding_frames(recording, readings, resting)]
    at_rest = _excess(fitted(scene, resting, patient=True)) / int(unloaded.sum())
    under_load = [_excess(fitted(scene, frame)) for frame in loaded]
    return float(np.sqrt(1 + max(at_rest, float(np.median(under_load or [0.0])))))


def _excess(fit: CellsFit | None) -> float:
    """Return the excess of the 95 % point of a fit's squared residuals over that of noise, in σ².

    Without a fit the excess is 0.
    """
    if fit is None:
        return 0.0
    residuals = np.abs(fit.residual)[fit.readings.seen.ravel() > 0]
    if not residuals.size:
        return 0.0
    return max((float(np.quantile(residuals, LEVEL)) / TWO_SIDED) ** 2 - 1, 0.0)


def heavy_tails(readings: Readings, recording: Recording) -> float:
    """Return the factor on σ that the residuals of loaded frames show in two models of the cells.

    With it 95 % of the residuals lie within 1.96 σ. Without strong evidence the factor is 1. An
    error of all readings shows in the scale of Student's t, an error of few readings in the tail.

    Each model mistakes unexpected cells for errors of the readings, so an error is accepted only if
    both need one. The larger size is taken: errors that stay constant from frame to frame hardly
    show in changes.
    """
    factors = list[float]()
    for solves, cost in _judges(recording, readings):
        scale = references(solves, cost)[0]
        # In −2 ln evidence, mouths at their limits gain 23 at most where nothing is wrong; static
        # errors of 7 % gain 76.
        if scale.readings < MIN_READINGS or scale.gain(1.0) < MIN_EVIDENCE_GAIN:
            return 1.0
        # The squared scale of Student's t exceeds 1 by that of the error.
        excess = np.sqrt(scale.best**2 - 1)
        widened = student_two_sided(DEGREES_OF_FREEDOM) / TWO_SIDED * excess
        factors.append(max(scale.tail / TWO_SIDED, float(np.hypot(1.0, widened))))
        if factors[-1] < MIN_EXCESS:
            return 1.0
    return max(factors, default=1.0)


def scaled(noise: NoiseEstimate, recording: Recording, factor: float) -> NoiseEstimate:
    """Return the noise with σ multiplied by the factor of the model's error.

    Averaging does not reduce it, so σ of each of n unloaded frames includes √n times the error.
    """
    sigma = noise.readings.sigma
    if sigma is None or factor == 1:
        return noise
    unloaded = recording.role == UNLOADED
    repeats = np.where(unloaded, unloaded.sum(), 1.0)[:, None, None]
    wider = sigma * np.sqrt(1 + repeats * (factor**2 - 1))
    return replace(
        noise.with_sigma(wider), model_factor=factor, sigma_factor=factor * noise.sigma_factor
    )


def _judges(recording: Recording, readings: Readings) -> Iterator[tuple[list[Data], Cost]]:
    """Generate the solves and the cost of frames under load under both descriptions of the cells.

    The second description, by changes since rest, needs unloaded frames.
    """
    scene = recording.scene
    resting = baseline_readings(recording, readings)
    frames = deciding_frames(recording, readings, resting)
    if not len(frames):
        return

    def posed(penalty: Term, background: Background) -> tuple[list[Data], Cost]:
        terms = (Misfit(weighting="noise"), penalty)
        solves = [
            data_of_solve(terms, Bounds(), readings[number].alone(), background)
            for number in frames
        ]
        similar = [data for data in solves if data.partial == solves[0].partial]
        return similar, cost_of_solve(terms, scene, partial=solves[0].partial)

    yield posed(LogGradient(weight=1.0), Background(scene))
    fit = fitted(scene, resting, patient=True) if np.any(recording.role == UNLOADED) else None
    if fit is not None:
        yield posed(
            RelativeChange(weight=1.0), Background(scene, previous=fit.cells, baseline=fit.cells)
        )
