"""`weight: auto` of losses with heavy tails against the best weight in hindsight.

The study compares errors in the strongest frame of recordings.

Recordings are `attached` and `rods, one taps` of `docs.studies.limit` in turn; with --real those of
real electronics, whose errors are the same in all frames. Run it with: python -m
docs.studies.heavy_tails --recordings 12 --seed 7100
"""

import argparse

import numpy as np

from docs.studies.limit import RESTING, SETTINGS
from lampest.cost.losses import Absolute, Huber, Squared, Student
from lampest.cost.problem import Data
from lampest.cost.terms import Gradient, LogRatio, Misfit, TotalVariation, TotalVariationOfChange
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import deciding_data
from lampest.estimate.weights import with_chosen_weights
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording, baseline_readings, deciding_frames
from lampest.solvers.multistart import best_solution

FACTORS = 10.0 ** np.arange(-3.0, 2.1, 1 / 3)
TERMS = [
    *(
        kind(weight="auto", loss=loss)
        for kind, corner in ((LogRatio, 3.0), (Gradient, 200.0))
        for loss in (Squared(), Student(corner=corner), Huber(corner=corner), Absolute())
    ),
    TotalVariation(),
    TotalVariationOfChange(),
]


def excess(made: Recording, estimator: Estimator) -> Array:
    """Return rms log errors with the chosen weight over those with the best weight.

    The first ratio is that of the cells, the second that of the changes.
    """
    readings = Prepared(made).noise.readings
    scene = made.scene
    truth = made.truth_cell_resistance
    resting = baseline_readings(made, readings)
    frame = deciding_frames(made, readings, resting)[0]
    assert truth is not None
    [data] = deciding_data(estimator, scene, resting, readings[frame])
    unloaded = None if estimator.relative else deciding_data(estimator, scene, resting, resting)[0]
    chosen = float(with_chosen_weights(estimator, scene, data, None).terms[1].weight)
    errors = []
    for weight in (chosen, *(chosen * FACTORS)):
        weighted = estimator.with_weights([1.0, weight])
        cells = solved(weighted, scene, data)
        baseline = data.given.baseline if unloaded is None else solved(weighted, scene, unloaded)
        of_cells = np.log(cells / truth[frame])
        errors.append([of_cells, of_cells - np.log(baseline / truth[RESTING - 1])])
    size = np.sqrt(np.mean(np.square(errors), axis=(2, 3)))
    return np.asarray(size[0] / np.nanmin(size, axis=0))


def solved(estimator: Estimator, scene: Scene, data: Data) -> Array:
    """Cells (rows, columns) ohm of the last frame; NaN where it is not solved."""
    return best_solution(
        estimator.problem(scene, len(data.measured), 1.0), data, None
    ).cell_resistance[-1]


def study(count: int, seed: int, real: bool) -> None:
    """Print median and 95th percentile for every term and loss, of cells and of changes."""
    names = ("attached, real", "rods, real") if real else ("attached", "rods, one taps")
    every = [SETTINGS[names[number % 2]].recording(seed + 7 * number) for number in range(count)]
    for term in TERMS:
        results = np.array(
            [excess(record, Estimator((Misfit(), term), "reduced")) for record in every]
        )
        both = zip(np.median(results, axis=0), np.percentile(results, 95, axis=0), strict=True)
        cells, change = (f"{middle:.2f} / {high:.2f}" for middle, high in both)
        print(f"{term.kind:25} {term.loss.kind:8} cells {cells}, changes {change}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--seed", type=int, default=7100)
    parser.add_argument("--real", action="store_true")
    arguments = parser.parse_args()
    study(arguments.recordings, arguments.seed, arguments.real)
