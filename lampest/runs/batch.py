"""Runs cases: finished ones are skipped, failures isolated, each result kept as a file of its own as it comes."""

import fcntl
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from pathlib import Path

from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.files.process import told_reason
from lampest.files.whole import inner_folder, opened_for_locking, output_folder, own, remove_own, sparing
from lampest.recording.stored import StoredRecording, opened
from lampest.runs.case import CaseResult, StoredCase
from lampest.runs.config import Case, Run, digest
from lampest.runs.executors import Executor, LostError, Pairs
from lampest.runs.filling import case_result
from lampest.runs.long_case import PartFiles, parts_to_solve, solve_long, solve_part, watched
from lampest.runs.results import read_results, stored_cases, write_results

RESULTS = "results.h5"
CASES = "cases"


@dataclass(frozen=True)
class Report:
    """How a batch went.

    results : the file, None where no case has a result. done, skipped : cases solved now and before. failed : (case,
    sentence). aside : where results of other cases went. not_run : cases without an executor to run them; lost : why.
    warnings : what speaks against the results, a line each.
    """

    results: Path | None
    done: int
    skipped: int
    failed: tuple[tuple[str, str], ...]
    aside: Path | None = None
    not_run: int = 0
    lost: str = ""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Task:
    """A case and the folder that takes its result."""

    case: Case
    folder: Path

    @property
    def file(self) -> Path:
        """Where the case's result is kept."""
        return self.folder / CASES / f"{self.case.case_id}.h5"


def run_batch(
    run: Run,
    folder: Path,
    executor: Executor,
    fresh: bool = False,
    on_case: Callable[[int, int], None] | None = None,
    on_long: Callable[[str], None] = lambda sentence: None,
) -> Report:
    """Solve the cases that have no result in `folder` yet, then write results.h5 with all that have one.

    on_case : gets how many of how many cases are done; on_long : every second, from another thread, how far those are
    that are run part by part. A case that fails costs no other; an interruption keeps what is finished. Raises
    InputError where the folder cannot be written, another run is using it, or its results would replace a recording.
    """
    executor.ready()
    with exclusive(folder), sparing({case.path for case in run.cases}):
        own(folder / RESULTS)
        own(folder / CASES)
        tasks = [Task(case, folder.absolute()) for case in run.cases]
        _clear(folder, tasks, fresh)
        found: dict[Path, CaseResult | StoredCase] = {
            task.file: result for task in tasks if (result := _result(task)) is not None
        }
        waiting = [task for task in tasks if task.file not in found]
        failed: list[tuple[str, str]] = []
        aside: Path | None = None
        lost = ""
        try:
            with closing(_outcomes(executor, waiting, on_long)) as outcomes:
                for finished, (task, outcome) in enumerate(outcomes, 1):
                    if isinstance(outcome, BaseException):
                        name = f"{task.case.recording} × {task.case.name}"
                        failed.append((name, told_reason(outcome, name)))
                    else:
                        found[task.file] = outcome
                    if on_case:
                        on_case(finished, len(waiting))
        except LostError as error:
            lost = str(error)
        finally:
            _clear(folder, tasks, fresh=False)
            done = [result for task in tasks if (result := found.get(task.file) or _result(task)) is not None]
            if done:
                aside = _put_aside(folder / RESULTS, done)
                write_results(folder / RESULTS, done, run.published)
        skipped = len(tasks) - len(waiting)
        not_run = len(tasks) - len(done) - len(failed) if lost else 0
        solved = len(waiting) - len(failed) - not_run
        warnings = dict.fromkeys(
            f"{case.recording}: {line}"
            for case in done
            if isinstance(case, CaseResult)
            for line in case.warnings.split("\n")
            if line
        )
        results = folder / RESULTS if done else None
        return Report(results, solved, skipped, tuple(failed), aside, not_run, lost, tuple(warnings))


def _outcomes(executor: Executor, waiting: Sequence[Task], on_long: Callable[[str], None]) -> Pairs:
    """What becomes of every case; of those too long for memory all parts are solved first."""
    with ExitStack() as stack:
        stack.enter_context(watched([(task.case, task.file) for task in waiting], on_long))
        long = [(task, task.case.stored) for task in waiting if task.case.stored is not None]
        parts = [(task, n) for task, stored in long for n in parts_to_solve(task.case, stored, task.file)]
        if parts:  # what becomes of them shows when their cases are put together
            deque(stack.enter_context(closing(executor.results(solve_part_of, parts))), maxlen=0)
        yield from stack.enter_context(closing(executor.results(solve_case, waiting)))


def _put_aside(path: Path, done: Sequence[CaseResult | StoredCase]) -> Path | None:
    """Give a file that holds other cases, or is no results file, another name: results_1.h5 and so on; returns it."""
    if path.is_symlink() or not path.is_file():
        return None
    with suppress(InputError):
        if {case.case_id for case in stored_cases(path)} <= {case.case_id for case in done}:
            return None
    names = (path.with_name(f"{path.stem}_{number}{path.suffix}") for number in count(1))
    return path.rename(next(name for name in names if not os.path.lexists(name)))


def solve_part_of(part: tuple[Task, int]) -> None:
    """Solve one part of a case that is too long for memory."""
    task, number = part
    recording = _recording(task.case.path, task.case.sha256)
    if isinstance(recording, StoredRecording):
        solve_part(task.case, recording, task.file, number)


def solve_case(task: Task) -> CaseResult | StoredCase:
    """Solve one case and write its result, whole or not at all."""
    recording = _recording(task.case.path, task.case.sha256)
    inner_folder(task.folder, CASES)
    if isinstance(recording, StoredRecording):
        return solve_long(task.case, recording, task.file)
    result = case_result(task.case, reconstruct(recording, task.case.estimator))
    inner_folder(task.folder, CASES)  # it may have become a link meanwhile
    write_results(task.file, [result])
    return result


@lru_cache(maxsize=1)
def _recording(path: Path, sha256: str) -> Prepared | StoredRecording:
    """A recording, read and prepared once for successive cases. Raises InputError where it was replaced meanwhile."""
    recording = opened(path)
    if digest(path) != sha256:
        raise InputError(f"{path}: was replaced after the run began; run again")
    return recording if isinstance(recording, StoredRecording) else Prepared(recording)


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold the folder for one run. Raises InputError where it cannot be written or another run holds it."""
    inner_folder(output_folder(folder), CASES)
    try:
        descriptor = opened_for_locking(folder / ".lock", make=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error
    with os.fdopen(descriptor) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{folder}: another run is using this folder") from error
        yield


def _clear(folder: Path, tasks: Sequence[Task], fresh: bool) -> None:
    """Remove what killed processes left of these tasks unfinished, and their results where they are solved afresh."""
    wholes = {RESULTS, *(task.file.name for task in tasks)}
    for unfinished in (*folder.glob(".*.part"), *(folder / CASES).glob(".*.part")):
        if unfinished.name[1:].rsplit(".", 2)[0] in wholes:
            remove_own(unfinished)
    for task in tasks if fresh else ():
        remove_own(task.file)
        PartFiles.beside(task.case, task.file).clear()


def _result(task: Task) -> CaseResult | StoredCase | None:
    """The case's result where it is there and readable; a damaged one is solved again.

    One of a recording that is too long for memory stays where it is.
    """
    with suppress(InputError, ValueError):
        if task.file.is_file():
            [held] = stored_cases(task.file) if task.case.stored else read_results(task.file).cases
            return held if held.case_id == task.case.case_id else None
    return None
