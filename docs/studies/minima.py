"""Solves that end at the lowest known minimum, for losses with corners.

Problems are drawn: 4 × 4 to 8 × 8 cells under a load, two-point readings and loaded columns, noise
of 0.1 to 2 %, 2 to 10 % of the readings far off. The misfit has Student's loss with a corner of 2
to 5 standard deviations or of one (`cauchy`), or Huber's; `steps` has Student's loss in the
penalty. The lowest minimum known is that of SciPy's L-BFGS-B on a second statement of the cost,
from many starts, and of the two solvers.

python -m docs.studies.minima [--problems 100] [--seed 1] [--starts 40]

python -m docs.studies.minima --kept [--sides 16 32]: later frames that jump between four rods,
each from the frame before alone, and with the search of a first frame.
"""

import argparse
from collections import defaultdict
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from scipy.optimize import minimize

import lampest
from docs.studies.blocks import METHODS, jumping_between_rods
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import term_kind
from lampest.estimate.methods import named_method
from lampest.estimate.sequence import first_stream
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array
from lampest.solvers.multistart import best_solution
from lampest.solvers.solution import Settings, Solution

SAME = 1e-6  # relative difference of costs below which two minima count as one
LOSSES = ("student", "cauchy", "huber", "steps")
SOLVERS = ("reduced", "nodal")


@dataclass(frozen=True, eq=False)
class Problem:
    """A drawn problem.

    Attributes
    ----------
    loss : str
        One of LOSSES.
    scene : Scene
    terms : tuple of Term
    measured, sigma : array, shape (rows, columns)
    cells : array, shape (rows, columns)
        The true ones, ohm.
    previous : array, shape (rows, columns), or None
        Start of the frame; None for equal cells.
    """

    loss: str
    scene: lampest.Scene
    terms: tuple[lampest.Term, ...]
    measured: Array
    sigma: Array
    cells: Array
    previous: Array | None

    @classmethod
    def drawn(cls, seed: int, number: int) -> "Problem":
        """Return the problem of these two numbers."""
        random = np.random.default_rng([seed, number])
        loss = LOSSES[number % len(LOSSES)]
        rows, columns = (int(side) for side in random.integers(4, 9, 2))
        resting = 3000 * np.exp(0.2 * random.standard_normal((rows, columns)))
        row, column = np.indices((rows, columns))
        place = random.uniform(0, rows - 1), random.uniform(0, columns - 1)
        distance = np.hypot(row - place[0], column - place[1])
        load = random.uniform(0.5, 2.5) * np.exp(-((distance / random.uniform(1, 3)) ** 4))
        cells = resting * np.exp(-load)
        readout: lampest.Readout = lampest.TwoPointReadout()
        if random.random() < 0.4:
            readout = lampest.LoadedColumnsReadout(drive_ohm=100.0, load_ohm=1000.0)
        scene = lampest.Scene(lampest.Panel(rows, columns), readout)
        exact = scene.circuit.exact_reading(cells)
        sigma = 10 ** random.uniform(-3, -1.7) * np.abs(exact)
        measured = exact + sigma * random.standard_normal(exact.shape)
        far = random.random(exact.shape) < random.uniform(0.02, 0.1)
        measured = np.where(far, measured * np.exp(random.uniform(-1, 1, exact.shape)), measured)
        corner = {"student": random.uniform(2, 5), "cauchy": 1.0, "huber": 1.5}.get(loss)
        kinds = {"student": lampest.Student, "cauchy": lampest.Student, "huber": lampest.Huber}
        misfit = lampest.Misfit(weighting="noise")
        weight = 10 ** random.uniform(-0.5, 2.5)
        step = lampest.LogGradient(weight=weight)
        if loss == "steps":
            corner = random.uniform(0.1, 0.5)
            step = lampest.LogGradient(weight=weight, loss=lampest.Student(corner=corner))
        else:
            misfit = lampest.Misfit(weighting="noise", loss=kinds[loss](corner=corner))
        previous = resting if random.random() < 0.5 else None
        return cls(loss, scene, (misfit, step), measured, sigma, cells, previous)

    @property
    def data(self) -> Data:
        """The data of the solve."""
        zeros = np.zeros((1, *self.measured.shape))
        readings = lampest.Readings(self.measured[None], self.sigma[None], zeros, zeros + 1)
        return lampest.Estimator(self.terms).data(readings, Background(self.scene))

    def solved(self, kind: str) -> Solution:
        """Return the solution of a formulation."""
        estimator = lampest.Estimator(self.terms, kind)
        cost = estimator.cost(self.scene, 1, partial=False)
        solver = named_method(kind).solver(cost, self.scene, Settings(), 1.0)
        solver.prepare()
        start = None if self.previous is None else self.previous[None]
        return best_solution(solver, self.data, start)

    def least(self, data: Data, starts: int, seed: int) -> float:
        """Return the least cost that L-BFGS-B finds from so many starts."""
        random = np.random.default_rng(seed)
        stated = Statement.of(self)
        bounds = list(zip(np.log(data.lower).ravel(), np.log(data.upper).ravel(), strict=True))
        uniform = np.log(data.uniform_start).ravel()
        best = np.inf
        for number in range(starts):
            place = uniform + random.uniform(0, 2) * random.standard_normal(uniform.size)
            if number % 3 == 0:
                place = np.log(data.apparent_resistance).ravel() + random.uniform(
                    0, np.log(20), uniform.size
                )
            if number == 1:
                place = np.log(self.cells).ravel()
            ended = minimize(
                stated.value,
                place,
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={
                    "maxiter": 1000,
                    "maxfun": 3000,
                    "ftol": 1e-15,
                    "gtol": 1e-10,
                    "maxcor": 30,
                },
            )
            best = min(best, float(ended.fun))
        return best


@dataclass(frozen=True, eq=False)
class Statement:
    """The cost of a problem and its gradient in log r, stated in NumPy a second time.

    Attributes
    ----------
    problem : Problem
    operator : array, shape (pairs, cells)
        Differences of neighbours.
    """

    problem: Problem
    operator: Array

    @classmethod
    def of(cls, problem: Problem) -> "Statement":
        """Return the statement."""
        units = np.eye(problem.measured.size).reshape(-1, *problem.measured.shape)
        parts = [np.diff(units, axis=axis).reshape(len(units), -1) for axis in (1, 2)]
        return cls(problem, np.concatenate(parts, axis=1).T)

    def value(self, place: Array) -> tuple[float, Array]:
        """Return φ and ∂φ/∂u."""
        problem = self.problem
        misfit, step = problem.terms
        reading, response = self._reading(np.exp(place))
        x = (reading - problem.measured.ravel()) / problem.sigma.ravel()
        cost, slope = _loss(misfit.loss, x)
        gradient = response.T @ (slope / problem.sigma.ravel())
        steps = self.operator @ place
        cost_of_steps, slope_of_steps = _loss(step.loss, steps)
        weight = float(step.weight)
        gradient += weight * self.operator.T @ slope_of_steps
        return cost + weight * cost_of_steps, gradient

    def _reading(self, cells: Array) -> tuple[Array, Array]:
        """Return y and ∂y/∂u of cells, flat."""
        rows, columns = self.problem.measured.shape
        lines = rows + columns
        row = np.repeat(np.arange(rows), columns)
        column = rows + np.tile(np.arange(columns), rows)
        incidence = np.zeros((cells.size, lines))
        incidence[np.arange(cells.size), row] = 1
        incidence[np.arange(cells.size), column] = -1
        matrix = incidence.T @ (incidence / cells[:, None])
        readout = self.problem.scene.circuit
        if isinstance(readout, lampest.LoadedColumnsReadout):
            matrix[np.arange(rows, lines), np.arange(rows, lines)] += 1 / np.asarray(
                readout.load_ohm
            )
            impedance = np.linalg.inv(matrix)
        else:
            impedance = np.zeros((lines, lines))
            impedance[1:, 1:] = np.linalg.inv(matrix[1:, 1:])
        drop = impedance @ incidence.T
        if not isinstance(readout, lampest.LoadedColumnsReadout):
            between = incidence @ drop
            return np.diag(between).copy(), between**2 / cells
        own = impedance[row, row] + readout.drive_ohm
        value = impedance[row, column] / own
        change = drop[row] * (drop[column] - value[:, None] * drop[row]) / own[:, None]
        return readout.supply_volt * value, readout.supply_volt * change / cells


def _loss(loss: lampest.Loss, x: Array) -> tuple[float, Array]:
    """Return Σ ρ(x) and ρ'(x)."""
    if isinstance(loss, lampest.Student):
        square = (x / loss.corner) ** 2
        return float(loss.corner**2 * np.log1p(square).sum()), 2 * x / (1 + square)
    if isinstance(loss, lampest.Huber):
        inside = np.clip(x, -loss.corner, loss.corner)
        return float(np.sum(inside * (2 * x - inside))), 2 * inside
    return float(x @ x), 2 * x


def search_gain(side: int, terms: tuple[lampest.Term, ...]) -> str:
    """Return how much lower the search of a first frame ends than the frame before leads to."""
    recording = jumping_between_rods(side, 0.1)
    readings = Prepared(recording).noise.readings
    estimator = lampest.Estimator(terms, "reduced", error_bars=False)
    stream = first_stream(recording, readings, estimator)
    decreases = []
    changes = []
    for frame in recording.measured_frames().tolist():
        data, previous = stream.data_and_start(readings[frame])
        first = stream.first
        stream, step = stream.push(readings[frame])
        if first:
            continue
        solver = estimator.with_weights(step.weights).problem(recording.scene, 1, 0.1)
        searched = best_solution(solver, replace(data, first=True), previous)
        decreases.append(1 - searched.objective / step.solution.objective)
        ratio = searched.cell_resistance[0] / step.cell_resistance
        changes.append(float(np.abs(np.log(ratio)).max()))
    lower = np.array(decreases) > SAME
    return (
        f"| {side} × {side} | {term_kind(terms[1])} | {lower.sum()} of {lower.size} | "
        f"{max(decreases):.1e} | {max(changes):.1e} |"
    )


def compared(options: argparse.Namespace) -> None:
    """Print a line for every problem beyond SAME, and the table."""
    excess = defaultdict[tuple[str, str], list[float]](list)
    equal = defaultdict[str, list[bool]](list)
    seconds = dict.fromkeys(SOLVERS, 0.0)
    for number in range(options.problems):
        problem = Problem.drawn(options.seed, number)
        costs = dict.fromkeys(SOLVERS, np.inf)
        for kind in SOLVERS:
            begin = process_time()
            solution = problem.solved(kind)
            seconds[kind] += process_time() - begin
            if solution.solved:
                costs[kind] = solution.objective
        least = min(problem.least(problem.data, options.starts, number), *costs.values())
        above = {kind: cost / least - 1 for kind, cost in costs.items()}
        for kind, value in above.items():
            excess[problem.loss, kind].append(value)
        equal[problem.loss].append(max(costs.values()) / min(costs.values()) - 1 <= SAME)
        if max(above.values()) > SAME:
            excesses = ", ".join(f"{kind} {value:.1e}" for kind, value in above.items())
            print(f"problem {number}, {problem.loss}: {excesses}", flush=True)
    print("| loss | " + " | ".join(SOLVERS) + " | equal |")
    for loss in LOSSES:
        figures = [
            f"{np.sum(np.array(excess[loss, kind]) <= SAME)} ({max(excess[loss, kind]):.1e})"
            for kind in SOLVERS
        ]
        print(f"| {loss} | {' | '.join(figures)} | {sum(equal[loss])} of {len(equal[loss])} |")
    print(", ".join(f"{kind} {value:.1f} s" for kind, value in seconds.items()))


def main() -> None:
    """Print the requested tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--starts", type=int, default=40, help="of L-BFGS-B")
    parser.add_argument("--kept", action="store_true", help="later frames with and without search")
    parser.add_argument("--sides", type=int, nargs="+", default=[16, 32])
    options = parser.parse_args()
    if not options.kept:
        compared(options)
        return
    print("| panel | penalty | lower by a search | at most | largest difference of ln r |")
    for side in options.sides:
        for terms in list(METHODS.values())[1:]:
            print(search_gain(side, terms), flush=True)


if __name__ == "__main__":
    main()
