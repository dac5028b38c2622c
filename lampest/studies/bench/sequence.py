"""One method on one recording: every frame solved by every solver in turn, A B C A B C."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lampest.cost.problem import Data
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.solvers.newton.directions import Factor
from lampest.solvers.solution import Solution, Solver
from lampest.studies.bench.budget import BenchPart, Budget
from lampest.studies.bench.problems import first_estimate, frame_data, resting_cells, solver_of, tied
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.timing import TimedSolve, Timing, inverse_time, timed

NOTHING = 1e-9
LONG_S = 1.0  # solves of a frame that take so long together are not repeated: disturbances are small beside them


@dataclass(frozen=True, eq=False)
class _Frame:
    """turns : by repeat, then by solver. inverse_s : of each turn. size : Σ y² of the readings."""

    turns: list[list[TimedSolve]]
    inverse_s: list[float]
    size: float

    @property
    def solved(self) -> list[Solution]:
        """What there is of estimates."""
        return [solve.solution for turn in self.turns for solve in turn if solve.solution.solved]

    @property
    def spent_s(self) -> float:
        """All its solves together."""
        return sum(solve.wall for turn in self.turns for solve in turn)


def timings_of(bench: BenchFile, recording: Recording, part: BenchPart, budget: Budget) -> Iterator[Timing]:
    """The timings of all solvers; later frames are left out once there is less time than the last one took."""
    names, method = bench.solvers(part.shape), part.method
    relative, matrix = bench.estimator(method, "reduced").relative, tied(recording)
    best = begun = first_estimate(bench, recording, method)
    kept: Factor | None = None
    frames: list[_Frame] = []
    for number in range(bench.frames + 1):
        if frames and frames[-1].spent_s > budget.left_s():
            break
        fresh = frame_data(bench, recording, method, number, best)
        solvers = [solver_of(bench, method, name, fresh()) for name in names]
        frames.append(_frame(solvers, fresh, best, kept, bench.repeats if number else 1, matrix))
        solved = frames[-1].solved
        kept = next((solution.factor for solution in solved if solution.factor is not None), None)
        if solved:
            best = min(solved, key=lambda solution: solution.objective).cell_resistance[-1]
        elif best is None and relative:
            best = resting_cells(bench, recording, method)
    gaps = _gaps(frames)
    for column, name in enumerate(names):
        yield _timing(
            [[turn[column] for turn in frame.turns] for frame in frames],
            gaps[:, column],
            shape=part.shape,
            method=method,
            solver=name,
            recording=part.recording,
            pair=relative and begun is None,
            inverse_s=float(np.median([seconds for frame in frames for seconds in frame.inverse_s])),
        )


def _frame(
    solvers: list[Solver],
    fresh: Callable[[], Data],
    previous: Array | None,
    kept: Factor | None,
    repeats: int,
    matrix: Array,
) -> _Frame:
    """One frame by every solver in turn, as often as told unless it takes long."""
    turns: list[list[TimedSolve]] = []
    inverses: list[float] = []
    stacked = None if previous is None else previous[None]
    while len(turns) < repeats and not (turns and sum(solve.wall for solve in turns[-1]) > LONG_S):
        turns.append([timed(solver, fresh(), stacked, kept) for solver in solvers])
        inverses.append(inverse_time(matrix))
    return _Frame(turns, inverses, float(np.sum(fresh().measured ** 2)))


def _gaps(frames: list[_Frame]) -> Array:
    """(φ − φ_best)/(φ_best + nothing), (frames, solvers); NaN where a solver is alone, infinite where it left none."""
    reached = np.array([[solve.objective for solve in frame.turns[0]] for frame in frames])
    if reached.shape[1] == 1:
        return np.full(reached.shape, np.nan)
    reached = np.nan_to_num(reached, nan=np.inf)
    least = reached.min(axis=1, keepdims=True)
    nothing = NOTHING * np.array([[frame.size] for frame in frames])
    with np.errstate(invalid="ignore"):
        gaps = (reached - least) / (least + nothing)
    return np.where(np.isnan(gaps), np.inf, gaps)


def _timing(frames: list[list[TimedSolve]], gap: Array, **about: object) -> Timing:
    """frames : of one solver, every repeat of each."""
    wall, cpu = np.full((2, len(frames), max(map(len, frames))), np.nan)
    for frame, solves in enumerate(frames):
        wall[frame, : len(solves)] = [solve.wall for solve in solves]
        cpu[frame, : len(solves)] = [solve.cpu for solve in solves]
    first = [solves[0] for solves in frames]
    return Timing(
        wall=wall,
        cpu=cpu,
        objective=np.array([solve.objective for solve in first]),
        gap=gap,
        iterations=np.array([solve.solution.iterations for solve in first], dtype=np.int64),
        solved=np.array([solve.solution.solved for solve in first]),
        status=tuple(solve.solution.status.value for solve in first),
        **about,  # type: ignore[arg-type]
    )
