"""Solvers of absolute losses beside each other: interior points of two kinds, and an active set.

`reduced` is the interior-point method on the cells, `nodal` is IPOPT on the split residuals with
node voltages. The active set holds residuals at 0: connected cells move together by steps of Gauss
and Newton, which end where a residual reaches 0. At a minimum over the moving groups the
subgradients of least norm either show an optimum, or the direction in which rows open.

Run it with: OMP_NUM_THREADS=1 python -m docs.studies.kinks [--sides 10 16] [--frames 3]: inverses
of M + N - 1 lines of a frame that begins at the one before, medians, steps of the first method and
the last, and the largest cost above the least of the three.
"""

import argparse
from time import process_time

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import lsq_linear
from scipy.sparse.csgraph import connected_components

import lampest
from docs.studies.blocks import under_a_rod
from lampest.apps.studies.common import inverse_time
from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.methods.method import solver_of
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Array
from lampest.solvers.check import check
from lampest.solvers.hessian import Hessian, Smoothing, by_log, weighted_square
from lampest.solvers.multistart import best_solution, evaluated
from lampest.solvers.solution import Outcome, Solution, Status

PENALTIES: dict[str, type[lampest.Term]] = {
    "log_ratio": lampest.LogRatio,
    "total_variation": lampest.TotalVariation,
    "total_variation_of_change": lampest.TotalVariationOfChange,
}
SOLVERS = ("reduced", "nodal", "active set")
AT_ZERO = 1e-9  # of the largest residual: one that counts as 0
SMALL = 1e-9  # of the cost: gradient of an optimum
MOST_STEPS = 300
Mask = NDArray[np.bool_]


def active_set(start: Evaluation) -> tuple[Evaluation, Array, int]:
    """Return the optimum of a frame within no bounds, its duals, and the number of steps."""
    at = start
    slope = at.cost.slope
    size = at.position.size
    jacobian = Hessian(at, Smoothing.start(at)).kinked[:, :size]
    rows = sparse.csr_array(by_log(sparse.csc_array(jacobian), at.cell_resistance)).toarray()
    held = np.abs(at.nonsmooth) <= AT_ZERO * np.abs(at.nonsmooth).max(initial=1.0)
    dual = np.sign(at.nonsmooth)
    for step in range(MOST_STEPS):
        dual = np.where(held, 0.0, np.sign(at.nonsmooth))
        hessian = Hessian(at, Smoothing(1e-300, dual))
        gradient = at.log_gradient(dual).ravel()
        basis = _groups(rows, held)
        along = basis.T @ gradient
        if np.abs(along).max(initial=0.0) <= SMALL * at.cost_scale:
            pulls = (rows[held] * slope[held, None]).T
            inner = lsq_linear(pulls, -gradient, (-1.0, 1.0), method="bvls")
            dual[held] = inner.x
            left = gradient + pulls @ inner.x
            if np.abs(left).max() <= 10 * SMALL * at.cost_scale:
                return at, dual, step
            held = held & (np.abs(rows @ left) <= 1e-6 * np.abs(left).max())
            continue
        squares = weighted_square(hessian.jacobian, hessian.reading_weight.ravel())
        smooth = basis.T @ squares @ basis
        smooth[np.diag_indices(len(smooth))] += 1e-12 * np.abs(smooth.diagonal()).max()
        change = -basis @ cho_solve(cho_factor(smooth), along)
        at, reached = _moved(at, change, rows, held)
        held = held | reached
    return at, dual, MOST_STEPS


def _groups(rows: Array, held: Mask) -> Array:
    """Return orthonormal changes of log r that leave held residuals at 0, (cells, groups)."""
    size = rows.shape[1]
    entries = [np.flatnonzero(row) for row in rows[held]]
    fixed = [cells[0] for cells in entries if len(cells) == 1]
    pairs = np.array([cells for cells in entries if len(cells) == 2], dtype=int).reshape(-1, 2)
    linked = sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(size, size))
    count, label = connected_components(linked, directed=False)
    chosen = np.setdiff1d(np.arange(count), label[fixed])
    basis = (label[:, None] == chosen).astype(float)
    return np.asarray(basis / np.sqrt(basis.sum(axis=0)))


def _moved(at: Evaluation, change: Array, rows: Array, held: Mask) -> tuple[Evaluation, Mask]:
    """Return the point of lower cost along a change, and the residuals that are 0 there."""
    motion = rows @ change
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = np.where(held | (motion * at.nonsmooth >= 0), np.inf, -at.nonsmooth / motion)
    # Candidates: each share at which a residual vanishes, and the whole step.
    shares = np.unique(np.append(crossing[crossing < 1], 1.0))[::-1]
    chosen = [*shares[:: max(1, len(shares) // 8)], *(shares[-1] * 0.5 ** np.arange(8))]
    for share in chosen:
        trial = at.elsewhere(at.cell_resistance * np.exp(share * change.reshape(at.position.shape)))
        if trial.objective < at.objective:
            return trial, ~held & (np.abs(crossing - share) <= 1e-12)
    return at, np.zeros_like(held)


def measured(side: int, penalty: type[lampest.Term], frames: int) -> list[tuple[float, ...]]:
    """Return inverses, steps and cost of each solver for every later frame."""
    recording = under_a_rod(side, 1.0)
    estimate = lampest.reconstruct(recording, [lampest.Misfit(), penalty()], error_bars=False)
    terms = (lampest.Misfit(), penalty(weight=estimate.steps[0].weights[1]))
    readings = recording.readings()
    stream = first_stream(recording, readings, lampest.Estimator(terms, "reduced"))
    matrix = np.random.default_rng(0).random((2 * side - 1, 2 * side - 1))
    matrix += side * np.eye(2 * side - 1)
    cost = stream.estimator.cost(recording.scene, 1)
    found = []
    for frame in recording.measured_frames()[: 1 + frames]:
        data, previous = stream.data_and_start(readings[frame])
        stream, _ = stream.push(readings[frame])
        assert previous is not None
        row = list[float]()
        for kind in SOLVERS:
            unit = inverse_time(matrix)
            begin = process_time()
            solution = _solved(cost, recording.scene, kind, data, previous)
            row += [(process_time() - begin) / unit, solution.iterations]
            row.append(solution.objective if solution.optimum else np.inf)
        found.append(tuple(row))
    return found[1:]


def _solved(cost: Cost, scene: lampest.Scene, kind: str, data: Data, previous: Array) -> Solution:
    """Return the checked solution of one of SOLVERS."""
    if kind == "active set":
        start = evaluated(cost, data, previous)
        end, dual, steps = active_set(start)
        return check(start, Outcome(end.cell_resistance, dual, Status.OPTIMUM, steps))
    solver = solver_of(cost, scene.circuit, scene.wiring, kind, lampest.Settings())
    return best_solution(solver, data, previous)


def main() -> None:
    """Print a row of the table for every panel and penalty."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sides", type=int, nargs="+", default=[10, 16])
    parser.add_argument("--frames", type=int, default=3)
    options = parser.parse_args()
    print(f"| panel | penalty | {' | '.join(SOLVERS)} |\n|---|---|---|---|---|")
    for side in options.sides:
        for name, penalty in PENALTIES.items():
            table = np.array(measured(side, penalty, options.frames))
            times, steps, costs = (table[:, part::3] for part in range(3))
            excess = (costs - costs.min(axis=1)[:, None]) / costs.min(axis=1)[:, None]
            columns = np.stack([np.median(times, 0), np.median(steps, 0), excess.max(axis=0)]).T
            cells = [f"{time:.0f}, {number:.0f}, {above:.0e}" for time, number, above in columns]
            print(f"| {side} × {side} | `{name}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
