"""Batches of cases.

Finished cases are skipped, failures are isolated, and each result is a file of its own, see
`lampest.runs.task`.
"""

import fcntl
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from lampest.estimate.state import Step
from lampest.files.errors import InputError
from lampest.files.process import logged_reason
from lampest.files.whole import (
    inner_folder,
    opened_for_locking,
    output_folder,
    own,
    remove_own,
    sparing,
)
from lampest.inference.estimated import about_recordings
from lampest.runs.case import StoredCase
from lampest.runs.checks import (
    CASES,
    Checks,
    CheckTask,
    RecordingCheck,
    check_folder,
    without_check,
)
from lampest.runs.config import Run
from lampest.runs.executors import Executor, LostError, Pairs, cores
from lampest.runs.pace import Pace
from lampest.runs.results import read_case_scene, stored_cases, write_results
from lampest.runs.task import (
    EVERY_SECONDS,
    CaseSegment,
    Task,
    parts_to_solve,
    solve_part,
    solve_task,
    write_segments,
)

RESULTS = "results.h5"


@dataclass(frozen=True)
class Report:
    """Outcome of a batch.

    Attributes
    ----------
    results : Path or None
        The results file; None if no case has a result.
    done, skipped : int
        Numbers of cases solved now and before.
    failed : tuple of (str, str)
        Case and reason.
    aside : Path or None
        New name of a file with results of other cases.
    not_run : int
        Number of cases that no executor ran.
    lost : str
        Why none ran them; '' if all were run.
    warnings, estimated : tuple of str
        Warnings about the results, and the numbers that recordings determined, each behind the
        recording's name.
    advice : tuple of (str, str)
        Recording, and advice on its scene, as `StoredCase` has it.
    """

    results: Path | None
    done: int
    skipped: int
    failed: tuple[tuple[str, str], ...]
    aside: Path | None = None
    not_run: int = 0
    lost: str = ""
    warnings: tuple[str, ...] = ()
    advice: tuple[tuple[str, str], ...] = ()
    estimated: tuple[str, ...] = ()


def run_batch(
    run: Run,
    folder: Path,
    executor: Executor,
    *,
    fresh: bool = False,
    on_frames: Callable[..., None] = lambda done, frames, left_s: None,
    on_checks: Callable[[int, int], None] = lambda done, checks: None,
) -> Report:
    """Solve the cases without a result in `folder`, then write results.h5 with all results.

    Failed cases do not affect other cases. An interruption keeps finished cases, and the first
    finished frames, or segments, of running ones. Circuits are checked last, once a recording,
    unless an earlier run in this folder did; a recording that is too long for memory is checked
    with its cases.

    Parameters
    ----------
    run : Run
    folder : Path
    executor : Executor
    fresh : bool
        Whether finished cases are solved again.
    on_frames : callable
        Receives the numbers of solved and of all frames, and as `left_s` the remaining time in s,
        at the beginning, and then every second from another thread.
    on_checks : callable
        Receives the numbers of finished and of all checks.

    Raises
    ------
    InputError
        If the folder cannot be written, is used by another run, or holds a recording under the name
        of the results.
    """
    executor.ready()
    with exclusive(folder), sparing({case.path for case in run.cases}):
        own(folder / RESULTS)
        own(folder / CASES)
        tasks = [Task(case, folder.absolute(), run.check == "all") for case in run.cases]
        checks = _checks(tasks)
        _clear(folder, tasks, fresh=fresh)
        for check in checks if fresh else ():
            check.forget()
        checked = {check.recording: check.kept() for check in checks}
        to_check = [check for check in checks if checked[check.recording] is None]
        finished = _results(tasks)
        waiting = [task for task in tasks if task.file not in finished]
        failed: list[tuple[str, str]] = []
        solved = {task.file: dict[int, Sequence[Step]]() for task in waiting}
        lost = ""
        if to_check:
            on_checks(0, len(to_check))
        try:
            outcomes = _outcomes(executor, waiting, to_check, solved)
            workers = cores() if executor.concurrent else 1
            with _counted(waiting, on_frames, workers), closing(outcomes):
                for task, outcome in outcomes:
                    if isinstance(outcome, BaseException):
                        check_folder(folder / CASES)
                    if isinstance(task, CheckTask):
                        checked[task.recording] = outcome
                        unfinished = sum(check is None for check in checked.values())
                        on_checks(len(to_check) - unfinished, len(to_check))
                    elif isinstance(outcome, BaseException):
                        name = f"{task.case.recording} × {task.case.name}"
                        failed.append((name, logged_reason(outcome, name)))
                    else:
                        finished[task.file] = outcome
        except LostError as error:
            lost = str(error)
        finally:
            for task in waiting:
                if solved[task.file]:
                    with suppress(InputError):
                        write_segments(task, solved[task.file], task.unfinished)
            finished |= _results([task for task in tasks if task.file not in finished])
            cases = _with_checks(_with_unfinished(tasks, finished), checked, run.check)
            aside = None
            if cases:
                aside = _put_aside(folder / RESULTS, cases)
                write_results(folder / RESULTS, cases, run.published)
            _clear(folder, tasks, fresh=False)
        not_run = len(tasks) - len(finished) - len(failed) if lost else 0
        return Report(
            results=folder / RESULTS if cases else None,
            done=len(waiting) - len(failed) - not_run,
            skipped=len(tasks) - len(waiting),
            failed=tuple(failed),
            aside=aside,
            not_run=not_run,
            lost=lost,
            **_findings(cases, checked),
        )


def _with_unfinished(
    tasks: Sequence[Task], finished: Mapping[Path, StoredCase]
) -> list[StoredCase]:
    """Return the results of all cases in order; unfinished cases have their finished frames."""
    unfinished = _results([task for task in tasks if task.file not in finished], unfinished=True)
    results = {**finished, **unfinished}
    return [results[task.file] for task in tasks if task.file in results]


def _checks(tasks: Sequence[Task]) -> list[CheckTask]:
    """Return the checks of the recordings that fit into memory and can be read."""
    checks = {
        task.case.recording: CheckTask(
            task.case.path, task.case.sha256, task.case.recording, task.folder / CASES
        )
        for task in tasks
        if task.checked and task.case.stored is None and task.case.frames
    }
    return list(checks.values())


def _with_checks(
    cases: Sequence[StoredCase],
    checked: Mapping[str, RecordingCheck | BaseException | None],
    which: Checks,
) -> list[StoredCase]:
    """Return the results with the checks of their recordings, as far as these are finished."""
    if which == "none":
        return [without_check(case) for case in cases]
    known = {name: each for name, each in checked.items() if isinstance(each, RecordingCheck)}
    return [
        known[case.recording].apply_to(case) if case.recording in known else case for case in cases
    ]


def _findings(
    cases: Sequence[StoredCase], checked: Mapping[str, RecordingCheck | BaseException | None]
) -> dict[str, Any]:
    """Return warnings, advice and estimated numbers of a report by field, each line once."""
    warnings = [
        f"{case.recording}: {line}" for case in cases for line in case.warnings.split("\n") if line
    ]
    warnings += [
        f"{recording}: the circuit was not checked: {logged_reason(outcome, recording)}"
        for recording, outcome in checked.items()
        if isinstance(outcome, BaseException) and not isinstance(outcome, InputError)
    ]
    first: dict[str, StoredCase] = {}
    for case in cases:
        first.setdefault(case.recording, case)
    advice = ((case.recording, case.advice) for case in cases if case.advice)
    return {
        "warnings": tuple(dict.fromkeys(warnings)),
        "advice": tuple(dict.fromkeys(advice)),
        "estimated": about_recordings(
            (name, read_case_scene(case).estimated) for name, case in first.items()
        ),
    }


@contextmanager
def _counted(tasks: Sequence[Task], on_frames: Callable[..., None], workers: int) -> Iterator[None]:
    """Call `on_frames` with the numbers of solved and of all frames, and the remaining time.

    The calls are at the beginning, every second, and at the end. Progress is read from files,
    whichever process or machine solves the cases.
    """
    frames = sum(task.case.frames for task in tasks)
    ended = threading.Event()
    pace = Pace.begun([task.case for task in tasks], time.monotonic())

    def report() -> None:
        nonlocal pace
        pace = pace.after([task.frames_done for task in tasks], time.monotonic())
        on_frames(sum(pace.done), frames, left_s=pace.left_s(workers))

    def watch() -> None:
        while not ended.wait(EVERY_SECONDS):
            report()

    report()
    thread = threading.Thread(target=watch, daemon=True)
    with suppress(RuntimeError):  # no further thread can be started: only the end is reported
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()
        report()


def _outcomes(
    executor: Executor,
    waiting: Sequence[Task],
    checks: Sequence[CheckTask],
    solved: Mapping[Path, dict[int, Sequence[Step]]],
) -> Pairs:
    """Return the outcomes of all cases, then those of the checks.

    The parts of cases that exceed the memory are solved first. `solved` takes the steps of segments
    of each case, until the case is complete.
    """
    with ExitStack() as stack:
        parts = [(task, number) for task in waiting for number in parts_to_solve(task)]
        if parts:  # failures of parts show when their cases are joined
            deque(stack.enter_context(closing(executor.results(solve_part, parts))), maxlen=0)
        tasks: list[Task | CaseSegment | CheckTask] = []
        for task in waiting:
            divided = executor.concurrent and task.case.segments > 1
            numbers = range(task.case.segments)
            tasks += [CaseSegment(task, number) for number in numbers] if divided else [task]
        tasks += checks
        for task, outcome in stack.enter_context(closing(executor.results(solve_task, tasks))):
            if not isinstance(task, CaseSegment):
                yield task, outcome
                continue
            steps = solved[task.task.file]
            steps[task.number] = outcome
            if len(steps) == task.task.case.segments:
                yield task.task, _joined(task.task, steps)
                steps.clear()


def _joined(
    task: Task, solved: Mapping[int, Sequence[Step] | BaseException]
) -> StoredCase | BaseException:
    """Write the result of a case whose segments are solved; return it, or the first exception."""
    for outcome in solved.values():
        if isinstance(outcome, BaseException):
            return outcome
    try:
        return write_segments(task, solved, task.file)
    except Exception as error:
        return error


def _put_aside(path: Path, done: Sequence[StoredCase]) -> Path | None:
    """Rename a file of other cases, or of another format; return the new name.

    The new names are results_1.h5 and so on.
    """
    if path.is_symlink() or not path.is_file():
        return None
    with suppress(InputError):
        if {case.case_id for case in stored_cases(path)} <= {case.case_id for case in done}:
            return None
    names = (path.with_name(f"{path.stem}_{number}{path.suffix}") for number in count(1))
    return path.rename(next(name for name in names if not os.path.lexists(name)))


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Lock the folder for one run, with a folder of its cases.

    Raises InputError if it cannot be written or another run uses it.
    """
    cases = inner_folder(output_folder(folder), CASES)
    try:
        descriptor = opened_for_locking(folder / ".lock", make=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error
    with os.fdopen(descriptor) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{folder}: another run is using this folder") from error
        try:
            cases.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error.strerror})") from error
        yield


def _clear(folder: Path, tasks: Sequence[Task], *, fresh: bool) -> None:
    """Remove unfinished files of these tasks that killed processes left.

    The flag `fresh` also removes the results of these tasks.
    """
    wholes = {RESULTS, *(task.file.name for task in tasks)}
    for unfinished in (*folder.glob(".*.part"), *(folder / CASES).glob(".*.part")):
        if unfinished.name[1:].rsplit(".", 2)[0] in wholes:
            remove_own(unfinished)
    for task in tasks:
        for file in (*task.counts, task.unfinished):
            remove_own(file)
    for task in tasks if fresh else ():
        remove_own(task.file)
        task.clear_parts()


def _results(tasks: Sequence[Task], *, unfinished: bool = False) -> dict[Path, StoredCase]:
    """Return the intact results by file; cases with a damaged one are solved again.

    Parameters
    ----------
    tasks : sequence of Task
    unfinished : bool
        Whether to read the files of the finished frames of unfinished cases.
    """
    results = {}
    for task in tasks:
        if case := task.intact(task.unfinished if unfinished else task.file):
            results[task.file] = case
    return results
