"""Error of the model: by how much more than their noise readings are missed, whatever the cells.

The reference estimate (`lampest.posterior.reference`) judges it on frames under load. Where the evidence for it is
strong under every description of the cells, it is part of the readings' σ, and so of weights, bounds and error bars.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import LogGradient, Misfit, RelativeChange, Term
from lampest.estimate.deciding import baseline_readings, deciding_frame, frames_beside
from lampest.estimate.noise import NoiseEstimate
from lampest.estimate.nuisances import MIN_EVIDENCE_GAIN
from lampest.estimate.objective import AutoWeight, Bounds, PlainObjective
from lampest.estimate.scatter import MIN_EXCESS
from lampest.files.levels import TWO_SIDED
from lampest.panel.scene import Scene
from lampest.panel.systematic import own_errors
from lampest.posterior.interval import student_two_sided
from lampest.posterior.reference import MAX_CELLS, MODEL, ErrorScale, references
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.solvers.multistart import BROKEN, best_solution
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings

MIN_READINGS = 100  # of which the largest twentieth says how far tails reach; with fewer, one outlier looks like all


def error_factor(scale: ErrorScale) -> float:
    """Return σ with the model's error over σ of the noise, or 1: 95 % of the readings then lie within 1.96 σ.

    An error of all readings shows in the scale of Student's t, one of few readings in the tail.
    """
    # Where nothing is wrong, mouths at their limits gain 23 at most; static errors of 7 % gain 76.
    if scale.readings < MIN_READINGS or scale.gain(1.0) < MIN_EVIDENCE_GAIN:
        return 1.0
    tail = scale.tail / TWO_SIDED
    whole = student_two_sided(MODEL.degrees_of_freedom) / TWO_SIDED * np.sqrt(scale.best**2 - 1)
    factor = max(tail, float(np.hypot(1.0, whole)))
    return factor if factor >= MIN_EXCESS else 1.0


def with_model_error(noise: NoiseEstimate, recording: Recording) -> NoiseEstimate:
    """Return the noise of a single network with the model's error, where readings under load show one.

    Where still cells can say how far each reading is off on its own, that is the model's error. Elsewhere cells are
    described by steps between neighbours and by changes since rest. Each description takes cells that it does
    not expect for errors of the readings, so an error is believed where both need one. Its size is the larger one:
    errors that stay from frame to frame hardly show in changes.
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
    """Return the noise with each reading's own error in σ, for weights; error bars know it as one that frames share.

    Repeats do not reduce it, so σ of an unloaded frame is such that their mean has all of it.
    """
    sigma = noise.readings.sigma
    if sigma is None or not noise.reading_error:
        return noise
    unloaded = recording.role == UNLOADED
    repeats = np.where(unloaded, np.sqrt(unloaded.sum()), 1.0)[:, None, None]
    own = repeats * own_errors(noise.readings.value, recording.scene, noise.reading_error)
    return noise.with_sigma(np.hypot(sigma, own))


def scaled(noise: NoiseEstimate, factor: float) -> NoiseEstimate:
    """Return the noise with σ times a factor, which is the model's error."""
    sigma = noise.readings.sigma
    return noise if sigma is None else replace(noise.with_sigma(factor * sigma), model_factor=factor)


def _judges(recording: Recording, readings: Readings) -> Iterator[tuple[list[Data], Cost]]:
    """Frames under load as both descriptions have them; changes since rest where there are unloaded frames."""
    scene, resting = recording.scene, baseline_readings(recording, readings)
    frame = deciding_frame(recording, readings, resting)
    if frame is None:
        return
    frames = [frame, *frames_beside(recording, readings, resting, frame)]

    def posed(penalty: Term, behind: Background) -> tuple[list[Data], Cost]:
        objective = PlainObjective((Misfit(weighting="noise"), penalty), Settings(), Bounds(), AutoWeight())
        solves = [objective.data(readings[number].alone(), behind) for number in frames]
        similar = [data for data in solves if data.partial == solves[0].partial]
        return similar, objective.cost(scene, 1, partial=solves[0].partial)

    yield posed(LogGradient(weight=1.0), Background(scene))
    if np.any(recording.role == UNLOADED):
        plain = PlainObjective((Misfit(weighting="noise"),), Settings(), Bounds(), AutoWeight())
        data = plain.data(resting.alone(), Background(scene))
        solver = ProjectedNewton(plain.cost(scene, 1, partial=data.partial), plain.solver)
        cells = best_solution(solver, data, None).cell_resistance[0]
        yield posed(RelativeChange(weight=1.0), Background(scene, previous=cells, baseline=cells))


def _in_words(factor: float, used: float, scene: Scene) -> str:
    size = ""
    if scene.readout is not None:
        size = f"by {factor * used * float(np.mean(scene.readout.sigma_code())):.2g} LSB, "
    return f"readings are missed {size}{factor:.2g} times their noise: an error of the model, which error bars include"
