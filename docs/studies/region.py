"""Does the region solver keep its gain with wild readings, and with a penalty? Against whole solves of its frames.

    OMP_NUM_THREADS=1 python -m docs.studies.region --side 100 [--weight 1e-3] [--wild 0 0.001 0.01] [--seed 1]

Plain least squares, and LSR-∇CR where a weight is given, of a pressed oval of a seventh of the side, by `region` and by
`reduced`. Times are those of the processor, the median of the frames, also in dense inverses of the panel's lines; the
cost is that of all readings but the wild ones, as a share of the whole solve's; errors are of all cells, the median and
the 95th percentile, and of those under the load.
"""

import argparse
from time import process_time

import numpy as np

from lampest import two_point_resistance
from lampest.cost.terms import Gradient, Misfit, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.stream import Stream
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.studies.common import inverse_time

NOISE = 1e-4  # of a reading: 20 of a 14-bit converter with half a bit of noise
FACTORS = (0.2, 2.0)  # of the logarithm by which a wild reading is off
WAYS = ("reduced", "region")


def frames(side: int, count: int, wild: float, random: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """(cells, readings (1 + frames, side, side), which are wild, where the load is); the first frame rests."""
    resting = 3000 * np.exp(0.1 * random.standard_normal((side, side)))
    down, along = np.indices((side, side))
    inside = np.hypot((down - 0.4 * side) / 0.8, along - 0.6 * side) < side / 14
    cells = np.stack([resting, *(np.where(inside, 0.4 * (1 - 0.1 * k) * resting, resting) for k in range(count))])
    measured = np.stack([two_point_resistance(one) for one in cells])
    measured *= 1 + NOISE * random.standard_normal(measured.shape)
    struck = random.random(measured.shape) < wild
    struck[0] = False
    size = int(struck.sum())
    measured[struck] *= np.exp(random.choice([-1.0, 1.0], size) * random.uniform(*FACTORS, size))
    return cells, measured, struck, inside


def study(side: int, weight: float | None, wild: float, count: int, seed: int) -> None:
    """Print a line for each way."""
    cells, measured, struck, inside = frames(side, count, wild, np.random.default_rng(seed))
    inverse_s = inverse_time(np.linalg.inv(np.eye(2 * side - 1) + 0.1))
    scene, least = Scene(Panel(side, side)), np.full(count, np.nan)
    terms: tuple[Term, ...] = (Misfit(), *([] if weight is None else [Gradient(weight=weight)]))
    for way in WAYS:
        readings = [Readings.of(scene, one, NOISE * one) for one in measured]
        stream = Stream.begin(Estimator(terms, formulation=way, error_bars=False), scene, 1.0, readings[0])
        seconds, costs, errors, ended = [], [], [], []
        for number, one in enumerate(readings[1:], 1):
            begin = process_time()
            stream, step = stream.push(one)
            seconds.append(process_time() - begin)
            ended.append(step.solution.status.name)
            found = step.cell_resistance
            if not step.solution.solved:
                costs.append(np.nan)
                continue
            off = np.where(struck[number], 0.0, two_point_resistance(found) - measured[number])
            slopes = [] if weight is None else [weight * float(np.sum(part**2)) for part in np.gradient(found)]
            costs.append(float(np.sum(off**2)) + sum(slopes))
            errors.append(100 * np.abs(found / cells[number] - 1))
        least = np.array(costs) if way == WAYS[0] else least
        typical, all_of = float(np.median(seconds)), np.array(errors or [np.full(inside.shape, np.nan)])
        under = np.median([np.median(error[inside]) for error in all_of])
        print(
            f"{side} × {side}, {'LSM' if weight is None else f'LSR-gCR {weight:g}'}, {100 * wild:g} % wild, {way:8}"
            f" {1e3 * typical:8.1f} ms {typical / inverse_s:7.0f} inverses,"
            f" cost {np.median(np.array(costs) / least - 1):+.1e}, error {np.median(all_of):.2f} /"
            f" {np.percentile(all_of, 95):.2f}, load {under:.2f} %, {', '.join(sorted(set(ended)))}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=100)
    parser.add_argument("--weight", type=float, default=None)
    parser.add_argument("--wild", type=float, nargs="+", default=[0.0, 0.001, 0.01])
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for share in given.wild:
        study(given.side, given.weight, share, given.frames, given.seed)
