"""A case of a recording too long for memory: its parts are files of their own until the last of them is done.

How far such cases are, the files of their parts tell, whichever process or machine solves them.
"""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import Parts, asked_frames
from lampest.estimate.state import CarriedOver
from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.whole import inner_folder, remove_own
from lampest.recording.recording import Recording
from lampest.recording.stored import StoredRecording
from lampest.runs.case import StoredCase
from lampest.runs.config import Case
from lampest.runs.filling import case_result
from lampest.runs.results import join_case, stored_cases, write_results

CARRIED = "carried/1"
EVERY_SECONDS = 1.0  # between two sentences on how far long cases are


@dataclass(frozen=True)
class PartFiles:
    """folder : of the parts; each is a results file, and beside it stands what the frames behind it need of it."""

    case: Case
    folder: Path

    @classmethod
    def beside(cls, case: Case, file: Path) -> "PartFiles":
        """Of a case whose result will be that file. Raises InputError where the folder is a link that leads out."""
        return cls(case, inner_folder(file.parent, f"{file.stem}.parts"))

    def results(self, number: int) -> Path:
        """The estimates of a part."""
        return self.folder / f"{number:06d}.h5"

    def carried(self, number: int) -> Path:
        """What the next part needs of it; it is there before the estimates are."""
        return self.folder / f"{number:06d}_carried.h5"

    def done(self, number: int) -> CarriedOver | None:
        """What a part left, None where it is not whole: then it is solved again."""
        with suppress(InputError):
            if self.results(number).is_file() and self.carried(number).is_file():
                hdf5.checked(self.results(number))
                [held] = stored_cases(self.results(number))
                if held.case_id == self.case.case_id:
                    return read_carried(self.carried(number))
        return None

    def write(self, number: int, estimates: Estimates, carried: CarriedOver) -> int:
        """Keep a part's estimates, and what the next part needs; the part's number."""
        write_carried(self.carried(number), carried)
        write_results(self.results(number), [case_result(self.case, estimates)])
        return number

    @property
    def whole(self) -> list[int]:
        """Numbers of the parts whose estimates are there."""
        return sorted(int(file.stem) for file in self.folder.glob("[0-9]" * 6 + ".h5"))

    def clear(self) -> None:
        """Remove all that a case leaves here, and nothing else."""
        for pattern in ("*.h5", ".*.h5.*.part"):
            for file in self.folder.glob(pattern):
                remove_own(file)
        with suppress(OSError):
            self.folder.rmdir()


def solve_long(case: Case, stored: StoredRecording, file: Path) -> StoredCase:
    """Solve a case part by part, from the first one on that is not done, and write its result, whole or not at all."""
    files, solved = PartFiles.beside(case, file), list[int]()
    if case.estimator.looks_back or not set(stored.measured_blocks) <= set(files.whole):
        parts = _parts(case.estimator, stored)
        # What stands behind a part that is solved now followed from another one, unless parts stand apart.
        for part in parts.estimates(lambda at: None if solved and not parts.apart else files.done(at)):
            solved.append(files.write(*part))
    join_case(file, [files.results(number) for number in files.whole], case.recording)
    files.clear()
    return next(held for held in stored_cases(file) if held.case_id == case.case_id)


def parts_to_solve(case: Case, stored: StoredRecording, file: Path) -> list[int]:
    """The numbers of the parts of a case that may be solved in any order, and are not done; a damaged one goes."""
    files = PartFiles.beside(case, file)
    every = () if case.estimator.looks_back else stored.measured_blocks
    waiting = [number for number in every if files.done(number) is None]
    for number in waiting:
        remove_own(files.results(number))
    return waiting


def solve_part(case: Case, stored: StoredRecording, file: Path, number: int) -> None:
    """Solve one of these, where that is possible without those before."""
    for part in _parts(case.estimator, stored).alone(number):
        PartFiles.beside(case, file).write(*part)


@lru_cache(maxsize=1)  # a process solves several parts of a case
def _parts(estimator: Estimator, stored: StoredRecording) -> Parts:
    return Parts.of(stored, estimator, _asked(stored))


@lru_cache(maxsize=1)  # several estimators of one recording come one after the other
def _asked(stored: StoredRecording) -> tuple[Recording, Recording]:
    return asked_frames(stored)


def write_carried(path: Path, carried: CarriedOver) -> None:
    """Write what a part leaves, whole or not at all. Raises InputError where the place cannot be written."""
    with hdf5.new_file(path) as file:
        hdf5.set_attributes(file, lampest_format=CARRIED)
        group = file.create_group("carried")
        for name, values in carried.arrays.items():
            unit = "ohm" if name.endswith("previous") else "1"
            hdf5.write_dataset(group, name, values, unit, name.replace("_", " "))


def read_carried(path: Path) -> CarriedOver:
    """What a part left. Raises InputError where it cannot be read."""
    with hdf5.existing_file(path) as file:
        if hdf5.read_attribute(file, "/", "lampest_format") != CARRIED:
            raise InputError(f"{path}: is not the remainder of a part of a case")
        names = hdf5.child_datasets(file, "/carried")
        return CarriedOver({name: hdf5.read_array(file, f"/carried/{name}", (1, 2)) for name in names})


@contextmanager
def watched(cases: Sequence[tuple[Case, Path]], on_progress: Callable[[str], None]) -> Iterator[None]:
    """Within it `on_progress` hears once a second how far the long ones of these cases are, from a thread of its own.

    cases : each with the file that its result will be. Without a long one nothing is watched, and no thread begins.
    """
    long = [(PartFiles(case, file.with_suffix(".parts")), case.stored) for case, file in cases if case.stored]
    if not long:
        yield
        return
    begun, ended = [frames_done(files, stored) for files, stored in long], threading.Event()
    since = time.monotonic()

    def watch() -> None:
        while not ended.wait(EVERY_SECONDS):
            # Parts are there, and not yet the result that they become.
            sentences = [
                _how_far(files, stored, time.monotonic() - since, before)
                for (files, stored), before in zip(long, begun, strict=True)
                if files.folder.is_dir() and not files.folder.with_suffix(".h5").exists()
            ]
            if sentences:
                on_progress("; ".join(sentences))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _how_far(files: PartFiles, stored: StoredRecording, seconds: float, before: int) -> str:
    """'long × one: 45000 of 1000000 frames, 21 min left', so many seconds after `before` frames were done."""
    done = frames_done(files, stored)
    text = f"{files.case.recording} × {files.case.name}: {done} of {stored.frames} frames"
    if done == stored.frames:
        return f"{text}, being put together"
    left = seconds * (stored.frames - done) / max(done - before, 1)
    return f"{text}, {time_in_words(left)} left" if done > before else text


def frames_done(files: PartFiles, stored: StoredRecording) -> int:
    """Frames of the parts that are whole; one in which no frame is measured has no file."""
    return min(stored.frames, len(files.whole) * stored.length)


def time_in_words(seconds: float) -> str:
    """'40 s', '21 min' or '3 h 5 min'."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
