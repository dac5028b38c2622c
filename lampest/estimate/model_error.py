"""Error of the model: by how much more than their noise readings are missed, whatever the cells.

The reference estimate (`lampest.posterior.reference`) judges it on frames under load. Where the evidence for it is
strong under every description of the cells, it is part of the readings' σ, and so of weights, bounds and error bars.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.estimate.noise import NoiseSeen
from lampest.panel.scene import Scene
from lampest.posterior.interval import TWO_SIDED
from lampest.posterior.reference import ErrorScale, references
from lampest.solvers.multistart import BROKEN

MIN_READINGS = 100  # of which the largest twentieth says how far tails reach; with fewer, one outlier looks like all
MIN_FACTOR = 1.25  # as for the noise: a smaller one changes no verdict
STUDENT_TWO_SIDED = 3.182  # standard scales that hold 95 % of Student's t with three degrees of freedom


def error_factor(scale: ErrorScale) -> float:
    """Return σ with the model's error over σ of the noise, or 1: 95 % of the readings then lie within 1.96 σ.

    An error of all readings shows in the scale of Student's t, one of few readings in the tail.
    """
    if scale.readings < MIN_READINGS:
        return 1.0
    tail = scale.tail / TWO_SIDED
    whole = STUDENT_TWO_SIDED / TWO_SIDED * np.sqrt(scale.best**2 - 1) if scale.best > 1 else 0.0
    factor = max(tail, float(np.hypot(1.0, whole)))
    return factor if factor >= MIN_FACTOR else 1.0


def with_model_error(noise: NoiseSeen, scene: Scene, judges: Iterable[tuple[Sequence[Data], Cost]]) -> NoiseSeen:
    """Return the noise with the model's error, where readings under load show one.

    Parameters
    ----------
    noise : NoiseSeen
        Of the recording; its readings have σ.
    scene : Scene
    judges : iterable of (Data of frames under load, Cost)
        Descriptions of the cells: by steps between neighbours, by changes since rest. Each takes cells that it does not
        expect for errors of the readings, so the one that needs the smallest error is believed.
    """
    factor = np.inf
    with suppress(*BROKEN), np.errstate(all="ignore"):
        for solves, cost in judges:
            factor = min(factor, error_factor(references(solves, cost)[0]))
            if factor == 1.0:
                break
    if not 1 < factor < np.inf or noise.readings.sigma is None:
        return noise
    readings = replace(noise.readings, sigma=factor * noise.readings.sigma)
    said = _in_words(factor, noise.used, scene)
    return replace(noise, readings=readings, used=factor * noise.used, model_factor=factor, model_error=said)


def _in_words(factor: float, used: float, scene: Scene) -> str:
    size = ""
    if scene.readout is not None:
        size = f"by {factor * used * float(np.mean(scene.readout.sigma_code())):.2g} LSB, "
    return f"readings are missed {size}{factor:.2g} times their noise: an error of the model, which error bars include"
