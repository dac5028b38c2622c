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

import numpy as np

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
from lampest.panel.panel import Array
from lampest.runs.case import StoredCase
from lampest.runs.checks import (
    CASES,
    CheckTask,
    RecordingCheck,
    check_folder,
    without_check,
)
from lampest.runs.config import Case, Run
from lampest.runs.executors import Executor, LostError, Pairs, cores
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
        batch = _Batch(run, folder, fresh=fresh)
        if batch.to_check:
            on_checks(0, len(batch.to_check))
        try:
            outcomes = batch.outcomes(executor)
            workers = cores() if executor.concurrent else 1
            with _counted(batch.waiting, on_frames, workers), closing(outcomes):
                for task, outcome in outcomes:
                    batch.take(task, outcome)
                    if isinstance(task, CheckTask):
                        unfinished = sum(check is None for check in batch.checked.values())
                        on_checks(len(batch.to_check) - unfinished, len(batch.to_check))
        except LostError as error:
            batch.lost = str(error)
        finally:
            batch.write()
        return batch.report()


class _Batch:
    """Cases and checks of a run with their outcomes so far.

    Attributes
    ----------
    waiting : list of Task
        Cases without a result at the beginning.
    to_check : list of CheckTask
        Checks without an outcome at the beginning, of recordings that fit into memory and can be
        read.
    checked : dict
        Recording → outcome of its check, an exception, or None before it.
    finished : dict
        File → result.
    failed : list of (str, str)
        See `Report`.
    solved : dict
        File → steps of segments by number, until the case is complete.
    lost : str
        See `Report`.
    """

    def __init__(self, run: Run, folder: Path, *, fresh: bool) -> None:
        self._run = run
        self._folder = folder
        self._tasks = [Task(case, folder.absolute(), run.check == "all") for case in run.cases]
        checks = {
            case.recording: CheckTask(
                case.path, case.sha256, case.recording, folder.absolute() / CASES
            )
            for case in run.cases
            if run.check == "all" and case.stored is None and case.frames
        }
        self._clear(fresh=fresh)
        for check in checks.values() if fresh else ():
            check.forget()
        self.checked: dict[str, RecordingCheck | BaseException | None] = {
            name: check.kept() for name, check in checks.items()
        }
        self.to_check = [check for name, check in checks.items() if self.checked[name] is None]
        self.finished = dict[Path, StoredCase]()
        self.finished = self._stored()
        self.waiting = [task for task in self._tasks if task.file not in self.finished]
        self.failed = list[tuple[str, str]]()
        self.solved = {task.file: dict[int, Sequence[Step]]() for task in self.waiting}
        self.lost = ""

    def _stored(self, *, unfinished: bool = False) -> dict[Path, StoredCase]:
        """Return the results by file, with intact ones of the cases that have not finished.

        A damaged one is solved again. `unfinished` takes the finished frames of these cases.
        """
        results = dict(self.finished)
        for task in self._tasks:
            if task.file not in results:
                case = task.intact(task.unfinished if unfinished else task.file)
                results |= {task.file: case} if case else {}
        return results

    def outcomes(self, executor: Executor) -> Pairs:
        """Return the outcomes of all cases, then those of the checks.

        The parts of cases that exceed the memory are solved first.
        """
        with ExitStack() as stack:
            parts = [(task, number) for task in self.waiting for number in parts_to_solve(task)]
            if parts:  # failures of parts show when their cases are joined
                deque(stack.enter_context(closing(executor.results(solve_part, parts))), maxlen=0)
            tasks: list[Task | CaseSegment | CheckTask] = []
            for task in self.waiting:
                divided = executor.concurrent and task.case.segments > 1
                numbers = range(task.case.segments)
                tasks += [CaseSegment(task, number) for number in numbers] if divided else [task]
            tasks += self.to_check
            for task, outcome in stack.enter_context(closing(executor.results(solve_task, tasks))):
                if not isinstance(task, CaseSegment):
                    yield task, outcome
                    continue
                steps = self.solved[task.task.file]
                steps[task.number] = outcome
                if len(steps) == task.task.case.segments:
                    yield task.task, _joined(task.task, steps)
                    steps.clear()

    def take(self, task: Task | CheckTask, outcome: Any) -> None:
        """Note the outcome of a case or a check."""
        if isinstance(outcome, BaseException):
            check_folder(self._folder / CASES)
        if isinstance(task, CheckTask):
            self.checked[task.recording] = outcome
        elif isinstance(outcome, BaseException):
            name = f"{task.case.recording} × {task.case.name}"
            self.failed.append((name, logged_reason(outcome, name)))
        else:
            self.finished[task.file] = outcome

    def write(self) -> None:
        """Write all results, with the checks of their recordings as far as these are finished.

        Unfinished cases have their finished frames.
        """
        for task in self.waiting:
            if self.solved[task.file]:
                with suppress(InputError):
                    write_segments(task, self.solved[task.file], task.unfinished)
        self.finished = self._stored()
        results = self._stored(unfinished=True)
        self.cases = []
        for case in (results[task.file] for task in self._tasks if task.file in results):
            check = self.checked.get(case.recording)
            if self._run.check == "none":
                case = without_check(case)
            elif isinstance(check, RecordingCheck):
                case = check.apply_to(case)
            self.cases.append(case)
        self.aside = None
        if self.cases:
            self.aside = _put_aside(self._folder / RESULTS, self.cases)
            write_results(self._folder / RESULTS, self.cases, self._run.published)
        self._clear(fresh=False)

    def report(self) -> Report:
        """Return the outcome, each warning, advice and estimated number once."""
        warnings = [
            f"{case.recording}: {line}"
            for case in self.cases
            for line in case.warnings.split("\n")
            if line
        ]
        warnings += [
            f"{recording}: the circuit was not checked: {logged_reason(outcome, recording)}"
            for recording, outcome in self.checked.items()
            if isinstance(outcome, BaseException) and not isinstance(outcome, InputError)
        ]
        advice = ((case.recording, case.advice) for case in self.cases if case.advice)
        first = {case.recording: case for case in reversed(self.cases)}
        not_run = len(self._tasks) - len(self.finished) - len(self.failed) if self.lost else 0
        return Report(
            results=self._folder / RESULTS if self.cases else None,
            done=len(self.waiting) - len(self.failed) - not_run,
            skipped=len(self._tasks) - len(self.waiting),
            failed=tuple(self.failed),
            aside=self.aside,
            not_run=not_run,
            lost=self.lost,
            warnings=tuple(dict.fromkeys(warnings)),
            advice=tuple(dict.fromkeys(advice)),
            estimated=about_recordings(
                (name, read_case_scene(case).estimated) for name, case in reversed(first.items())
            ),
        )

    def _clear(self, *, fresh: bool) -> None:
        """Remove unfinished files of these cases that killed processes left.

        The flag `fresh` also removes their results.
        """
        wholes = {RESULTS, *(task.file.name for task in self._tasks)}
        folders = (self._folder, self._folder / CASES)
        for unfinished in (file for folder in folders for file in folder.glob(".*.part")):
            if unfinished.name[1:].rsplit(".", 2)[0] in wholes:
                remove_own(unfinished)
        for task in self._tasks:
            for file in (*task.counts, task.unfinished, *([task.file] if fresh else [])):
                remove_own(file)
            if fresh:
                task.clear_parts()


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


@dataclass(frozen=True)
class Pace:
    """Time that the cases of a batch have taken so far.

    Attributes
    ----------
    cases : sequence of Case
    done : tuple of int
        Number of finished frames of each case.
    timed : array, shape (cases,)
        Number of those of known time: the first ones of a case end with its preparation.
    seconds : array, shape (cases,)
        Time of these, s. The time between two counts is shared by the cases that have advanced.
    counted : float
        Clock when a case advanced last, s.
    """

    cases: Sequence[Case]
    done: tuple[int, ...]
    timed: Array
    seconds: Array
    counted: float

    @classmethod
    def begun(cls, cases: Sequence[Case], now: float) -> "Pace":
        """Return the pace before the first frame; `now` is the clock in s."""
        none = np.zeros(len(cases))
        return cls(cases, (0,) * len(cases), none, none, now)

    def after(self, done: Sequence[int], now: float) -> "Pace":
        """Return the pace at a count of the finished frames of each case."""
        frames = np.maximum(np.subtract(done, self.done), 0)
        if not frames.any():
            return self
        share = (now - self.counted) / np.count_nonzero(frames)
        begun = np.greater(self.done, 0)
        timed = self.timed + frames * begun
        seconds = self.seconds + share * (begun & (frames > 0))
        return Pace(self.cases, tuple(done), timed, seconds, now)

    def left_s(self, workers: int) -> float:
        """Return the remaining time in s.

        A frame takes the measured time of its estimator on panels of this size. Before any is
        measured it takes the expected one, multiplied by the ratio of measured to expected times of
        the other estimators; without those, divided by the number of workers.
        """
        labels = [f"{case.name} {case.cells}" for case in self.cases]
        _, kind = np.unique(labels, return_inverse=True)
        timed, seconds = (np.bincount(kind, part)[kind] for part in (self.timed, self.seconds))
        frame_seconds = np.array([case.frame_seconds for case in self.cases])
        expected = self.timed @ frame_seconds
        ratio = self.seconds.sum() / expected if expected else 1 / workers
        of_frame = np.where(timed > 0, seconds / np.maximum(timed, 1), frame_seconds * ratio)
        return float(np.subtract([case.frames for case in self.cases], self.done) @ of_frame)
