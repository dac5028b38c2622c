"""Inequalities that a circuit's readings keep whatever the cells are, held against every frame."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.model_check.explanation import LEVEL
from lampest.estimate.model_check.question import Question, nearly_gaussian
from lampest.estimate.model_check.rivals import Rival
from lampest.panel.scene import Scene
from lampest.posterior.interval import largest_of
from lampest.recording.readings import Readings


def broken_law(scene: Scene, readings: Readings, noise: float, named: NDArray[np.intp] | None = None) -> str:
    """The inequality of the circuit that readings break by more than their noise, in words; '' where none.

    named : (frames) the numbers by which the words name them; None: as they come.
    """
    sigma = readings.sigma_of_values
    assert sigma is not None
    for test in scene.circuit.free_tests(readings.value, noise * sigma):
        frame = int(np.argmax(test.excess))
        if largest_of(test.excess[frame], test.count * len(test.excess)) < LEVEL:
            beyond = f"{test.excess[frame]:.3g} times its noise"
            number = frame if named is None else named[frame]
            return f"readings of frame {number} break a law of the circuit by {beyond}: {test.law}"
    return ""


def lawful(rival: Rival, question: Question) -> bool:
    """Whether every frame keeps the inequalities of a circuit that is to take the told one's place."""
    readings = Readings.of(rival.scene, rival.recorded, rival.sigma)
    used = replace(readings, seen=readings.seen * nearly_gaussian(question.told, 1))
    return not broken_law(rival.scene, used, question.widening)
