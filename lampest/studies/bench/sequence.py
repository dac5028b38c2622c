"""One method on one recording: every frame solved by every solver in turn, A B C A B C."""

from collections.abc import Callable, Iterator

import numpy as np

from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.solvers.newton.directions import Factor
from lampest.solvers.newton.newton import Newton
from lampest.solvers.solution import Solver
from lampest.studies.bench.problems import first_estimate, frame_data, resting_cells, solver_of, tied
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.timing import TimedSolve, Timing, inverse_time, timed

NOTHING = 1e-9
LONG_S = 1.0  # solves of a frame that take so long together are not repeated: disturbances are small beside them


def timings_of(
    bench: BenchFile, recording: Recording, method: str, number: int, left_s: Callable[[], float]
) -> Iterator[Timing]:
    """The timings of all solvers; frames after the first are left out once there is less time than the last one took.

    number : of the recording. left_s : how many seconds there are.
    """
    names = bench.solvers(recording.scene.panel.shape)
    estimator, matrix = bench.estimator(method, "reduced"), tied(recording)
    best = begun = first_estimate(bench, recording, method)
    kept: Factor | None = None
    frames: list[list[list[TimedSolve]]] = []
    sizes: list[float] = []
    inverses: list[float] = []
    for frame in range(bench.frames + 1):
        if frame and sum(solve.wall for turn in frames[-1] for solve in turn) > left_s():
            break
        fresh = frame_data(bench, recording, method, frame, best)
        example = fresh()
        solvers = [_following(solver_of(bench, method, name, example), kept) for name in names]
        frames.append([])
        sizes.append(float(np.sum(example.measured**2)))
        for _ in range(bench.repeats if frame else 1):
            turn = [timed(solver, fresh(), None if best is None else best[None]) for solver in solvers]
            frames[-1].append(turn)
            inverses.append(inverse_time(matrix))
            if sum(solve.wall for solve in turn) > LONG_S:
                break
        solved = [solve.solution for turn in frames[-1] for solve in turn if solve.solution.solved]
        kept = next((solution.factor for solution in solved if solution.factor is not None), None)
        if solved:
            best = min(solved, key=lambda solution: solution.objective).cell_resistance[-1]
        elif best is None and estimator.relative:
            best = resting_cells(bench, recording, method)
    objective = np.array([[solve.objective for solve in turns[0]] for turns in frames])
    gaps = _gaps(objective, NOTHING * np.array(sizes))
    for column, name in enumerate(names):
        yield _timing(
            [[turn[column] for turn in turns] for turns in frames],
            gaps[:, column],
            shape=recording.scene.panel.shape,
            method=method,
            solver=name,
            recording=number,
            pair=estimator.relative and begun is None,
            inverse_s=float(np.median(inverses)),
        )


def _following(solver: Solver, kept: Factor | None) -> Solver:
    """A solver with what a sequence keeps from the frame before."""
    return solver.following(kept) if isinstance(solver, Newton) else solver


def _gaps(objective: Array, nothing: Array) -> Array:
    """(φ − φ_best)/(φ_best + nothing), (frames, solvers); NaN where a solver is alone, infinite where it left none."""
    if objective.shape[1] == 1:
        return np.full(objective.shape, np.nan)
    reached = np.nan_to_num(objective, nan=np.inf)
    least = reached.min(axis=1)
    with np.errstate(invalid="ignore"):
        gaps = (reached - least[:, None]) / (least + nothing)[:, None]
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
