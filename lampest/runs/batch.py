"""Runs cases: finished ones are skipped, failures isolated, results kept as they come.

A finished case is kept until results.h5 is written: two datasets, in a millisecond, or a results file of its own where
they would hold more than MOST_PACKED bytes.
"""

import fcntl
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from lampest.estimate.sequence import reconstruct
from lampest.files import hdf5
from lampest.files.document import adapter, plain_content
from lampest.files.errors import InputError
from lampest.files.process import told_reason
from lampest.files.whole import inner_folder, opened_for_locking, output_folder, own, remove_own, sparing
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.stored import StoredRecording, opened, too_long
from lampest.runs.columns import all_columns
from lampest.runs.config import Case, Run, digest
from lampest.runs.executors import Executor, LostError
from lampest.runs.filling import case_result
from lampest.runs.long_case import PartFiles, solve_long, watched
from lampest.runs.results import CaseResult, StoredCase, read_results, stored_cases, write_results

RESULTS = "results.h5"
CASES = "cases"
KEPT = "case/1"
MOST_PACKED = 2**20  # bytes
ARRAY = "array"  # the key of what stands for an array: its type, its shape, where it begins in `values`


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
            under_way = watched([(task.case, task.file) for task in waiting], on_long)
            with under_way, closing(executor.results(solve_case, waiting)) as outcomes:
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


def _put_aside(path: Path, done: Sequence[CaseResult | StoredCase]) -> Path | None:
    """Give a file that holds other cases, or is no results file, another name: results_1.h5 and so on; returns it."""
    if path.is_symlink() or not path.is_file():
        return None
    with suppress(InputError):
        if {case.case_id for case in stored_cases(path)} <= {case.case_id for case in done}:
            return None
    names = (path.with_name(f"{path.stem}_{number}{path.suffix}") for number in count(1))
    return path.rename(next(name for name in names if not os.path.lexists(name)))


def solve_case(task: Task) -> CaseResult | StoredCase:
    """Solve one case and write its result, whole or not at all."""
    recording = _recording(task.case.path, task.case.sha256)
    inner_folder(task.folder, CASES)
    if isinstance(recording, StoredRecording):
        return solve_long(task.case, recording, task.file)
    result = case_result(task.case, reconstruct(recording, task.case.estimator))
    inner_folder(task.folder, CASES)
    write_kept(task.file, result)
    return result


@lru_cache(maxsize=1)
def _recording(path: Path, sha256: str) -> Recording | StoredRecording:
    """A recording, read once for the cases in a row that need it. Raises InputError where it was replaced meanwhile."""
    recording = opened(path)
    if digest(path) != sha256:
        raise InputError(f"{path}: was replaced after the run began; run again")
    return recording


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
    """The case's result where it is there and readable; a damaged one is solved again."""
    with suppress(InputError):
        return read_kept(task.file, task.case.case_id) if task.file.is_file() else None
    return None


def write_kept(path: Path, result: CaseResult) -> None:
    """Keep a case, whole or not at all.

    A packed one is not waited for until it is on the disk: its checksums tell whether it is whole, and it is solved
    again where a power failure cost it. Raises InputError where the place cannot be written.
    """
    parts: list[bytes] = []
    text = json.dumps({field.name: _plain(getattr(result, field.name), parts) for field in fields(result)})
    values = b"".join(parts)
    if len(text) + len(values) > MOST_PACKED:
        write_results(path, [result])
        return
    with hdf5.new_file(path, durable=False) as file:
        hdf5.set_attributes(file, lampest_format=KEPT)
        hdf5.write_plain(file, "case", np.asarray(hdf5.ascii_array(text)))
        hdf5.write_plain(file, "values", np.frombuffer(values, dtype=np.uint8))


def read_kept(path: Path, case_id: str) -> CaseResult | StoredCase | None:
    """The case of that name in a file that keeps one, None where it is of another. Raises InputError where damaged.

    A case of a recording that is too long for memory stays where it is.
    """
    with hdf5.existing_file(path) as file:
        packed = hdf5.read_attribute(file, "/", "lampest_format") == KEPT
        if packed:
            text, values = hdf5.read_text(file, "/case"), hdf5.read_array(file, "/values", 1).tobytes()
    if not packed:
        held = next((case for case in stored_cases(path) if case.case_id == case_id), None)
        if held is None or too_long(held.frames, held.cells):
            return held
        return next((case for case in read_results(path).cases if case.case_id == case_id), None)
    try:
        found = {name: _held(value, values) for name, value in json.loads(text).items()}
        scene: Scene = adapter(Scene).validate_python(found.pop("scene"))
        case = CaseResult(**found, scene=scene)
    except (ValueError, TypeError, LookupError) as error:
        raise InputError(f"{path}: keeps no case ({error})") from error
    case.check(all_columns())
    return case if case.case_id == case_id else None


def _plain(value: Any, parts: list[bytes]) -> Any:
    """What JSON can say of a field's value; the bytes of arrays go to `parts`."""
    if isinstance(value, np.ndarray):
        begin = sum(map(len, parts))
        parts.append(value.tobytes())
        return {ARRAY: [value.dtype.str, value.shape, begin]}
    if isinstance(value, dict):
        return {name: _plain(item, parts) for name, item in value.items()}
    return plain_content(value) if isinstance(value, Scene) else value


def _held(value: Any, values: bytes) -> Any:
    """The reverse; a list of texts as a tuple."""
    if isinstance(value, list):
        return tuple(value)
    if not isinstance(value, dict):
        return value
    if value.keys() != {ARRAY}:
        return {name: _held(item, values) for name, item in value.items()}
    kind, shape, begin = value[ARRAY]
    if np.dtype(kind).kind not in "biuf":
        raise ValueError(f"an array of {kind}")
    return np.frombuffer(values, kind, int(np.prod(shape)), begin).reshape(shape)
