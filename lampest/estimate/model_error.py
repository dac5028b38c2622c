"""Error of the model: the excess of the residuals over the noise that no cells explain.

The reference estimate (`lampest.posterior.reference`) measures it on frames under load. Where the evidence for it is
strong under every description of the cells, it enters the σ of the readings, and so weights, bounds and error bars.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import LogGradient, Misfit, RelativeChange, Term
from lampest.estimate.cells_fit import fitted
from lampest.estimate.deciding import baseline_readings, deciding_frames
from lampest.estimate.estimator import Estimator
from lampest.estimate.noise import MIN_EXCESS, NoiseEstimate
from lampest.estimate.nuisances import MIN_EVIDENCE_GAIN
from lampest.files.errors import BROKEN
from lampest.files.levels import TWO_SIDED
from lampest.panel.scene import Scene
from lampest.panel.systematic import own_errors
from lampest.posterior.interval import student_two_sided
from lampest.posterior.reference import MAX_CELLS, MODEL, ErrorScale, references
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording

MIN_READINGS = 100  # their largest twentieth measures the tail; with fewer, a single outlier would decide it


def error_factor(scale: ErrorScale) -> float:
    """Return the factor on σ with which 95 % of the residuals lie within 1.96 σ; 1 without strong evidence.

    An error of all readings shows in the scale of Student's t, an error of few readings in the tail.
    """
    # In −2 ln evidence, mouths at their limits gain 23 at most where nothing is wrong; static errors of 7 % gain 76.
    if scale.readings < MIN_READINGS or scale.gain(1.0) < MIN_EVIDENCE_GAIN:
        return 1.0
    # tail: empirical 95 % point; whole: that of Student's t, whose squared scale exceeds 1 by that of the error
    tail = scale.tail / TWO_SIDED
    widened = student_two_sided(MODEL.degrees_of_freedom) / TWO_SIDED * np.sqrt(scale.best**2 - 1)
    factor = max(tail, float(np.hypot(1.0, widened)))
    return factor if factor >= MIN_EXCESS else 1.0


def with_model_error(noise: NoiseEstimate, recording: Recording) -> NoiseEstimate:
    """Return the noise of a single network, including the model's error where readings under load show one.

    If still cells determine each reading's own error, that is the model's error. Otherwise the cells are described in
    two ways, by differences between neighbours and by changes since rest. Each description mistakes unexpected cells
    for errors of the readings, so an error is accepted only if both need one. The larger size is taken: errors that
    stay constant from frame to frame hardly show in changes.
    """
    readings, scene = noise.readings, recording.scene
    if noise.possible_errors is not None:
        return with_reading_error(noise, recording)
    if readings.sigma is None or scene.panel.crossings > MAX_CELLS:
        return noise
    factors = list[float]()
    with suppress(*BROKEN), np.errstate(all="ignore"):
        for solves, cost in _judges(recording, readings):
            factors.append(error_factor(references(solves, cost)[0]))
            if factors[-1] == 1.0:
                return noise
    if not factors:
        return noise
    factor = max(factors)
    message = _in_words(factor, noise.sigma_factor, scene)
    return scaled(replace(noise, sigma_factor=factor * noise.sigma_factor), factor).with_warnings(message)


def with_reading_error(noise: NoiseEstimate, recording: Recording) -> NoiseEstimate:
    """Return the noise with each reading's own error in σ, for the choice of weights.

    Error bars treat it separately, as an error that all frames share. Averaging does not reduce it, so σ of each of
    n unloaded frames includes √n times the error.
    """
    sigma = noise.readings.sigma
    if sigma is None or not noise.reading_error:
        return noise
    unloaded = recording.role == UNLOADED
    repeats = np.where(unloaded, np.sqrt(unloaded.sum()), 1.0)[:, None, None]
    # σ² ← σ² + (√n e)²: the mean of the n unloaded frames then has the whole error e
    by_reading = repeats * own_errors(noise.readings.value, recording.scene, noise.reading_error)
    return noise.with_sigma(np.hypot(sigma, by_reading))


def scaled(noise: NoiseEstimate, factor: float) -> NoiseEstimate:
    """Return the noise with σ multiplied by the factor of the model's error."""
    sigma = noise.readings.sigma
    return noise if sigma is None else replace(noise.with_sigma(factor * sigma), model_factor=factor)


def _judges(recording: Recording, readings: Readings) -> Iterator[tuple[list[Data], Cost]]:
    """Generate the solves and the cost of frames under load under both descriptions of the cells.

    The second description, by changes since rest, needs unloaded frames.
    """
    scene, resting = recording.scene, baseline_readings(recording, readings)
    frames = deciding_frames(recording, readings, resting)
    if not len(frames):
        return

    def posed(penalty: Term, behind: Background) -> tuple[list[Data], Cost]:
        objective = Estimator((Misfit(weighting="noise"), penalty), "reduced")
        solves = [objective.data(readings[number].alone(), behind) for number in frames]
        similar = [data for data in solves if data.partial == solves[0].partial]
        return similar, objective.cost(scene, 1, partial=solves[0].partial)

    yield posed(LogGradient(weight=1.0), Background(scene))
    fit = fitted(scene, resting, patient=True) if np.any(recording.role == UNLOADED) else None
    if fit is not None:
        yield posed(RelativeChange(weight=1.0), Background(scene, previous=fit.cells, baseline=fit.cells))


def _in_words(factor: float, used: float, scene: Scene) -> str:
    size = ""
    if scene.readout is not None:
        size = f"by {factor * used * float(np.mean(scene.readout.sigma_code())):.2g} LSB, "
    return f"readings are missed {size}{factor:.2g} times their noise: an error of the model"
