"""Effect of one wild reading on a frame and on the next one, with and without Huber's loss.

Run it with: python -m docs.studies.wild_readings --recordings 24 --seed 101
"""

import argparse
from dataclasses import replace

import numpy as np

from docs.studies.coverage import mouth
from lampest import two_point_resistance
from lampest.cost.losses import AnyLoss, Huber, Squared
from lampest.cost.terms import Arrival, Gradient, Misfit, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array
from lampest.recording.recording import Recording

# one reading in 144 to 1,024 of a recording is wild, in the third of four frames
FRAMES = 4
STRUCK = 2
LOSSES: dict[str, AnyLoss] = {"squared": Squared()} | {
    f"huber {c:g} σ": Huber(corner=c) for c in (1.5, 3.0)
}
PENALTIES: dict[str, tuple[Term, ...]] = {
    "LSM": (),
    "LSR-gCR": (Gradient(weight="auto"),),
    "arrival": (Arrival(),),
}


def recordings(count: int, seed: int) -> list[tuple[Recording, Array]]:
    """(recording, true cells), all frames of one scene with fresh noise each.

    A wild reading is off by a factor of e^±0.2 to e^±2, either way. 6 × 6 to 16 × 16 cells, 0.1 to
    3 % noise.
    """
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        two, cells = mouth(rng)
        assert two.sigma is not None
        sigma = two.sigma
        exact = two_point_resistance(cells)
        place = [0] + [1] * FRAMES
        measured = exact[place] + sigma[place] * rng.standard_normal((FRAMES + 1, *exact.shape[1:]))
        row = rng.integers(measured.shape[1])
        column = rng.integers(measured.shape[2])
        measured[1 + STRUCK, row, column] *= np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 2.0))
        role = np.array(place, dtype=np.uint8)
        whole = replace(
            two, recorded=measured, time=np.arange(FRAMES + 1.0), role=role, sigma=sigma[place]
        )
        made.append((whole, cells[place][1:]))
    return made


def study(count: int, seed: int) -> None:
    """Print errors of all methods and losses before, in and after a frame with a wild reading."""
    made = recordings(count, seed)
    print(
        f"{count} recordings; cell error median / 95th percentile / worst, and intervals that hold "
        "the truth"
    )
    for name, penalties in PENALTIES.items():
        for loss_name, loss in LOSSES.items():
            terms = (Misfit(weighting="noise", loss=loss), *penalties)
            parts: dict[int, list[tuple[Array, Array]]] = {
                STRUCK - 1: [],
                STRUCK: [],
                STRUCK + 1: [],
            }
            for recording, cells in made:
                results = reconstruct(recording, Estimator(terms, formulation="reduced"))
                lower = results.cell_resistance_lower
                upper = results.cell_resistance_upper
                assert lower is not None and upper is not None
                free = ~(results.open_cell | results.at_lower_bound)
                error = 100 * np.abs(results.cell_resistance / cells - 1)
                held = (lower <= cells) & (cells <= upper)
                for frame, own in parts.items():
                    if results.solved[frame]:
                        own.append((error[frame].ravel(), held[frame][free[frame]].astype(float)))
            for frame, word in zip(parts, ("before", "struck", "after"), strict=True):
                error, held = (np.concatenate(part) for part in zip(*parts[frame], strict=True))
                median, high = np.percentile(error, [50, 95])
                print(
                    f"{name:8} {loss_name:12} {word:7} {median:5.2f} / {high:6.1f} / "
                    f"{error.max():8.3g} %, "
                    f"held {100 * held.mean():.1f} %, {len(parts[frame])} solved",
                    flush=True,
                )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=24)
    parser.add_argument("--seed", type=int, default=101)
    arguments = parser.parse_args()
    study(arguments.recordings, arguments.seed)
