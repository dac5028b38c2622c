"""Runs cases: skips what is done, isolates what fails, keeps what is finished."""

import fcntl
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lampest.cost.terms import term_kind
from lampest.estimate.sequence import Reconstruction, reconstruct
from lampest.files.errors import InputError
from lampest.loads.pressure import pressure_of
from lampest.loads.shapes.disc import Disc
from lampest.panel.panel import Array
from lampest.recording.recording import UNLOADED, Recording
from lampest.runs.config import Case, Run, digest
from lampest.runs.executors import Executor
from lampest.runs.results import CaseResult, read_results, write_results

RESULTS = "results.h5"
LIBRARIES = ("lampest", "casadi", "numpy", "h5py")


@dataclass(frozen=True)
class Report:
    """How a batch went: path of the results file, numbers of cases, and (case, sentence) of those that failed."""

    results: Path
    done: int
    skipped: int
    failed: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Task:
    """A case and the folder that takes its result."""

    case: Case
    folder: Path

    @property
    def file(self) -> Path:
        """Where the case's result is kept."""
        return self.folder / "cases" / f"{self.case.case_id}.h5"


def run_batch(
    run: Run, folder: Path, executor: Executor, fresh: bool = False, on_case: Callable[[int, int], None] | None = None
) -> Report:
    """Solve the cases that have no result in `folder` yet, then write results.h5 with all that have one.

    A case that fails is named in the report and costs no other; an interruption keeps what is finished. Raises
    InputError where the folder cannot be written or another run is using it.
    """
    executor.ready()
    with exclusive(folder):
        tasks = [Task(case, folder.absolute()) for case in run.cases]
        _clear(folder, tasks if fresh else [])
        found = {task.file: result for task in tasks if (result := _result(task)) is not None}
        waiting = [task for task in tasks if task.file not in found]
        failed: list[tuple[str, str]] = []
        try:
            with closing(executor.results(solve_case, waiting)) as outcomes:
                for finished, (task, outcome) in enumerate(outcomes, 1):
                    if isinstance(outcome, BaseException):
                        failed.append((f"{task.case.recording} × {task.case.name}", " ".join(str(outcome).split())))
                    else:
                        found[task.file] = outcome
                    if on_case:
                        on_case(finished, len(waiting))
        finally:
            done = [result for task in tasks if (result := found.get(task.file) or _result(task)) is not None]
            if done:
                write_results(folder / RESULTS, done, run.published)
        return Report(folder / RESULTS, len(waiting) - len(failed), len(tasks) - len(waiting), tuple(failed))


def solve_case(task: Task) -> CaseResult:
    """Solve one case and write its result, whole or not at all."""
    recording = _recording(task.case.path, task.case.sha256)
    result = case_result(task.case, reconstruct(recording, task.case.estimator))
    write_results(task.file, [result])
    return result


@lru_cache(maxsize=1)
def _recording(path: Path, sha256: str) -> Recording:
    """A recording, read once by each process for the cases in a row that need it.

    Raises InputError where the file is no longer the one that the run began with.
    """
    recording = Recording.load(path)
    if digest(path) != sha256:
        raise InputError(f"{path}: was replaced after the run began; run again")
    return recording


def case_result(case: Case, found: Reconstruction) -> CaseResult:
    """What the results file keeps of a reconstruction."""
    recording = found.recording
    truth = recording.truth_cell_resistance
    unloaded = recording.role == UNLOADED
    solutions = [step.solution for step in found.steps]
    last = [
        (solution.two_point_resistance[-1], solution.open_cell[-1], solution.at_lower[-1]) for solution in solutions
    ]
    return CaseResult(
        recording=case.recording,
        estimator=case.name,
        case_id=case.case_id,
        case_yaml=case.resolved,
        versions={library: version(library) for library in LIBRARIES},
        pitch_mm=recording.scene.panel.pitch_mm,
        series_resistance_ohm=recording.scene.series_resistance_ohm,
        top_row_depth_mm=None if recording.scene.water is None else recording.scene.water.top_row_depth_mm,
        frame=found.frame.astype(np.int64),
        time=recording.time[found.frame],
        measured=found.measured,
        measured_baseline=found.measured_baseline,
        cell_resistance=found.cell_resistance,
        relative_change=found.relative_change,
        two_point_model=np.stack([model for model, _, _ in last]),
        open_cell=np.stack([flags for _, flags, _ in last]).astype(np.uint8),
        at_lower_bound=np.stack([flags for _, _, flags in last]).astype(np.uint8),
        baseline_resistance=found.baseline_resistance,
        status=tuple(solution.status.value for solution in solutions),
        iterations=np.array([solution.iterations for solution in solutions], dtype=np.int64),
        solve_time=np.array([step.seconds for step in found.steps]),
        objective=np.array([solution.objective for solution in solutions]),
        kkt_residual=np.array([solution.kkt_residual for solution in solutions]),
        costs={
            term_kind(term): np.array([solution.costs[number] for solution in solutions])
            for number, term in enumerate(case.estimator.terms)
        },
        weights={
            term_kind(term): np.array([step.weights[number] for step in found.steps])
            for number, term in enumerate(case.estimator.terms)
        },
        baseline_status=found.baseline.solution.status.value,
        baseline_solve_time=found.baseline.seconds,
        joint_start=found.joint_start,
        solved=np.array([solution.solved for solution in solutions]),
        disc=disc_numbers(found),
        **certainty_columns(found),
        sigma=found.sigma,
        sigma_baseline=found.sigma_baseline,
        truth=None if truth is None else truth[found.frame],
        truth_baseline=truth[unloaded].mean(axis=0) if truth is not None and np.any(unloaded) else None,
    )


def disc_numbers(found: Reconstruction) -> dict[str, Array]:
    """Every number of the discs and its standard deviation, (frames); NaN where a frame failed."""
    discs = [step.disc for step in found.steps]
    if not any(discs):
        return {}
    numbers = {}
    for name in Disc._fields:
        for end, part in (("", "disc"), ("_errors", "disc_errors")):
            values = [np.nan if disc is None else getattr(getattr(disc, part), name) for disc in discs]
            numbers[name + end] = np.array(values, dtype=float)
    return numbers


def certainty_columns(found: Reconstruction) -> dict[str, Any]:
    """The fields of CERTAINTY and PRESSURE, where there are error bars; an estimate without any has infinite ones."""
    barred = [step.bars for step in found.steps]
    if not any(barred) or found.baseline_bars is None:
        return {}
    cells, change = found.cell_resistance, found.cell_resistance / found.baseline_resistance

    def stacked(part: str, name: str) -> Array:
        unknown = np.full(cells.shape[1:], 0.0 if name in ("resolution", "data_share") else np.inf)
        values = np.stack([unknown if bars is None else getattr(getattr(bars, part), name) for bars in barred])
        values[np.isnan(cells)] = np.nan
        return values

    ends = [change * np.exp(-stacked("change", "below")), change * np.exp(stacked("change", "above"))]
    columns = {
        "cell_resistance_errors": cells * stacked("frame", "deviation"),
        "cell_resistance_lower": cells * np.exp(-stacked("frame", "below")),
        "cell_resistance_upper": cells * np.exp(stacked("frame", "above")),
        "relative_change_errors": 100 * change * stacked("change", "deviation"),
        "relative_change_lower": 100 * (ends[0] - 1),
        "relative_change_upper": 100 * (ends[1] - 1),
        "resolution": stacked("frame", "resolution"),
        "data_share": stacked("frame", "data_share"),
        "baseline_resistance_errors": found.baseline_resistance * found.baseline_bars.deviation,
        "error_bar_time": np.array([step.bars_seconds for step in found.steps]),
    }
    pressure = pressure_of(change, ends[0], ends[1], found.recording.scene)
    return columns | {
        "pressure": pressure.pressure,
        "pressure_errors": pressure.errors,
        "pressure_lower": pressure.lower,
        "pressure_upper": pressure.upper,
        "saturated": pressure.saturated,
    }


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold the folder for one run. Raises InputError where it cannot be written or another run holds it."""
    lock = folder / ".lock"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = lock.open("w")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{folder}: another run is using this folder") from error
        yield


def _clear(folder: Path, tasks: Sequence[Task]) -> None:
    """Remove the results of these tasks, and what processes that were killed have left unfinished."""
    for file in (*(folder / "cases").glob(".*.part"), *(task.file for task in tasks)):
        file.unlink(missing_ok=True)


def _result(task: Task) -> CaseResult | None:
    """The case's result where it is there and readable; a damaged one is solved again."""
    if not task.file.is_file():
        return None
    try:
        return next((case for case in read_results(task.file).cases if case.case_id == task.case.case_id), None)
    except InputError:
        return None
