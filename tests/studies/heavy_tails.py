"""`weight: auto` of losses with heavy tails against the best weight in hindsight, in the strongest frame of recordings.

Recordings are `attached` and `rods, one taps` of `tests.studies.limit` in turn. Run it with:
python -m tests.studies.heavy_tails --recordings 12 --seed 7100
"""

import argparse

import numpy as np

from lampest.cost.losses import Huber, Squared, Student
from lampest.cost.terms import Gradient, LogRatio, Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import deciding_data, deciding_frame, resting_readings
from lampest.estimate.weights import with_chosen_weights
from lampest.recording.recording import Recording
from lampest.solvers.multistart import best_solution
from tests.studies.limit import SETTINGS

FACTORS = 10.0 ** np.arange(-1.8, 1.9, 0.3)
TERMS = [
    kind(weight="auto", loss=loss)
    for kind, corner in ((LogRatio, 3.0), (Gradient, 200.0))
    for loss in (Squared(), Student(corner=corner), Huber(corner=corner))
]


def excess(made: Recording, estimator: Estimator) -> tuple[float, float]:
    """(rms log error with the chosen weight over that of the best one, chosen over best weight)."""
    readings, scene, truth = made.readings(), made.scene, made.truth_cell_resistance
    resting = resting_readings(made, readings)
    frame = deciding_frame(made, readings, resting)
    assert truth is not None and frame is not None
    data = deciding_data(estimator, scene, resting, readings[frame])
    chosen = float(with_chosen_weights(estimator, scene, data, None, True).terms[1].weight)
    errors = []
    for weight in (chosen, *(chosen * FACTORS)):
        weighted = estimator.with_weights([1.0, weight])
        found = best_solution(weighted.problem(scene, len(data.measured), 1.0), data, None)
        error = np.sqrt(np.mean(np.log(found.cell_resistance[-1] / truth[frame]) ** 2)) if found.solved else np.inf
        errors.append(float(error))
    return errors[0] / min(errors), float((1.0, *FACTORS)[int(np.argmin(errors))] ** -1)


def study(count: int, seed: int) -> None:
    """Print median and 95th percentile for every term and loss."""
    names = ("attached", "rods, one taps")
    every = [SETTINGS[names[number % 2]].recording(seed + 7 * number) for number in range(count)]
    for term in TERMS:
        found = np.array([excess(one, Estimator((Misfit(), term), "reduced")) for one in every])
        (middle, weight), high = np.median(found, axis=0), np.percentile(found[:, 0], 95)
        print(f"{term.kind:12} {term.loss.kind:8} {middle:.2f} / {high:.2f}; {weight:.2g} times the best weight")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--seed", type=int, default=7100)
    arguments = parser.parse_args()
    study(arguments.recordings, arguments.seed)
