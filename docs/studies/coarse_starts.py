"""One start from a coarse panel beside the three starts of a first frame, on large panels.

Where the lines of a panel are alike in pairs, a reading is that of the panel with each pair joined,
plus ½/d of its row and of its column, d the sum of the conductances at a line of the pair. A frame
is therefore solved on the panel of half as many lines, with means of four readings less ½/d of the
unloaded panel, and this panel's own first frame on one of a quarter. The change from the unloaded
panel that comes out, interpolated in log r, is the start.

Run it with: OMP_NUM_THREADS=1 python -m docs.studies.coarse_starts [--sides 48 64] [--frames 14]
[--seed 0] [--picture FILE]. Frames are those of `docs.studies.first_frames`, with `gradient` and
the paper's weight. It prints the table of the page, work in inverses of M + N - 1 lines.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from time import process_time

import matplotlib.pyplot as plt
import numpy as np

from docs.studies.first_frames import log_starts, random_recording
from lampest.apps.studies import common
from lampest.apps.studies.bench import BenchFile
from lampest.apps.studies.study import read_settings
from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.cost.terms import Gradient
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Array, Panel
from lampest.solvers import multistart
from lampest.solvers.multistart import best_solution, evaluated, solved_from
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings

SAME = 1e-6  # relative difference of costs below which two minima count as one
COARSEST = 16  # lines of a side below which none are joined
ROWS = ("three starts", "the first of them", "coarse start", "coarse start, central path")


def merged(values: Array) -> Array:
    """Return means over blocks of 2 × 2, (…, rows/2, columns/2)."""
    *leading, rows, columns = values.shape
    return np.asarray(values.reshape(*leading, rows // 2, 2, columns // 2, 2).mean(axis=(-3, -1)))


def interpolated(values: Array) -> Array:
    """Return values of blocks (1, rows/2, columns/2) at every cell, linear between centres."""

    def weights(count: int) -> Array:
        centres = 2 * np.arange(count) + 0.5
        units = np.eye(count)
        return np.array([np.interp(np.arange(2 * count), centres, unit) for unit in units])

    rows, columns = values.shape[-2:]
    return np.asarray(weights(rows).T @ values @ weights(columns))


def coarse_problem(cost: Cost, data: Data, cells: Array) -> tuple[Cost, Data]:
    """Return cost and data of the panel with lines joined in pairs.

    Parameters
    ----------
    cost : Cost
    data : Data
    cells : array, shape (1, rows/2, columns/2)
        Unloaded cells of the blocks, ohm.
    """
    rows, columns = cells.shape[-2:]
    of_rows = 0.5 / (2 / cells).sum(axis=-1, keepdims=True)
    of_columns = 0.5 / (2 / cells).sum(axis=-2, keepdims=True)
    reading = merged(data.measured)
    # A joined cell has a quarter of the resistance; four times the reading keeps the cells alike.
    reading = 4 * np.maximum(reading - of_rows - of_columns, 0.05 * reading)
    named = {name: np.exp(merged(np.log(value))) for name, value in data.given.named()}
    given = replace(data.given, **named | {"measured": reading})
    # Σ over four readings of δ² is (4δ)²/4; steps of a block are twice those of its cells.
    terms = tuple(
        term if isinstance(term, Gradient) else replace(term, weight=float(term.weight) / 4)
        for term in cost.terms
    )
    bounds = (np.exp(merged(np.log(bound))) for bound in (data.lower, data.upper))
    lower, upper = bounds
    return (
        replace(cost, panel=Panel(rows, columns), terms=terms),
        replace(data, given=given, lower=lower, upper=upper),
    )


def coarse_start(cost: Cost, data: Data, unloaded: Array, settings: Settings) -> Array:
    """Return the start of a frame from the panel of half as many lines, (1, rows, columns) ohm."""
    blocks = np.exp(merged(np.log(unloaded)))
    coarse_cost, coarse_data = coarse_problem(cost, data, blocks)
    start = blocks
    if min(blocks.shape[-2:]) >= 2 * COARSEST:
        start = coarse_start(coarse_cost, coarse_data, blocks, settings)
    begin = evaluated(coarse_cost, coarse_data, start)
    solved = solved_from(ProjectedNewton(coarse_cost, settings), begin)
    return np.asarray(unloaded * np.exp(interpolated(np.log(solved.cell_resistance / blocks))))


def measured(side: int, seed: int) -> Array:
    """Return cost and work of each of ROWS for one frame, (rows, 2)."""
    bench = read_settings(BenchFile)(Path("configs/bench.yaml"))
    recording = random_recording(bench, side, seed)
    readings = recording.readings()
    stream = first_stream(recording, readings, bench.estimator("LSR-gCR", "reduced", (1, 1)))
    data, unloaded = stream.data_and_start(readings[recording.measured_frames()[0]])
    assert unloaded is not None
    cost = stream.estimator.cost(recording.scene, 1, partial=data.partial)
    solver = ProjectedNewton(cost, stream.estimator.solver)
    matrix = np.random.default_rng(0).random((2 * side - 1, 2 * side - 1))
    unit = common.inverse_time(matrix + side * np.eye(2 * side - 1))
    solve = multistart.solved_from
    starts = log_starts()
    begin = process_time()
    best = best_solution(solver, data, unloaded)
    rows = [(best.objective, process_time() - begin), (starts[0][0].objective, starts[0][1])]
    multistart.solved_from = solve
    coarse_start(cost, data, unloaded, solver.settings)  # which compiles the coarse costs
    for attempt in (solver, solver.cold()):
        begin = process_time()
        start = evaluated(cost, data, coarse_start(cost, data, unloaded, solver.settings))
        solution = solved_from(attempt, start)
        rows.append((solution.objective, process_time() - begin))
    return np.array(rows) / (1.0, unit)


def draw(path: Path, excess: Array, work: Array) -> None:
    """Write the picture: work and end of each frame, (frames, rows) each, by each of ROWS."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for number, name in enumerate(ROWS):
        axes.plot(work[:, number], excess[:, number], "o^sD"[number], label=name, alpha=0.7)
    axes.set(xscale="log", xlabel="work [inverses of M + N − 1 lines]")
    axes.set_ylabel("cost above three starts [%]")
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def main() -> None:
    """Print the table, and draw the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sides", type=int, nargs="+", default=[48, 64])
    parser.add_argument("--frames", type=int, default=14)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    frames = []
    for number in range(options.frames):
        frames.append(measured(options.sides[number % len(options.sides)], options.seed + number))
    cost, work = np.moveaxis(np.array(frames), -1, 0)
    excess = 100 * (cost / cost[:, :1] - 1)
    print("| start | cost above three starts: median, largest | as low | work, median |")
    print("|---|---|---|---|")
    for name, above, inverses in zip(ROWS, excess.T, work.T, strict=True):
        low = np.sum(above <= 100 * SAME)
        ends = f"{np.median(above):.1f} %, {above.max():.1f} % | {low} of {len(above)}"
        print(f"| {name} | {ends} | {np.median(inverses):,.0f} |")
    if options.picture is not None:
        draw(options.picture, excess, work)


if __name__ == "__main__":
    main()
