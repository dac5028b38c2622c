"""Batches of cases.

Finished ones are skipped, failures are isolated, each result is a file of its own. A recording that
fits into memory is solved as a whole, or, where its frames depend on no earlier ones, in segments
that several workers solve. A longer one is solved part by part. Each part has a results file of its
own, and until the last part is done a second file with the memory for later frames.
"""

import fcntl
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from pathlib import Path

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.parts import Parts, asked_frames
from lampest.estimate.sequence import MeasuredPart, begun_as, reconstruct, segments
from lampest.estimate.state import Step
from lampest.estimate.stream import CarriedOver, Stream
from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.process import ONE_BLAS_THREAD, logged_reason
from lampest.files.whole import (
    inner_folder,
    opened_for_locking,
    output_folder,
    own,
    remove_own,
    sparing,
)
from lampest.inference.prepared import Prepared
from lampest.panel.estimated import about_recordings
from lampest.recording.recording import Recording
from lampest.recording.stored import StoredRecording, opened
from lampest.runs.case import StoredCase
from lampest.runs.checks import (
    CASES,
    Checks,
    CheckTask,
    RecordingCheck,
    check_folder,
    without_check,
)
from lampest.runs.config import Case, Run
from lampest.runs.executors import Executor, LostError, Pairs
from lampest.runs.filling import case_result
from lampest.runs.provenance import digest
from lampest.runs.results import (
    join_case,
    read_case_scene,
    stored_cases,
    write_results,
)

RESULTS = "results.h5"
CARRIED = "carried/3"
# Between two counts of finished frames; least time between two files of these frames.
EVERY_SECONDS = 1.0
MAX_RECORDINGS = 2  # prepared ones that a process keeps, for checks that follow all cases
KEPT_SHARE = 0.05  # largest share of a case's time for these files


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


@dataclass(frozen=True)
class Task:
    """A case, the folder that takes its result, and whether a long recording is checked with it."""

    case: Case
    folder: Path
    checked: bool = True

    @property
    def file(self) -> Path:
        """File of the result."""
        return self.folder / CASES / f"{self.case.case_id}.h5"

    @property
    def unfinished(self) -> Path:
        """File of the finished frames while the case is solved."""
        return self.folder / CASES / f".{self.case.case_id}_unfinished.h5"

    @property
    def counts(self) -> list[Path]:
        """Files whose sizes in bytes are the numbers of finished frames of the segments.

        The size is valid even while it is written.
        """
        return [self.count(number) for number in range(self.case.segments)]

    def count(self, number: int) -> Path:
        """Return the file that counts the finished frames of a segment."""
        return self.folder / CASES / f".{self.case.case_id}_{number}.frames"

    @property
    def frames_done(self) -> int:
        """Number of finished frames, also of a case that another process solves."""
        if self.file.is_file():
            return self.case.frames
        with suppress(OSError, InputError):
            if self.case.stored is None:
                return sum(count.stat().st_size for count in self.counts if count.is_file())
            # A part in which no frame is measured has no file.
            return min(self.case.frames, len(self.whole_parts) * self.case.stored.length)
        return 0

    @property
    def parts(self) -> Path:
        """Folder of the parts of a long case.

        Raises InputError if it is a link to a place outside.
        """
        return inner_folder(self.file.parent, f"{self.case.case_id}.parts")

    def part(self, number: int) -> Path:
        """Return the file of a part's estimates."""
        return self.parts / f"{number:06d}.h5"

    def carried(self, number: int) -> Path:
        """Return the file of the memory for the next part; it is written before the estimates."""
        return self.parts / f"{number:06d}_carried.h5"

    @property
    def whole_parts(self) -> list[int]:
        """Numbers of the parts with estimates."""
        return sorted(int(file.stem) for file in self.parts.glob("[0-9]" * 6 + ".h5"))

    def carried_over(self, number: int) -> CarriedOver | None:
        """Return the memory after a part; None if it is incomplete.

        An incomplete part is solved again.
        """
        with suppress(InputError):
            hdf5.checked(self.part(number))
            [held] = stored_cases(self.part(number))
            if held.case_id == self.case.case_id:
                return read_carried(self.carried(number))
        return None

    def write_parts(self, solved: Iterable[tuple[int, Estimates, CarriedOver]]) -> Iterator[int]:
        """Write parts as they are solved; yield their numbers."""
        for number, estimates, carried in solved:
            write_carried(self.carried(number), carried)
            write_results(
                self.part(number), [case_result(self.case, estimates, checked=self.checked)]
            )
            yield number

    def clear_parts(self) -> None:
        """Remove the case's own files from the folder of its parts, and nothing else."""
        for pattern in ("*.h5", ".*.h5.*.part"):
            for file in self.parts.glob(pattern):
                remove_own(file)
        with suppress(OSError):
            self.parts.rmdir()


@dataclass(frozen=True)
class CaseSegment:
    """A segment of a case, which is solved as a task of its own."""

    task: Task
    number: int


def run_batch(
    run: Run,
    folder: Path,
    executor: Executor,
    *,
    fresh: bool = False,
    on_frames: Callable[[int, int], None] = lambda done, frames: None,
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
        Receives the numbers of solved and of all frames at the beginning, and then every second
        from another thread.
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
            remove_own(check.file)
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
            with _counted(waiting, on_frames), closing(outcomes):
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
                        _write_segments(task, solved[task.file], task.unfinished)
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
            warnings=(*_different_warnings(cases), *_unchecked(checked)),
            advice=tuple(
                dict.fromkeys((case.recording, case.advice) for case in cases if case.advice)
            ),
            estimated=about_recordings(
                (case.recording, read_case_scene(case).estimated)
                for case, previous in zip(cases, (None, *cases), strict=False)
                if previous is None or previous.recording != case.recording
            ),
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
    results: list[StoredCase] = []
    for case in cases:
        check = checked.get(case.recording)
        results.append(check.apply_to(case) if isinstance(check, RecordingCheck) else case)
    return results


def _unchecked(checked: Mapping[str, RecordingCheck | BaseException | None]) -> Iterator[str]:
    """Yield warnings of checks that failed."""
    for recording, outcome in checked.items():
        if isinstance(outcome, BaseException) and not isinstance(outcome, InputError):
            reason = logged_reason(outcome, recording)
            yield f"{recording}: the circuit was not checked: {reason}"


def _different_warnings(cases: Sequence[StoredCase]) -> tuple[str, ...]:
    """Return the different lines of warnings, each after its recording's name."""
    lines = list[str]()
    for case in cases:
        lines += [f"{case.recording}: {line}" for line in case.warnings.split("\n") if line]
    return tuple(dict.fromkeys(lines))


@contextmanager
def _counted(tasks: Sequence[Task], on_frames: Callable[[int, int], None]) -> Iterator[None]:
    """Call `on_frames` with the numbers of solved and of all frames.

    The calls are at the beginning, every second, and at the end. Progress is read from files,
    whichever process or machine solves the cases.
    """
    frames = sum(task.case.frames for task in tasks)
    ended = threading.Event()

    def report() -> None:
        on_frames(sum(task.frames_done for task in tasks), frames)

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
        parts = list[tuple[Task, int]]()
        for task in waiting:
            parts += [(task, number) for number in parts_to_solve(task)]
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
        return _write_segments(task, solved, task.file)
    except Exception as error:
        return error


def _write_segments(
    task: Task, solved: Mapping[int, Sequence[Step] | BaseException], file: Path
) -> StoredCase:
    """Write the estimates of the first segments of a case, up to one that is not solved."""
    prepared = _recording(task.case.path, task.case.sha256)
    assert isinstance(prepared, Prepared)
    steps = list[Step]()
    for number in range(task.case.segments):
        own = solved.get(number, RuntimeError())
        if isinstance(own, BaseException):
            break
        steps += own
    stream, frames = _begun(prepared, task.case.estimator)
    check_folder(task.folder / CASES)
    result = case_result(task.case, frames.estimates(stream, steps))
    write_results(file, [result])
    return StoredCase.of(result, file)


def solve_task(
    task: Task | CaseSegment | CheckTask,
) -> StoredCase | RecordingCheck | Sequence[Step]:
    """Solve a case or a segment of one, or check a recording and keep the outcome."""
    if isinstance(task, Task):
        return solve_case(task)
    if isinstance(task, CaseSegment):
        return solve_segment(task)
    # A run without a new check does not load the audit.
    from lampest.audit.advice import Audit

    prepared = _recording(task.path, task.sha256)
    assert isinstance(prepared, Prepared)
    check = RecordingCheck.of(Audit(prepared))
    task.keep(check)
    return check


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


def parts_to_solve(task: Task) -> list[int]:
    """Return the numbers of a long case's parts that may be solved in any order and are not done.

    Damaged parts are removed.
    """
    stored = task.case.stored
    previous = task.case.estimator.uses_previous
    blocks = () if stored is None or previous else stored.measured_blocks
    waiting = [number for number in blocks if task.carried_over(number) is None]
    for number in waiting:
        remove_own(task.part(number))
    return waiting


def solve_part(part: tuple[Task, int]) -> None:
    """Solve a part of a long case that does not depend on earlier ones."""
    task, number = part
    recording = _recording(task.case.path, task.case.sha256)
    if isinstance(recording, StoredRecording):
        parts = _parts(task.case.estimator, recording)
        # The other parts count as solved.
        solved = parts.estimates(lambda at: None if at == number else CarriedOver({}))
        for _ in task.write_parts(solved):
            pass


def solve_case(task: Task) -> StoredCase:
    """Solve a case and write its result atomically."""
    recording = _recording(task.case.path, task.case.sha256)
    check_folder(task.folder / CASES)
    if isinstance(recording, StoredRecording):
        return solve_long(task, recording)
    result = case_result(task.case, reconstruct(recording, task.case.estimator, _kept_frames(task)))
    check_folder(task.folder / CASES)
    write_results(task.file, [result])
    return StoredCase.of(result, task.file)


@ONE_BLAS_THREAD
def solve_segment(segment: CaseSegment) -> list[Step]:
    """Solve a segment of a case; return the steps of its frames.

    If frames turn out to depend on earlier ones, the first segment has all of them.
    """
    task = segment.task
    prepared = _recording(task.case.path, task.case.sha256)
    assert isinstance(prepared, Prepared)
    check_folder(task.folder / CASES)
    stream, frames = _begun(prepared, task.case.estimator)
    several = segments(stream, len(frames.frames))
    if segment.number >= len(several):
        return []
    own = several[segment.number]
    on_frame = _kept_frames(task, segment.number)
    steps = list[Step]()
    for _, step in frames.segment_steps(stream, own):
        steps.append(step)
        on_frame(len(steps), len(own), None)
    return steps


@lru_cache(maxsize=1)  # a process solves several segments of a case
def _begun(prepared: Prepared, estimator: Estimator) -> tuple[Stream, MeasuredPart[Estimates]]:
    return begun_as(Estimates, prepared, estimator)


def solve_long(task: Task, stored: StoredRecording) -> StoredCase:
    """Solve a case part by part from its first unfinished part, and write its result atomically."""
    solved = list[int]()
    stored_parts = set(task.whole_parts)
    if task.case.estimator.uses_previous or not set(stored.measured_blocks) <= stored_parts:
        parts = _parts(task.case.estimator, stored)
        # Files after a newly solved part depend on another state and are solved again, unless parts
        # are independent.
        waiting = parts.estimates(
            lambda at: None if solved and not parts.independent else task.carried_over(at)
        )
        for number in task.write_parts(waiting):
            solved.append(number)
    join_case(task.file, [task.part(number) for number in task.whole_parts], task.case.recording)
    task.clear_parts()
    [result] = stored_cases(task.file)
    return result


@lru_cache(maxsize=1)  # a process solves several parts of a case
def _parts(estimator: Estimator, stored: StoredRecording) -> Parts:
    return Parts.of(stored, estimator, _asked(stored))


@lru_cache(maxsize=1)  # successive cases are often estimators of one recording
def _asked(stored: StoredRecording) -> tuple[Recording, Prepared]:
    return asked_frames(stored)


def write_carried(path: Path, carried: CarriedOver) -> None:
    """Write the memory after a part atomically.

    Raises InputError where the place cannot be written.
    """
    with hdf5.new_file(path) as file:
        hdf5.set_attributes(file, lampest_format=CARRIED)
        group = file.create_group("carried")
        for name, values in carried.arrays.items():
            unit = "ohm" if name.endswith("previous") else "1"
            hdf5.write_dataset(group, name, values, unit, name.replace("_", " "))


def read_carried(path: Path) -> CarriedOver:
    """Return the memory after a part. Raises InputError where it cannot be read."""
    with hdf5.existing_file(path) as file:
        if hdf5.read_attribute(file, "/", "lampest_format") != CARRIED:
            raise InputError(f"{path}: is not the remainder of a part of a case")
        names = hdf5.children(file, "/carried")
        return CarriedOver(
            {name: hdf5.read_array(file, f"/carried/{name}", (1, 2, 3, 4)) for name in names}
        )


def _kept_frames(
    task: Task, segment: int = 0
) -> Callable[[int, int, Callable[[], Estimates] | None], None]:
    """Return a function that counts the finished frames of a case and writes them at intervals.

    Those of a segment are counted alone.
    """
    counted = written = time.monotonic()
    pause = EVERY_SECONDS

    def on_frame(done: int, frames: int, so_far: Callable[[], Estimates] | None) -> None:
        nonlocal counted, written, pause
        now = time.monotonic()
        if now - counted >= EVERY_SECONDS or done == frames:
            counted = now
            with os.fdopen(opened_for_locking(task.count(segment), make=True), "rb+") as file:
                file.truncate(done)
        if so_far is not None and done < frames and now - written >= pause:
            check_folder(task.folder / CASES)
            write_results(task.unfinished, [case_result(task.case, so_far())])
            written = time.monotonic()
            pause = max(EVERY_SECONDS, (written - now) / KEPT_SHARE)

    return on_frame


@lru_cache(maxsize=MAX_RECORDINGS)
def _recording(path: Path, sha256: str) -> Prepared | StoredRecording:
    """Read and prepare a recording once for its cases and its check.

    Raises InputError if it was replaced meanwhile.
    """
    recording = opened(path)
    if digest(path) != sha256:
        raise InputError(f"{path}: was replaced after the run began; run again")
    return recording if isinstance(recording, StoredRecording) else Prepared(recording)


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
    results: dict[Path, StoredCase] = {}
    for task in tasks:
        file = task.unfinished if unfinished else task.file
        with suppress(InputError, ValueError):
            if not file.is_file():
                continue
            hdf5.checked(file)
            [case] = stored_cases(file)
            if case.case_id == task.case.case_id:
                results[task.file] = case
    return results
