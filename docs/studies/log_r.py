"""IPOPT over log r beside IPOPT on the nodal program and the reduced solver.

The unknowns are the cells alone, u = log r, and the bounds are native. Cost, gradient and the dense
Hessian come from `lampest.solvers.hessian` through `casadi.Callback`. Every frame is solved by all
three from the same start, the frame before.

Run it with: python -m docs.studies.log_r [RUN] [--out DIR] [--set PATH=VALUE]
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import casadi
import numpy as np

from docs.studies import script
from docs.studies.cases import Cases, of_cases
from lampest.apps.studies.study import Study
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.methods import named_method
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.report.compare import Columns
from lampest.runs.config import Case, Run, read_run
from lampest.solvers.multistart import evaluated, solved_from
from lampest.solvers.solution import sharp_hessian

DENSE = casadi.Sparsity.dense
NO_DUAL = np.zeros(0)
IPOPT = {"print_level": 0, "sb": "yes", "tol": 1e-10, "mu_strategy": "adaptive"}


class Quantity(casadi.Callback):
    """Function of u for IPOPT; inputs and outputs have names and sizes."""

    def __init__(
        self,
        name: str,
        inputs: dict[str, casadi.Sparsity],
        outputs: dict[str, casadi.Sparsity],
        compute: Callable[[Array], list[casadi.DM]],
    ) -> None:
        super().__init__()
        self._inputs = inputs
        self._outputs = outputs
        self._compute = compute
        self.construct(name)

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, number: int) -> casadi.Sparsity:
        return list(self._inputs.values())[number]

    def get_name_in(self, number: int) -> str:
        return list(self._inputs)[number]

    def get_name_out(self, number: int) -> str:
        return list(self._outputs)[number]

    def get_sparsity_out(self, number: int) -> casadi.Sparsity:
        return list(self._outputs.values())[number]

    def eval(self, arguments: Sequence[casadi.DM]) -> list[casadi.DM]:
        return self._compute(np.asarray(arguments[0]).ravel())


@dataclass(frozen=True)
class Solve:
    """One frame by one solver. above : (φ − least)/(least + unit) over the solvers of the frame."""

    recording: str
    estimator: str
    solver: str
    frame: int
    ms: float
    iterations: int
    above: float


def over_log_r(start: Evaluation) -> tuple[Array, int]:
    """Return the cells (frames, rows, columns) at which IPOPT ends, and its iterations."""
    data = start.data
    size = data.lower.size
    unit = start.cost_scale

    def at(position: Array) -> Evaluation:
        cells = np.exp(position).reshape(data.lower.shape)
        return start.elsewhere(np.clip(cells, data.lower, data.upper))

    def cost(position: Array) -> list[casadi.DM]:
        return [casadi.DM(at(position).objective / unit), casadi.DM(0, 1)]

    def slope(position: Array) -> list[casadi.DM]:
        point = at(position)
        along = sharp_hessian(point, NO_DUAL).gradient
        return [casadi.DM(point.objective / unit), casadi.DM(along / unit)]

    def curvature(position: Array) -> list[casadi.DM]:
        return [casadi.triu(casadi.DM(sharp_hessian(at(position), NO_DUAL).matrix / unit))]

    given = {"x": DENSE(size, 1), "p": DENSE(0, 1)}
    multipliers = {"lam_f": DENSE(1, 1), "lam_g": DENSE(0, 1)}
    number = {"f": DENSE(1, 1)}
    program = Quantity("nlp", given, number | {"g": DENSE(0, 1)}, cost)
    gradient = Quantity("grad_f", given, number | {"grad_f_x": DENSE(size, 1)}, slope)
    upper = {"triu_hess_gamma_x_x": casadi.Sparsity.upper(size)}
    hessian = Quantity("hess_lag", given | multipliers, upper, curvature)
    derivatives = {"grad_f": gradient, "hess_lag": hessian, "no_nlp_grad": True}
    options = {"ipopt": IPOPT, "print_time": False, **derivatives}
    solver = casadi.nlpsol("log_r", "ipopt", program, options)
    begin = start.position.ravel()
    result = solver(x0=begin, lbx=np.log(data.lower).ravel(), ubx=np.log(data.upper).ravel())
    cells = np.exp(np.asarray(result["x"]).reshape(data.lower.shape))
    return cells, int(solver.stats()["iter_count"])


def timed_frames(case: Case) -> list[Solve]:
    """Return the solves of all frames of a case after the first."""
    recording = Recording.load(case.path)
    readings = recording.readings()
    stream = first_stream(recording, readings, case.estimator)
    solves: list[Solve] = []
    before: Array | None = None
    for frame in recording.measured_frames():
        data, _ = stream.data_and_start(readings[frame])
        stream, step = stream.push(readings[frame])
        if before is not None and before.shape == data.measured.shape:
            cost = case.estimator.with_weights(step.weights).cost(
                recording.scene, len(data.measured), partial=data.partial
            )
            start = evaluated(cost, data, before)
            solves += _by_all(case, recording, data, start, int(frame))
        before = step.solution.cell_resistance
    return solves


def _by_all(
    case: Case, recording: Recording, data: Data, start: Evaluation, frame: int
) -> list[Solve]:
    """Return the solves of one frame by all three solvers."""
    ends: dict[str, tuple[float, float, int]] = {}
    for name in ("reduced", "nodal"):
        solver = named_method(name).solver(start.cost, recording.scene, case.estimator.solver, 1.0)
        solver.prepare()
        begin = perf_counter()
        solution = solved_from(solver, start)
        ends[name] = perf_counter() - begin, solution.objective, solution.iterations
    begin = perf_counter()
    cells, iterations = over_log_r(start)
    seconds = perf_counter() - begin
    ends["log r"] = seconds, evaluated(start.cost, data, cells).objective, iterations
    least = min(objective for _, objective, _ in ends.values())
    unit = start.cost_scale
    return [
        Solve(
            case.recording,
            case.name,
            name,
            frame,
            1e3 * seconds,
            iterations,
            (objective - least) / unit,
        )
        for name, (seconds, objective, iterations) in ends.items()
    ]


@dataclass(frozen=True)
class Row:
    """Medians over the frames of one case and solver, and the worst cost."""

    recording: str
    estimator: str
    solver: str
    frames: int
    ms: float
    iterations: float
    worst_above: float


def rows_of(case: Case) -> list[Row]:
    """Return the rows of a case, one for each solver."""
    solves = timed_frames(case)
    rows = []
    for name in dict.fromkeys(solve.solver for solve in solves):
        own = [solve for solve in solves if solve.solver == name]
        rows.append(
            Row(
                case.recording,
                case.name,
                name,
                len(own),
                float(np.median([solve.ms for solve in own])),
                float(np.median([solve.iterations for solve in own])),
                max(solve.above for solve in own),
            )
        )
    return rows


SCREEN: Columns = {
    "recording": "{recording}",
    "estimator": "{estimator}",
    "solver": "{solver}",
    "frames": "{frames}",
    "ms a frame": lambda row: f"{row.ms:.3g}",
    "iterations": lambda row: f"{row.iterations:.3g}",
    "worst cost above the least": lambda row: f"{row.worst_above:.1e}",
}

STUDY: Study[Run, Cases[Row]] = Study(
    "log_r",
    "cases",
    "table1.yaml",
    read_run,
    lambda run, on_step: of_cases(rows_of, run, on_step),
    rows=lambda cases: cases.measured,
    sheets=lambda cases: [("", cases.measured, SCREEN)],
)


if __name__ == "__main__":
    script.main(lambda options: STUDY, script.parser_of(__doc__))
