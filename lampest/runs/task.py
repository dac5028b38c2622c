"""Cases as tasks: the files of each, and the solves that write them.

A recording that fits into memory is solved as a whole, or, where its frames depend on no earlier
ones, in segments that several workers solve. A longer one is solved part by part. Each part has a
results file of its own, and until the last part is done a second file with the memory for later
frames.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import Parts, asked_frames, begun, reconstruct, segments
from lampest.estimate.state import Step
from lampest.estimate.stream import CarriedOver
from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.files.whole import inner_folder, opened_for_locking, remove_own
from lampest.inference.prepared import Prepared
from lampest.recording.stored import StoredRecording, opened
from lampest.runs.case import StoredCase
from lampest.runs.checks import CASES, CheckTask, RecordingCheck, check_folder
from lampest.runs.config import Case
from lampest.runs.filling import case_result
from lampest.runs.provenance import digest
from lampest.runs.results import join_case, stored_cases, write_results

CARRIED = "carried/3"
# Between two counts of finished frames; least time between two files of these frames.
EVERY_SECONDS = 1.0
MAX_RECORDINGS = 2  # prepared ones that a process keeps, for checks that follow all cases
KEPT_SHARE = 0.05  # largest share of a case's time for these files
_begun = lru_cache(maxsize=1)(begun)  # a process solves several segments of a case
# Successive cases are often estimators of one recording.
_asked_frames = lru_cache(maxsize=1)(asked_frames)


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
            if self.intact(self.part(number)):
                with hdf5.existing_file(self.carried(number)) as file:
                    if hdf5.read_attribute(file, "/", "lampest_format") == CARRIED:
                        return {
                            name: hdf5.read_array(file, f"/carried/{name}", (1, 2, 3, 4))
                            for name in hdf5.children(file, "/carried")
                        }
        return None

    def intact(self, file: Path) -> StoredCase | None:
        """Return the case in a file; None for a missing or damaged file, and for another case."""
        with suppress(InputError, ValueError):
            hdf5.checked(file)
            [held] = stored_cases(file)
            if held.case_id == self.case.case_id:
                return held
        return None

    def write(self, file: Path, estimates: Estimates) -> StoredCase:
        """Write estimates of the case atomically. Raises InputError as `check_folder`."""
        result = case_result(self.case, estimates)
        check_folder(self.folder / CASES)
        write_results(file, [result])
        return stored_cases(file)[0]

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
        for file in (*self.parts.glob("*.h5"), *self.parts.glob(".*.h5.*.part")):
            remove_own(file)
        with suppress(OSError):
            self.parts.rmdir()


@dataclass(frozen=True)
class CaseSegment:
    """A segment of a case, which is solved as a task of its own."""

    task: Task
    number: int


def write_segments(
    task: Task, solved: Mapping[int, Sequence[Step] | BaseException], file: Path
) -> StoredCase:
    """Write the estimates of the first segments of a case, up to one that is not solved."""
    prepared = _recording(task.case.path, task.case.sha256)
    assert isinstance(prepared, Prepared)
    steps = list[Step]()
    for number in range(task.case.segments):
        own = solved.get(number)
        if own is None or isinstance(own, BaseException):
            break
        steps += own
    stream, frames = _begun(prepared, task.case.estimator)
    return task.write(file, frames.estimates(stream, steps))


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


def parts_to_solve(task: Task) -> list[int]:
    """Return the numbers of a long case's parts that may be solved in any order and are not done.

    Damaged parts are removed.
    """
    stored = task.case.stored
    if stored is None or task.case.estimator.uses_previous:
        return []
    waiting = [number for number in stored.measured_blocks if task.carried_over(number) is None]
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
        list(task.write_parts(parts.estimates(lambda at: None if at == number else {})))


def solve_case(task: Task) -> StoredCase:
    """Solve a case and write its result atomically."""
    recording = _recording(task.case.path, task.case.sha256)
    check_folder(task.folder / CASES)
    if not isinstance(recording, StoredRecording):
        estimates = reconstruct(recording, task.case.estimator, _kept_frames(task))
        return task.write(task.file, estimates)
    # A long case is solved part by part from its first unfinished part.
    solved = list[int]()
    whole = {*recording.measured_blocks} <= {*task.whole_parts}
    if task.case.estimator.uses_previous or not whole:
        parts = _parts(task.case.estimator, recording)
        # Files after a newly solved part depend on another state and are solved again, unless parts
        # are independent.
        waiting = parts.estimates(
            lambda at: None if solved and not parts.independent else task.carried_over(at)
        )
        solved.extend(task.write_parts(waiting))
    join_case(task.file, [task.part(number) for number in task.whole_parts], task.case.recording)
    task.clear_parts()
    return stored_cases(task.file)[0]


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
    steps = []
    for _, step in frames.segment_steps(stream, own):
        steps.append(step)
        on_frame(len(steps), len(own), None)
    return steps


@lru_cache(maxsize=1)  # a process solves several parts of a case
def _parts(estimator: Estimator, stored: StoredRecording) -> Parts:
    return Parts.of(stored, estimator, _asked_frames(stored))


def write_carried(path: Path, carried: CarriedOver) -> None:
    """Write the memory after a part atomically.

    Raises InputError where the place cannot be written.
    """
    with hdf5.new_file(path) as file:
        hdf5.set_attributes(file, lampest_format=CARRIED)
        group = file.create_group("carried")
        for name, values in carried.items():
            unit = "ohm" if name.endswith("previous") else "1"
            hdf5.write_dataset(group, name, values, unit, name.replace("_", " "))


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
            task.write(task.unfinished, so_far())
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
