"""Error bars under absolute losses whose weights the data chose, against true errors.

The recordings are those of `docs.studies.effects` without an effect. The table has the ratio of
`sigma_own` to the errors, in the median over the cells of a recording, and the shares of cells and
of moved cells' changes within their 95 % intervals.

Run it with: python -m docs.studies.absolute_losses [--recordings 12] [--seed 3000] [--side 10]
"""

import argparse
from collections.abc import Iterator

import numpy as np

import lampest
from docs.studies import effects
from lampest.files.levels import MAD_TO_SIGMA, TWO_SIDED
from lampest.panel.panel import Array

MOVED = 0.02  # of ln r: a cell beyond it counts as moved
LOADS = [name for name, load in effects.LOADS.items() if not load.scanned]
PENALTIES: dict[str, lampest.Term] = {
    "log_ratio": lampest.LogRatio(),
    "total_variation_of_change": lampest.TotalVariationOfChange(),
}


def figures(made: lampest.Recording, penalty: lampest.Term) -> tuple[float, float, float]:
    """Return the ratio of bars to errors, and both shares within intervals, %."""
    estimate = lampest.reconstruct(made, [lampest.Misfit(), penalty])
    truth = made.truth_cell_resistance
    bars = estimate.sigma_own
    lower, upper = estimate.relative_change_lower, estimate.relative_change_upper
    assert truth is not None and bars is not None and lower is not None and upper is not None
    error: Array = np.log(estimate.cell_resistance / truth[estimate.frame])
    own = error - np.median(error, axis=(1, 2), keepdims=True)
    ratio = truth[estimate.frame] / truth[0]
    within = (lower <= 100 * (ratio - 1)) & (100 * (ratio - 1) <= upper)
    return (
        float(np.median(bars) / MAD_TO_SIGMA / np.median(np.abs(own))),
        100 * float(np.mean(np.abs(own) < TWO_SIDED * bars)),
        100 * float(np.mean(within[np.abs(np.log(ratio)) > MOVED])),
    )


def table(recordings: int, seed: int) -> Iterator[str]:
    """The lines of the page's table."""
    yield "| penalty | load | bars over errors | cells | changes of moved cells |"
    yield "|---|---|---|---|---|"
    for name, penalty in PENALTIES.items():
        for load in LOADS:
            every = np.array(
                [
                    figures(
                        effects.recording(
                            seed + at, effects.LOADS[load], effects.ROWS["nothing"], {}
                        ),
                        penalty,
                    )
                    for at in range(recordings)
                ]
            )
            low, middle, high = np.percentile(every[:, 0], [0, 50, 100])
            cells, changes = every[:, 1:].mean(axis=0)
            yield (
                f"| `{name}` | {load} | {low:.2f} / {middle:.2f} / {high:.2f} "
                f"| {cells:.1f} | {changes:.1f} |"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--seed", type=int, default=3000)
    parser.add_argument("--side", type=int, default=10)
    given = parser.parse_args()
    effects.SHAPE = (given.side, given.side)
    for line in table(given.recordings, given.seed):
        print(line, flush=True)
